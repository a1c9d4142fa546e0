"""A detector whose rates are known, and what the chain makes of them."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import BlobTracker, DetectorRates, GroundPlane
from rsmcm.chains.objects.detector_rates import ScoreMoments
from rsmcm.inference import Incoming, MultiChain, RecursiveBP
from rsmcm.inference.engine.recursive_bp import Belief
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes, PixelLabels

Numbers = NDArray[np.float64]

DT = 0.1
SIZE = (480, 640)
BLANK = np.zeros(SIZE, np.uint8)


def walkers(
    seed: int, n_frames: int = 120, found: float = 0.8, clutter: float = 0.7, scale: float = 1.0
) -> tuple[list[Frame], Numbers]:
    """Four people who walk side by side, found now and then, with false boxes; and their true boxes."""
    random = np.random.default_rng(seed)
    frames, truth = [], np.empty((n_frames, 4, 4))
    noticed = np.ones(4, bool)
    for number in range(n_frames):
        x = 80 + 130 * np.arange(4) + 2.0 * number * np.array([1, -1, 1, -1])
        y = np.array([250.0, 300.0, 350.0, 400.0])
        height = 0.3 * (y - 40)
        truth[number] = np.stack([x, y, 0.4 * height, height], axis=1)
        change = random.random(4) < DT / 0.5
        noticed[change] = random.random(int(change.sum())) < found
        seen = truth[number][noticed]
        seen = seen + random.normal(0, 1, seen.shape) * (0.05, 0.05, 0.06, 0.06) * seen[:, 3:]
        n_false = random.poisson(clutter)
        false = np.column_stack(
            [
                random.uniform(0, 640, n_false),
                random.uniform(200, 480, n_false),
                random.uniform(15, 60, n_false),
                random.uniform(40, 150, n_false),
            ]
        )
        feet = np.concatenate([seen, false])
        scores = np.concatenate([random.normal(0.8, 0.1, len(seen)), random.normal(0.4, 0.1, n_false)])
        edges = np.column_stack(
            [feet[:, 0] - feet[:, 2] / 2, feet[:, 1] - feet[:, 3], feet[:, 0] + feet[:, 2] / 2, feet[:, 1]]
        )
        frames.append(Frame(BLANK, number * DT, number + 1, boxes=GivenBoxes(edges, scale * scores)))
    return frames, truth


def run(frames: list[Frame]) -> list[Belief]:
    pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
    model = MultiChain().connect(blobs, pixels).connect(blobs, objects)
    model.connect(GroundPlane(), objects).connect(DetectorRates(), objects)
    return list(RecursiveBP(model).run(frames))


@pytest.mark.parametrize("scale", [100.0])
def test_rates_and_scores_are_learned_on_any_scale(scale: float) -> None:
    *_, last = run(walkers(0, found=0.75, clutter=1.5, scale=scale)[0])
    detector = last["objects"].detector
    assert detector.found == pytest.approx(0.75, abs=0.2)
    assert detector.clutter * SIZE[0] * SIZE[1] == pytest.approx(1.5, rel=0.6)
    scores = detector.scores
    assert scores.true / scale == pytest.approx(0.8, abs=0.05)
    assert scores.false / scale == pytest.approx(0.4, abs=0.1)
    assert scores.deviation / scale == pytest.approx(0.1, abs=0.1)


def test_people_keep_their_identities_and_false_boxes_get_none() -> None:
    """Misses come in bursts of half a second; no pixel tells anything."""
    frames, truth = walkers(0)
    beliefs = run(frames)
    names, wrong, seen = [set() for _ in range(4)], 0, 0
    for number in range(20, len(frames)):
        for track in beliefs[number]["blobs"].tracks():
            x, y, width, height = track.box
            off = np.abs(truth[number, :, :2] - (x + width / 2, y + height)).max(axis=1)
            if off.min() < 0.35 * height:
                names[int(off.argmin())].add(track.identity)
                seen += 1
            else:
                wrong += 1
    assert sum(len(each) for each in names) <= 8
    there = (truth[20:, :, 0] > 0) & (truth[20:, :, 0] < SIZE[1])
    assert seen > 0.65 * there.sum()
    assert wrong < 0.1 * seen


def test_without_a_detector_nothing_is_learned() -> None:
    frames = [Frame(BLANK, number * DT, number + 1) for number in range(10)]
    *_, last = run(frames)
    assert not last["detector"].counts.any()
    assert last["objects"].association is None
    assert not last["blobs"].detecting


def test_what_was_learned_is_forgotten() -> None:
    frames, _ = walkers(1, n_frames=60, found=0.5)
    *_, last = run(frames)
    chain = DetectorRates()
    objects = ObjectBoxes()
    learned, later = (
        chain.message(state, objects, Incoming({})).detector.found
        for state in (last["detector"], chain.predict(last["detector"], 1000.0))
    )
    assert learned < 0.75
    assert later == pytest.approx(chain.detection_probability, abs=1e-3)


def test_scores_that_are_all_alike_mean_nothing() -> None:
    moments = ScoreMoments.empty()
    assert moments.distributions() is None
    assert moments.updated(np.full(5, 0.7), np.array([1.0, 1, 0, 0, 0.5])).distributions() is None


@pytest.mark.parametrize("values", [{"detection_probability": 1.0}, {"clutter": 0}, {"memory": -1}])
def test_bad_parameters(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=rf"{next(iter(values))}: got"):
        DetectorRates(**values)

"""A detector whose rates are known, and what the chain makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import BlobTracker, DetectorRates, GroundPlane
from rsmcm.chains.objects.detector_rates import APART, ASSUMED, CHANCE, SINCE, TRUE, ScoreMoments
from rsmcm.inference import Incoming, MultiChain, RecursiveBP
from rsmcm.inference.engine.recursive_bp import Belief
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes, PixelLabels
from rsmcm.models.objects.association import associate
from rsmcm.models.objects.box_message import Association, BoxMessage, LogOdds

Numbers = NDArray[np.float64]

DT = 0.1
SIZE = (480, 640)
BLANK = np.zeros(SIZE, np.uint8)


def walkers(seed: int, n_frames: int, found: float, clutter: float, scale: float) -> list[Frame]:
    """Four people who walk side by side, found now and then, with false boxes."""
    random, frames, noticed = np.random.default_rng(seed), [], np.ones(4, bool)
    for number in range(n_frames):
        x = 80 + 130 * np.arange(4) + 2.0 * number * np.array([1, -1, 1, -1])
        y = np.array([250.0, 300.0, 350.0, 400.0])
        height = 0.3 * (y - 40)
        change = random.random(4) < DT / 0.5
        noticed[change] = random.random(int(change.sum())) < found
        seen = np.stack([x, y, 0.4 * height, height], axis=1)[noticed]
        seen = seen + random.normal(0, 1, seen.shape) * (0.05, 0.05, 0.06, 0.06) * seen[:, 3:]
        false = random.uniform((0, 200, 15, 40), (640, 480, 60, 150), (random.poisson(clutter), 4))
        feet = np.concatenate([seen, false])
        scores = np.concatenate(
            [random.normal(mean, 0.1, len(boxes)) for mean, boxes in ((0.8, seen), (0.4, false))]
        )
        half = feet[:, 2] / 2
        edges = np.column_stack([feet[:, 0] - half, feet[:, 1] - feet[:, 3], feet[:, 0] + half, feet[:, 1]])
        frames.append(Frame(BLANK, number * DT, number + 1, boxes=GivenBoxes(edges, scale * scores)))
    return frames


def run(frames: list[Frame]) -> list[Belief]:
    pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
    model = MultiChain().connect(blobs, pixels).connect(blobs, objects)
    model.connect(GroundPlane(), objects).connect(DetectorRates(), objects)
    return list(RecursiveBP(model).run(frames))


def test_rates_and_scores_are_learned_on_any_scale() -> None:
    scale = 100.0
    *_, last = run(walkers(0, 120, found=0.75, clutter=1.5, scale=scale))
    detector = last["objects"].detector
    assert detector.found == pytest.approx(0.75, abs=0.2)
    assert detector.clutter * SIZE[0] * SIZE[1] == pytest.approx(1.5, rel=0.6)
    one = run(walkers(0, 120, found=0.75, clutter=1.5, scale=1.0))[-1]["objects"].detector.scores
    scores = detector.scores
    assert [scores.true, scores.false, scores.deviation] == pytest.approx(
        [scale * one.true, scale * one.false, scale * one.deviation]
    )
    assert 0.4 < scores.false / scale < scores.true / scale < 0.8


def test_where_the_detector_erred_again_and_again_nobody_new_is_expected() -> None:
    """A figure in a window is found for 3 s and, 3 s later, again: no candidate is needed to know it then."""
    figure, frames = (
        np.array([[300.0, 60.0, 330.0, 140.0]]),
        walkers(0, 90, found=0.9, clutter=0.0, scale=1.0),
    )
    shown = [not 40 <= frame.number < 70 for frame in frames]
    for number, frame in enumerate(frames):
        assert frame.boxes is not None
        assert frame.boxes.confidence is not None
        edges, scores = np.concatenate([frame.boxes.xyxy, figure]), np.append(frame.boxes.confidence, 0.5)
        if shown[number] and number >= 10:
            frames[number] = replace(frame, boxes=GivenBoxes(edges, scores))
    beliefs = run(frames)
    before, after = (beliefs[number]["objects"].association.new[-1] for number in (10, 70))
    assert before > 1e-3  # with a low score, and where the plane expects nobody
    assert after < 1e-3 * before
    general = beliefs[-1]["detector"].counts[1] - beliefs[69]["detector"].counts[1]
    assert general < 0.1 * 20  # false boxes there are not expected elsewhere
    known = beliefs[69]["objects"].places
    np.testing.assert_allclose(known.boxes, [[315, 140, 30, 80]])
    assert known.rates == pytest.approx((29 - CHANCE) / (SINCE + 70), rel=0.3)


@pytest.mark.parametrize(("becomes", "told"), [(0.1, 0.9 * 20), (0.95, 0.05 * 20), (1.0, 0.0)])
def test_what_a_candidate_taught_is_withdrawn_when_it_becomes_an_object(becomes: float, told: float) -> None:
    """All boxes of a candidate are errors or none is: by what it is at the last of them, wherever that is."""
    blank, detector, objects = Frame(BLANK, 0.0, 1), DetectorRates(), ObjectBoxes()
    state = detector.initial(blank)
    none, one, seven = np.zeros(1), np.ones(1), np.array([7])
    for number in range(21):
        box = np.array([[300.0 + (number == 20) * 50, 140.0, 30.0, 80.0]])
        exists = becomes if number == 20 else 0.1
        pair, noise = np.ones((1, 1)), np.full((1, 4), 25.0)
        association = Association(
            boxes=box, noise=noise, scores=one, identities=seven, pairs=exists * pair, followed=pair,
            unfollowed=none, own_noise=noise[None], worth=pair, errors=np.zeros((1, 2)), expected=one,
            missed=none, visible=one, new=none, double=none, false=none, log_evidence=0.0,
        )  # fmt: skip
        odds = LogOdds(seven, np.array([np.log(exists / max(1 - exists, 1e-9))]))
        evidence = {objects: BoxMessage(association=association)}
        state = detector.update(state, Incoming({objects: BoxMessage(existence=odds)}, evidence))
    nobody = associate(replace(blank, boxes=GivenBoxes(np.zeros((0, 4)))), BoxMessage(), objects.detector)
    state = detector.update(state, Incoming({objects: BoxMessage()}, {objects: nobody}))
    assert state.errors[:1, 0].sum() == pytest.approx(told, abs=0.01)
    rates = detector.message(state, objects, Incoming({})).places
    assert rates is not None
    np.testing.assert_allclose(rates.rates, [(told - CHANCE) / (SINCE + 22)] if told > CHANCE else [])


@pytest.mark.parametrize(("larger", "beside", "score", "people"), [(1.5, 0.0, 0.6, 1), (1.0, 0.4, 0.8, 2)])
def test_a_larger_second_box_is_nobody_and_somebody_beside_another_is(
    larger: float, beside: float, score: float, people: int
) -> None:
    """Both go along with the walker at a distance from the others, as steadily as the walker is found."""
    random, frames = np.random.default_rng(0), walkers(0, 60, found=0.9, clutter=0.5, scale=1.0)
    for number in range(10, 60):
        foot = np.array([250.0 + 2 * number + 84 * beside, 200.0])
        height = 48 * larger
        left, top = foot - (0.2 * height, height) + random.normal(0, 2, 2)
        first = 250.0 + 2 * number - 0.2 * 48
        both = np.array([[first, 152, first + 0.4 * 48, 200], [left, top, left + 0.4 * height, top + height]])
        boxes = frames[number].boxes
        assert boxes is not None
        assert boxes.confidence is not None
        scores = np.concatenate([boxes.confidence, random.normal([0.8, score], 0.1)])
        given = GivenBoxes(np.concatenate([boxes.xyxy, both]), scores)
        frames[number] = replace(frames[number], boxes=given)
    found = []
    for belief in run(frames)[30:]:
        x = 250.0 + 2 * (belief.frame.number - 1)
        boxes = [track.box for track in belief["blobs"].tracks()]
        found.append(sum(abs(left + w / 2 - x) < 60 and abs(top + h - 200) < 20 for left, top, w, h in boxes))
    assert np.mean(np.array(found) == people) > 0.8


def test_what_was_learned_is_forgotten() -> None:
    *_, last = run(walkers(1, 60, found=0.5, clutter=0.7, scale=1.0))
    chain = DetectorRates()
    objects = ObjectBoxes()
    learned, later = (
        chain.message(state, objects, Incoming({})).detector.found
        for state in (last["detector"], chain.predict(last["detector"], 1000.0))
    )
    assert learned < 0.82  # from 0.85, 0.67 on the mean over seeds, by 0.06
    assert later == pytest.approx(chain.detection_probability, abs=1e-3)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_scores_are_apart_whatever_is_taken_for_true(scale: float) -> None:
    """The mixture of both has the moments of all scores, and what is taken for true does not move them."""
    scores = scale * np.random.default_rng(3).normal(2, 0.5, 200)
    found = ScoreMoments.empty().updated(scores, np.full(200, 0.5)).distributions()
    assert found is not None
    assert (found.true - found.false) / found.deviation == pytest.approx(APART)
    share = (100 + ASSUMED * TRUE) / (200 + ASSUMED)
    mixed = share * found.true + (1 - share) * found.false
    assert mixed == pytest.approx(scores.mean())
    between = share * (1 - share) * (found.true - found.false) ** 2
    assert found.deviation**2 + between == pytest.approx(scores.var())


def test_scores_that_are_all_alike_mean_nothing() -> None:
    moments = ScoreMoments.empty()
    assert moments.distributions() is None
    assert moments.updated(np.full(5, 0.7), np.array([1.0, 1, 0, 0, 0.5])).distributions() is None

"""What detections do to blobs: against a dense Kalman filter, and on films whose people are known."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import AdaptiveBackground, BlobTracker, DetectorRates, GroundPlane
from rsmcm.chains.objects import detections
from rsmcm.chains.objects.blobs import Blob, Blobs
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.engine.recursive_bp import Belief
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes, PixelLabels
from rsmcm.models.objects.box_message import Association, BoxMessage, LogOdds

DT = 0.08
HEIGHT, WIDTH = 120, 160
SCENE = np.random.default_rng(5).integers(90, 130, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def film(n_frames: int, *things: tuple[int, float]) -> list[NDArray[np.uint8]]:
    """Dark and upright things of 16 x 40 px with their tops in row 50: first column, and px/s."""
    random, images = np.random.default_rng(1), []
    for number in range(n_frames):
        image = SCENE + random.normal(0, 2, SCENE.shape)
        for start, speed in things:
            left = round(start + speed * DT * number)
            image[50:90, max(left, 0) : max(left + 16, 0)] = 30
        images.append(image.clip(0, 255).astype(np.uint8))
    return images


def boxes_at(number: int, *things: tuple[int, float]) -> GivenBoxes:
    lefts = np.array([start + speed * DT * number for start, speed in things])
    boxes = np.stack([lefts, np.full(len(things), 50), lefts + 16, np.full(len(things), 90)], axis=1)
    return GivenBoxes(boxes.reshape(-1, 4).astype(np.float64))


def engine(*, detector: bool = True) -> RecursiveBP:
    pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels).connect(blobs, objects)
    model.connect(GroundPlane(), objects)
    return RecursiveBP(model.connect(DetectorRates(), objects) if detector else model)


def run(images: list[NDArray[np.uint8]], given: list[GivenBoxes | None], **options: bool) -> list[Belief]:
    frames = [
        Frame(image, number * DT, number + 1, boxes=boxes)
        for number, (image, boxes) in enumerate(zip(images, given, strict=True))
    ]
    return list(engine(**options).run(frames))


def blob_at(x: float, y: float) -> Blob:
    blob = Blob.newborn(
        7, np.array([y, x]), np.full((30, 20), 0.9, np.float32), np.zeros((3, 30, 20), np.float32), 1.0, 300.0
    )
    box = {"box_mean": (10, 30, 20, 30), "box_variance": (4, 4, 9, 16), "unfound": detections.WHOLE}
    return blob.changed(covariance=np.array([[5.0, 3.0], [3.0, 40.0]]), detected=1, **box)


def told(box: NDArray[np.float64], noise: NDArray[np.float64]) -> BoxMessage:
    """One box, which is surely that of object 7."""
    one = np.ones(1)
    association = Association(
        boxes=box[None], noise=noise[None], scores=one, identities=np.array([7]), pairs=np.ones((1, 1)),
        followed=np.ones((1, 1)), unfollowed=0 * one, own_noise=noise[None, None], worth=np.ones((1, 1)),
        errors=np.zeros((1, 2)), expected=one,
        missed=0 * one, visible=one, new=0 * one, double=0 * one, false=0 * one, log_evidence=0.0,
    )  # fmt: skip
    return BoxMessage(existence=LogOdds(np.array([7]), np.array([2.5])), association=association)


def test_a_box_corrects_place_velocity_and_size_as_a_dense_filter_does() -> None:
    """State: place and velocity of the patch, foot within it; what is measured is the sum of two of them."""
    blob, noise = blob_at(100.0, 50.0), np.array([6.0, 6.0, 10.0, 12.0])
    box = np.array([114.0, 83.0, 24.0, 33.0])
    (after,) = detections.correct(Blobs.of([blob], 3), told(box, noise))
    assert after.detected
    for axis, place in ((0, 1), (1, 0)):
        prior = np.zeros((3, 3))
        prior[:2, :2], prior[2, 2] = blob.covariance, 4.0
        observed = np.array([1.0, 0.0, 1.0])
        mean = np.array([blob.position[place], 0.0, (10.0, 30.0)[axis]])
        gain = prior @ observed / (observed @ prior @ observed + noise[axis])
        mean = mean + gain * (box[axis] - observed @ mean)
        assert after.position[place] == pytest.approx(mean[0])
        assert after.velocity[place] == pytest.approx(mean[1])
        assert after.box_mean[axis] == pytest.approx(mean[2])
        covariance = prior - np.outer(gain, observed @ prior)
        np.testing.assert_allclose(after.covariance, covariance[:2, :2])
        assert after.box_variance[axis] == pytest.approx(covariance[2, 2])
    np.testing.assert_allclose(after.box_mean[2:], [20 + 9 / 19 * 4, 30 + 16 / 28 * 3])
    assert after.existence == 2.5
    # boxes that follow each other soon are worth less
    soon = blob.changed(unfound=0.2 * detections.WHOLE)
    (fifth,) = detections.correct(Blobs.of([soon], 3), told(box, noise))
    (noisy,) = detections.correct(Blobs.of([blob], 3), told(box, 5 * noise))
    np.testing.assert_allclose(fifth.position, noisy.position)


def test_sides_grow_as_a_dense_filter_says() -> None:
    """State: log of the size, and its rate; frames are short, so that a step of the size is nearly linear."""
    blob, dt = blob_at(0.0, 0.0).changed(growth=0.0, growth_covariance=(0.01, 0.0, 0.0)), 0.02
    blob = blob.changed(box_mean=(10, 30, 20, 30), box_variance=(4, 4, 0.16 * 4, 0.16 * 9))
    mean, covariance = np.array([0.0, 0.0]), np.diag([0.0016, 0.01])
    kept = np.exp(-dt / detections.GROWTH_TIME)
    step = np.array([[1.0, dt], [0.0, kept]])
    force = np.diag([dt * detections.SIDE_WALK_STD**2, (1 - kept**2) * detections.GROWTH_STD**2])
    for number in range(100):
        (blob,) = detections.predict(Blobs.of([blob], 3), dt, 0.9, True)
        mean, covariance = step @ mean, step @ covariance @ step.T + force
        size, noise = np.exp(0.2 * dt * number), 0.05**2
        box = np.array([0.0, 0.0, 20 * size, 30 * size])
        box[:2] = blob.position[::-1] + blob.box_mean[:2]
        sides = blob.box_mean[2:].copy()
        told_noise = np.concatenate([[1e9, 1e9], noise * sides**2])
        (blob,) = detections.correct(Blobs.of([blob.changed(unfound=1.0)], 3), told(box, told_noise))
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        mean = mean + gain * (box[3] / sides[1] - 1)
        covariance = covariance - np.outer(gain, covariance[0])
    np.testing.assert_allclose(np.log(blob.box_mean[2:] / [20, 30]), mean[0], rtol=0.02)
    assert blob.growth == pytest.approx(mean[1], rel=0.05)
    assert 0.1 < mean[1] < 0.2
    np.testing.assert_allclose(blob.growth_covariance, covariance[[1, 0, 0], [1, 1, 1]], rtol=0.05)
    np.testing.assert_allclose(blob.box_variance[2:] / blob.box_mean[2:] ** 2, covariance[0, 0], rtol=0.05)


def test_sides_that_grow_fast_are_as_unsure_as_many_draws_of_them() -> None:
    """Growth by a half in a second, against draws of the process in steps; their variance errs by 1 %."""
    blob = blob_at(0.0, 0.0).changed(growth=0.4, growth_covariance=(0.002, 0.001, 0.001))
    blob = blob.changed(box_variance=(4, 4, 0.004 * 20**2, 0.004 * 30**2))
    (after,) = detections.predict(Blobs.of([blob], 3), 1.0, 0.9, True)
    random, n_steps = np.random.default_rng(0), 100
    start = [[0.004 + detections.SIDE_WALK_STD**2, 0.001], [0.001, 0.002]]
    log_side, growth = random.multivariate_normal([0.0, 0.4], start, 20_000).T
    kept = np.exp(-1 / n_steps / detections.GROWTH_TIME)
    for _ in range(n_steps):
        force = np.sqrt(1 - kept**2) * detections.GROWTH_STD * random.standard_normal(len(growth))
        log_side, growth = log_side + growth / n_steps, kept * growth + force
    np.testing.assert_allclose(after.box_mean[2:], np.exp(log_side.mean()) * np.array([20, 30]), rtol=0.005)
    np.testing.assert_allclose(after.box_variance[2:] / after.box_mean[2:] ** 2, log_side.var(), rtol=0.05)
    both = np.cov(log_side, growth)[0, 1]
    np.testing.assert_allclose(after.growth_covariance[1:], both, rtol=0.1)


def test_somebody_new_has_the_outline_that_the_detector_gives() -> None:
    box, noise = np.array([60.0, 90.0, 20.0, 40.0]), np.array([6.0, 6.0, 10.0, 12.0])
    picture = np.zeros((1, 120, 160), bool)
    picture[0, 52:88, 55:62] = True
    message = told(box, noise)
    assert message.association is not None
    outlined = replace(message, association=replace(message.association, new=np.ones(1), outlines=picture))
    (candidate,) = detections.new_candidates(0, outlined, (120, 160), 3)
    blob = detections.newborn(candidate, outlined, 3, 300.0)
    top, left = blob.corner
    placed = np.zeros((120, 160), np.float32)
    placed[top : top + blob.mask.shape[0], left : left + blob.mask.shape[1]] = blob.mask
    np.testing.assert_allclose(placed, 0.9 * picture[0])


def test_doubt_grows_with_time_alike_in_one_step_and_in_many() -> None:
    steps = Blobs.of(
        [
            blob_at(100.0, 50.0).changed(
                existence=4.0, noticed=3.0, errors=(0.5, 1.5), growth_covariance=(1, 2, 3)
            )
        ],
        3,
    )
    (once,) = detections.predict(steps, 0.4, 0.9, True)
    for _ in range(10):
        steps = detections.predict(steps, 0.04, 0.9, True)
    (many,) = steps
    assert many.existence == pytest.approx(once.existence)
    assert many.noticed == pytest.approx(once.noticed)
    np.testing.assert_allclose(many.errors, once.errors)
    # three ways of there being no object: it has left, or an error lasts or has ended
    exists, odds = 1 / (1 + np.exp(-4.0)), np.exp([0.5, 1.5])
    lasting = (1 - exists) * odds / (1 + odds.sum()) * np.exp(-0.4 / np.array([20.0, 1.0]))
    left = 1 - exists * np.exp(-0.4 / 20.0) - lasting.sum()
    np.testing.assert_allclose(once.errors, np.log(lasting / left))
    np.testing.assert_allclose(many.covariance, once.covariance)
    np.testing.assert_allclose(many.box_variance, once.box_variance)
    np.testing.assert_allclose(many.growth_covariance, once.growth_covariance)
    assert once.existence < 4.0
    assert once.noticed < 3.0


def test_who_is_found_keeps_one_identity_and_who_is_not_is_not_reported() -> None:
    """Two walk side by side, half a width apart; the detector does not know the third one."""
    pair, unknown = ((-40, 40.0), (-16, 40.0)), (150, -20.0)
    beliefs = run(film(40, *pair, unknown), [boxes_at(number, *pair) for number in range(40)])
    for number in range(20, 36):
        one, two = sorted(beliefs[number]["blobs"].tracks(), key=lambda track: track.box[0])
        for track, start in ((one, -40), (two, -16)):
            assert track.box == pytest.approx((start + 40 * number * DT, 50, 16, 40), abs=4)
            assert track.confidence > 0.95
    assert len({track.identity for belief in beliefs[20:36] for track in belief["blobs"].tracks()}) == 2
    assert len(beliefs[30]["blobs"].blobs) >= 3


@pytest.mark.parametrize("seed", range(3))
def test_errors_that_come_again_stay_candidates(seed: int) -> None:
    """Of two boxes that are found in most frames, one has low scores and nothing but the scene in it.

    It comes second: what scores mean is not known in the first frame.
    """
    random, given = np.random.default_rng(seed), []
    for number in range(50):
        boxes = boxes_at(number, (-10, 40.0), (120, 0.0)).xyxy[[0, 1]]
        scores = random.normal([0.9, 0.2], 0.1)
        found = random.random(2) < [0.95, 0.7 * (number >= 10)]
        given.append(GivenBoxes((boxes + random.normal(0, 1, (2, 4)))[found], scores[found]))
    beliefs = run(film(50, (-10, 40.0)), given)
    walker, error = 0, 0
    for number, belief in enumerate(beliefs):
        state = belief.states["blobs"]
        lefts = np.array([track.box[0] for track in state.tracks()])
        walker += bool((np.abs(lefts - (40 * number * DT - 10)) < 8).any())
        error += bool((np.abs(lefts - 120) < 8).any()) and abs(40 * number * DT - 10 - 120) > 24
        assert (state.candidates.table["mass"] == 0).all()
    assert walker > 35
    assert error < 5


def test_a_candidate_moves_and_becomes_an_object_where_it_is_found_again() -> None:
    message = told(np.array([60.0, 90.0, 20.0, 40.0]), np.array([6.0, 6.0, 10.0, 12.0]))
    assert message.association is not None
    doubtful = replace(message, association=replace(message.association, new=np.full(1, 0.1)))
    found = detections.new_candidates(6, doubtful, (120, 160), 3)
    assert found.table["identity"] == [7]
    none, still = detections.sort_candidates(found, doubtful, (120, 160))
    assert (len(none), len(still)) == (0, 1)
    later = detections.correct(detections.predict(still, 0.1, 0.9, True), message)
    ((likely,), rest) = detections.sort_candidates(later, message, (120, 160))
    assert not len(rest)
    assert likely.existence == pytest.approx(np.log(0.1 / 0.9) + 2.5, abs=0.01)
    blob = detections.newborn(likely, message, 3, 300.0)
    assert blob.mass > 400  # of an ellipse of 628 px
    np.testing.assert_allclose(Blobs.of([blob], 3).reported_boxes, [[50, 50, 20, 40]], atol=0.5)
    # what was never found again is forgotten
    for _ in range(200):
        _, still = detections.sort_candidates(detections.predict(still, 0.5, 0.9, True), message, (120, 160))
    assert not len(still)


def test_a_detector_that_finds_nothing_has_run() -> None:
    images = film(8, (20, 0.0))
    nothing = GivenBoxes(np.zeros((0, 4)))
    last = run(images, [nothing] * len(images))[-1]
    assert last[ObjectBoxes()].association is not None
    assert last.states["blobs"].detecting
    assert not last.states["blobs"].tracks()
    assert last.states["detector"].elapsed == 0.0
    found = run(images, [boxes_at(0, (20, 0.0))] * 4 + [nothing] * 4)
    existence = [belief.states["blobs"].blobs[0].existence for belief in found]
    assert existence[-1] < existence[3] - 3

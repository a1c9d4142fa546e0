"""What a ground plane predicts of boxes, and what boxes teach of it, in dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import GroundPlane
from rsmcm.chains.objects.ground_plane import (
    FOOT_HEIGHTS,
    HALF_HIDDEN,
    MIN_ASPECT_STD,
    OTHER,
    PART,
    PRIOR,
    SLOPES,
    GroundState,
)
from rsmcm.inference.engine.protocols import Incoming
from rsmcm.models import Frame, ObjectBoxes
from rsmcm.models.camera.moving_camera import View
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH, BoxMessage, LogOdds
from scipy.stats import loguniform, norm, uniform

Numbers = NDArray[np.float64]
Observed = tuple[NDArray[np.intp], Numbers, Numbers, Numbers]
"""Places of objects, their boxes, covariances, and probabilities that they exist."""

GROUND = GroundPlane()
N_OBJECTS = 5
OBJECTS = ObjectBoxes()
UNIFORM = OBJECTS.uniform()
BLANK = np.zeros((480, 640), np.uint8)


def people(random: np.random.Generator) -> GroundState:
    """A plane and who walks on it, known with correlations."""
    root = random.normal(size=(2 + N_OBJECTS, 2 + N_OBJECTS))
    sizes = np.array([20.0, 0.1, *[0.1] * N_OBJECTS])
    covariance = sizes[:, None] * (root @ root.T / 7 + 0.2 * np.eye(2 + N_OBJECTS)) * sizes
    scene = np.array([90.0, 0.3, *random.normal(0, 0.1, N_OBJECTS)])
    feet = np.zeros((N_OBJECTS, 2, 2))
    feet[:, :, 0] = random.uniform([50, 200], [600, 460], (N_OBJECTS, 2))
    feet_root = random.normal(size=(N_OBJECTS, 2, 2, 2)) * 5
    return GroundState(
        size=(480, 640),
        variation=0.1,
        scene=scene,
        scene_covariance=covariance,
        all_aspects=np.array([1e-300, 0.4, 0.0]),
        identities=np.arange(N_OBJECTS),
        feet=feet,
        feet_covariance=feet_root @ feet_root.swapaxes(2, 3) + 4 * np.eye(2),
        heights=random.uniform(60, 150, N_OBJECTS),
        aspects=random.uniform(0.3, 0.6, N_OBJECTS),
        aspect_variances=np.full(N_OBJECTS, 0.01),
        trust=random.normal(1, 1, N_OBJECTS),
        unseen=random.uniform(0, 2, N_OBJECTS),
    )


def boxes_of(random: np.random.Generator, state: GroundState, places: NDArray[np.intp]) -> Observed:
    """Boxes near where they are expected, one of them cut off by the picture's lower edge."""
    boxes = np.empty((len(places), 4))
    boxes[:, [FOOT_X, FOOT_Y]] = state.feet[places, :, 0] + random.normal(0, 8, (len(places), 2))
    boxes[:, HEIGHT] = state.heights[places] * random.uniform(0.6, 1.2, len(places))
    boxes[:, WIDTH] = 0.4 * boxes[:, HEIGHT]
    boxes[0, FOOT_Y] = 479.5
    roots = random.normal(size=(len(places), 4, 4)) * 3
    covariances = roots @ roots.swapaxes(1, 2) + np.eye(4)
    return places, boxes, covariances, random.uniform(0.5, 0.99, len(places))


def observed_by(ground: GroundPlane, state: GroundState, observed: Observed) -> GroundState:
    places, boxes, covariances, exists = observed
    message = BoxMessage(
        GaussianMessage.from_moments(places, boxes, covariances),
        existence=LogOdds(places.astype(np.int64), np.log(exists / (1 - exists))),
    )
    return ground.update(state, Incoming({ObjectBoxes(): message}))


def good_over_bad(squares: Numbers, variance: Numbers, more: Numbers) -> Numbers:
    bad = variance + more
    return np.asarray(np.sqrt(bad / variance) * np.exp(-0.5 * squares * (1 / variance - 1 / bad)))


def joint_update(state: GroundState, observed: Observed) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """The plane after all boxes at once, in dense matrices, and the feet, each axis by a Kalman filter."""
    places, boxes, spread, existence = observed
    scene, covariance = state.scene, state.scene_covariance
    below, height, slope = boxes[:, FOOT_Y] - 240, boxes[:, HEIGHT], scene[1]
    noise = spread[:, HEIGHT, HEIGHT] + slope**2 * spread[:, FOOT_Y, FOOT_Y]
    noise -= 2 * slope * spread[:, FOOT_Y, HEIGHT]
    of_plane = np.column_stack([np.ones(len(below)), below])
    variance = ((of_plane @ covariance[:2, :2]) * of_plane).sum(axis=1)
    share = 1 / (1 + variance / (HALF_HIDDEN * height) ** 2)
    own = np.maximum(height + share * (of_plane @ scene[:2] - height), 0.25 * height)
    noise += (GROUND.height_std * own) ** 2
    design = np.zeros((len(places), len(scene)))
    design[:, :2] = of_plane
    design[np.arange(len(places)), 2 + places] = own
    expected, known = design @ scene, design @ covariance @ design.T
    ratio = good_over_bad((height - expected) ** 2, known.diagonal() + noise, (HALF_HIDDEN * own) ** 2)
    odds = ratio * (1 / GROUND.outliers - 1)
    whole = boxes[:, FOOT_Y] < 479
    on_plane = existence / (1 + np.exp(-state.trust[places]))
    worth = np.minimum(state.unseen[places] / GROUND.observation_time, 1)
    weight = np.maximum(whole * on_plane * odds / (1 + odds) * worth, 1e-9)
    gain = np.linalg.solve(known + np.diag(noise / weight), design @ covariance)
    reliable = whole * (1 - on_plane / (1 + odds))
    feet, feet_covariance = state.feet[places].copy(), state.feet_covariance[places].copy()
    for k, (box, its_spread) in enumerate(zip(boxes, spread, strict=True)):
        hidden = (1 - reliable[k]) * (HALF_HIDDEN * box[[WIDTH, HEIGHT]]) ** 2 / [1, worth[k]]
        seen = its_spread.diagonal()[:2] + (GROUND.foot_std * own[k]) ** 2 + hidden
        off, known_of_feet = box[:2] - feet[k, :, 0], feet_covariance[k, :, 0, 0]
        both = good_over_bad(off**2, known_of_feet + seen, own[k] ** 2).prod() * (1 / GROUND.outliers - 1)
        seen = seen / max(both / (1 + both), 1e-3)
        for axis in range(2):
            prior = feet_covariance[k, axis].copy()
            kalman = prior[:, 0] / (prior[0, 0] + seen[axis])
            feet[k, axis] += kalman * off[axis]
            feet_covariance[k, axis] = prior - np.outer(kalman, prior[0])
    after = scene + (height - expected) @ gain, covariance - covariance @ design.T @ gain
    return *after, feet, feet_covariance


@pytest.mark.parametrize("seed", range(5))
def test_plane_and_feet_after_boxes(seed: int) -> None:
    random = np.random.default_rng(seed)
    state = people(random)
    observed = boxes_of(random, state, np.array([0, 2, 3]))
    scene, covariance, feet, feet_covariance = joint_update(state, observed)
    after = observed_by(GROUND, state, observed)
    np.testing.assert_allclose(after.scene, scene, rtol=1e-9)
    atol = 1e-9 * np.abs(covariance).max()
    np.testing.assert_allclose(after.scene_covariance, covariance, rtol=1e-7, atol=atol)
    np.testing.assert_allclose(after.feet[[0, 2, 3]], feet, rtol=1e-9)
    np.testing.assert_allclose(after.feet_covariance[[0, 2, 3]], feet_covariance, rtol=1e-7, atol=1e-9)


def test_those_not_seen_keep_what_is_their_own() -> None:
    random = np.random.default_rng(1)
    state = people(random)
    after = observed_by(GROUND, state, boxes_of(random, state, np.array([0, 2, 3])))
    for name in ("feet", "feet_covariance", "heights", "aspects", "aspect_variances", "trust", "unseen"):
        was, is_now = getattr(state, name), getattr(after, name)
        np.testing.assert_array_equal(was[[1, 4]], is_now[[1, 4]])
        assert not np.array_equal(was[2], is_now[2])
    assert (after.unseen[[0, 2, 3]] == 0).all()


def test_aspects_of_whole_boxes_are_summed() -> None:
    """With boxes that certainly show whole people on the plane, weights are what they are worth."""
    random = np.random.default_rng(2)
    state = people(random)
    state.trust[:], state.unseen[:] = 30.0, 0.5
    places = np.array([1, 3])
    _, boxes, covariances, _ = boxes_of(random, state, places)
    boxes[:, FOOT_Y] = state.feet[places, 1, 0]
    heights = state.scene[0] + state.scene[1] * (boxes[:, FOOT_Y] - 240)
    boxes[:, HEIGHT] = heights
    boxes[:, WIDTH] = heights * (0.5, 0.6)
    observed = places, boxes, covariances, np.full(2, 1 - 1e-12)
    after = observed_by(GroundPlane(outliers=1e-9), state, observed)
    # of differences 0.1 and 0.2 from the mean before, with a weight of 1/2 each
    np.testing.assert_allclose(after.all_aspects, [1.0, 0.4 + 0.15, 0.025 - 0.15**2], rtol=1e-6)


def told(identities: NDArray[np.int64], boxes: Numbers) -> BoxMessage:
    covariances = np.broadcast_to(np.diag([16.0, 25.0, 16.0, 25.0]), (len(boxes), 4, 4))
    return BoxMessage(GaussianMessage.from_moments(identities, boxes, covariances))


def test_message_is_a_density_from_the_past_alone() -> None:
    """It integrates to 1 and does not depend on what others say now."""
    state = people(np.random.default_rng(4))
    ground = GROUND
    message = ground.message(state, OBJECTS, Incoming({})).objects
    assert message.log_mass == pytest.approx(0, abs=1e-6)
    message_of_others = Incoming({OBJECTS: told(state.identities, np.full((N_OBJECTS, 4), 50.0))})
    again = ground.message(state, OBJECTS, message_of_others).objects
    np.testing.assert_array_equal(again.information, message.information)
    np.testing.assert_array_equal(again.vector, message.vector)


def test_message_is_the_chain_of_its_conditionals() -> None:
    """Moments against sampling foot, height at the foot, width at the height: 200,000 draws, 5 sigma."""
    state = people(np.random.default_rng(4))
    ground = GROUND
    _, means, covariances = ground.message(state, OBJECTS, Incoming({})).objects.moments
    random = np.random.default_rng(0)
    n_draws, person = 200_000, 2
    scale = state.heights[person]
    sway = (ground.foot_std * scale) ** 2
    x, y = (
        random.normal(foot[0], np.sqrt(covariance[0, 0] + sway), n_draws)
        for foot, covariance in zip(state.feet[person], state.feet_covariance[person], strict=True)
    )
    row = state.feet[person, 1, 0]
    design = np.array([1.0, row - state.middle, 0, 0, scale, 0, 0])
    trusted = 1 / (1 + np.exp(-state.trust[person]))
    variance = (design @ state.scene_covariance @ design + (ground.height_std * scale) ** 2) / trusted
    expected = design @ state.scene + state.scene[1] * (y - row)
    height = random.normal(expected, np.sqrt(variance))
    width = random.normal(
        state.aspects[person] * height, np.sqrt(state.aspect_variances[person] + MIN_ASPECT_STD**2) * scale
    )
    draws = np.stack([x, y, width, height])
    deviations = draws.std(axis=1)
    np.testing.assert_allclose(
        means[person], draws.mean(axis=1), atol=5 * deviations.max() / np.sqrt(n_draws)
    )
    correlations = np.cov(draws) / np.outer(deviations, deviations)
    expected_correlations = covariances[person] / np.outer(deviations, deviations)
    np.testing.assert_allclose(expected_correlations, correlations, atol=5 * np.sqrt(2 / n_draws))


def test_feet_are_predicted_by_first_order_dynamics() -> None:
    """Against transition matrix and the integral of the random force; two half steps make one."""
    state = people(np.random.default_rng(4))
    ground = GROUND
    after = ground.predict(state, 0.4)
    transition = np.array([[1, 0.4], [0, 1]])
    force = np.array([[0.4**3 / 3, 0.4**2 / 2], [0.4**2 / 2, 0.4]]) * 0.5 * ground.acceleration**2
    for person in range(N_OBJECTS):
        for axis in range(2):
            expected = transition @ state.feet_covariance[person, axis] @ transition.T
            expected += force * state.heights[person] ** 2
            np.testing.assert_allclose(after.feet_covariance[person, axis], expected, rtol=1e-10)
            np.testing.assert_allclose(after.feet[person, axis], transition @ state.feet[person, axis])
    halves = ground.predict(ground.predict(state, 0.2), 0.2)
    np.testing.assert_allclose(halves.feet_covariance, after.feet_covariance, rtol=1e-10)


def test_who_is_gone_is_forgotten_after_a_while() -> None:
    ground = GroundPlane(max_coast_time=1.0)
    boxes = np.array([[100.0, 300.0, 30.0, 80.0], [300.0, 400.0, 40.0, 110.0]])
    state = ground.initial(Frame(BLANK, 0.0, 1))
    state = ground.update(state, Incoming({OBJECTS: told(np.array([1, 2]), boxes)}))
    only_second = Incoming({OBJECTS: told(np.array([2]), boxes[1:])})
    for _ in range(9):
        state = ground.update(ground.predict(state, 0.1), only_second)
    np.testing.assert_array_equal(state.identities, [1, 2])
    spread = [ground.message(state, OBJECTS, only_second).objects.marginal(k)[1][0, 0] for k in (1, 2)]
    assert spread[0] > 10 * spread[1]
    for _ in range(3):
        state = ground.update(ground.predict(state, 0.1), only_second)
    np.testing.assert_array_equal(state.identities, [2])
    assert state.scene_covariance.shape == (3, 3)
    for _ in range(30):
        state = ground.update(ground.predict(state, 0.1), Incoming({OBJECTS: UNIFORM}))
    assert not len(state.identities)
    assert not len(ground.message(state, OBJECTS, only_second).objects)


def test_in_the_next_scene_people_stand_where_the_camera_saw_them_and_look_as_large() -> None:
    state = people(np.random.default_rng(4))
    zoom = np.array([7.0, 80.0, 0.0, -30.0, 0.0, 80.0])  # by a fifth of half the diagonal, 400 px
    sure, unsure = (
        View.predicted(zoom, deviation**2 * np.eye(6), np.zeros(state.size, np.float32))
        for deviation in (1e-6, 3.0)
    )
    moved = state.seen_by(sure)
    before, after = (each.boxes(0.05, 0.03).moments for each in (state, moved))
    np.testing.assert_allclose(after[1], sure.map.boxes(before[1]), rtol=1e-9)
    np.testing.assert_allclose(after[2], 1.2**2 * before[2], rtol=1e-6, atol=1e-6)
    rows = np.array([150.0, 300.0, 470.0])
    there = sure.map.boxes(np.stack([np.full(3, 320.0), rows, rows, rows], axis=1))[:, FOOT_Y]
    np.testing.assert_allclose(moved.expected_height(there), 1.2 * np.array(state.expected_height(rows)))
    # by a row that is unsure, heights are so by the slope
    wider = state.seen_by(unsure).scene_covariance - moved.scene_covariance
    middle = np.array([[320.0, 240.0, 0.0, 0.0]])
    assert wider[0, 0] == pytest.approx(
        moved.scene[1] ** 2 * unsure.box_variances(middle)[0, FOOT_Y], rel=1e-4
    )


def seen_alone(random: np.random.Generator, seconds: int, whole: float) -> list[BoxMessage]:
    """Boxes that pixels show, twice a second: four of other people each second, who are whole or in parts.

    Somebody with feet in row y is 20 + 0.6 (y - 100) px high, more or less by a tenth.
    """
    messages = []
    for second in range(seconds):
        y = random.uniform(200, 460, 4)
        height = (20 + 0.6 * (y - 100)) * (1 + 0.1 * random.normal(size=4))
        height *= np.where(random.random(4) < whole, 1.0, random.uniform(0.1, 0.6, 4))
        boxes = np.stack([random.uniform(100, 500, 4), y, 0.4 * height, height], axis=1)
        covariances = np.einsum("ni,ij->nij", (0.05 * height[:, None]) ** 2 * np.ones(4), np.eye(4))
        message = BoxMessage(GaussianMessage.from_moments(4 * second + np.arange(4), boxes, covariances))
        messages += [message, message]
    return messages


def walked(state: GroundState, messages: list[BoxMessage]) -> GroundState:
    for message in messages:
        state = GROUND.update(GROUND.predict(state, 0.5), Incoming({OBJECTS: message}))
    return state


@pytest.mark.parametrize("seed", range(3))
def test_a_plane_that_was_learned_of_parts_begins_anew_when_whole_people_are_seen(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = np.array([250.0, 350.0, 450.0])
    truth = 20 + 0.6 * (rows - 100)
    parts = walked(GROUND.initial(Frame(BLANK, 0.0, 1)), seen_alone(random, 15, whole=0.0))
    assert (parts.expected_height(rows)[0] < 0.75 * truth).all()
    # every other one is whole: planes a tenth of a height apart are told from each other by a few
    after = walked(parts, seen_alone(random, 60, whole=0.5))
    np.testing.assert_allclose(after.expected_height(rows)[0], truth, rtol=0.15)


def test_planes_are_weighed_by_the_density_of_what_is_seen() -> None:
    (message, _) = seen_alone(np.random.default_rng(0), 1, 0.5)
    start = GROUND.initial(Frame(BLANK, 0.0, 1))
    found = walked(start, [message]).planes
    expected = PRIOR.copy()
    for _, y, _, height in message.objects.moments[1]:
        usual = np.maximum(480 * FOOT_HEIGHTS - SLOPES * (480 - y), 0.02 * 480)
        density = (1 - PART - OTHER) * norm.pdf(height, usual, start.variation * usual)
        density += PART * uniform.pdf(height, 0, usual) + OTHER * loguniform.pdf(height, height, 20 * height)
        expected += np.log(density)
    np.testing.assert_allclose(found, expected - expected.max(), atol=1e-9)


def test_with_a_detector_planes_are_not_compared() -> None:
    places, boxes = np.arange(3), np.array([[100.0 * k, 300, 40, 100] for k in (1, 2, 3)])
    state = observed_by(
        GROUND,
        GROUND.initial(Frame(BLANK, 0.0, 1)),
        (places, boxes, np.tile(np.eye(4), (3, 1, 1)), np.full(3, 0.9)),
    )
    np.testing.assert_array_equal(state.planes, PRIOR)

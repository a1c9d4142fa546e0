"""What boxes teach of a ground plane and of those on it, against the joint update in dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import GroundPlane
from rsmcm.chains.objects.ground_plane import HALF_HIDDEN, GroundState
from rsmcm.inference.engine.protocols import Incoming
from rsmcm.models import ObjectBoxes
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH, BoxMessage, LogOdds

Numbers = NDArray[np.float64]
Observed = tuple[NDArray[np.intp], Numbers, Numbers, Numbers]
"""Places of objects, their boxes, covariances, and probabilities that they exist."""

GROUND = GroundPlane()
N_OBJECTS = 5


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


def joint_update(state: GroundState, observed: Observed) -> tuple[Numbers, Numbers]:
    """The plane after all boxes at once, in dense matrices."""
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
    return scene + (height - expected) @ gain, covariance - covariance @ design.T @ gain


@pytest.mark.parametrize("seed", range(5))
def test_the_plane_after_boxes(seed: int) -> None:
    random = np.random.default_rng(seed)
    state = people(random)
    observed = boxes_of(random, state, np.array([0, 2, 3]))
    scene, covariance = joint_update(state, observed)
    after = observed_by(GROUND, state, observed)
    np.testing.assert_allclose(after.scene, scene, rtol=1e-9)
    np.testing.assert_allclose(
        after.scene_covariance, covariance, rtol=1e-7, atol=1e-9 * np.abs(covariance).max()
    )


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

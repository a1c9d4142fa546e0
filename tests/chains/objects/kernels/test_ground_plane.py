"""What boxes teach of a ground plane and of those on it, against the joint update in dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.objects.kernels.ground_plane import HALF_HIDDEN, GroundModel, Objects, Observed, observe
from rsmcm.models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH

Numbers = NDArray[np.float64]

MODEL = GroundModel(480.0, 640.0, 0.05, 0.03, 0.1, 1.0, 4.0)
N_OBJECTS = 5


def people(random: np.random.Generator) -> tuple[Numbers, Numbers, Objects]:
    """A plane and who walks on it, known with correlations."""
    root = random.normal(size=(2 + N_OBJECTS, 2 + N_OBJECTS))
    sizes = np.array([20.0, 0.1, *[0.1] * N_OBJECTS])
    covariance = sizes[:, None] * (root @ root.T / 7 + 0.2 * np.eye(2 + N_OBJECTS)) * sizes
    scene = np.array([90.0, 0.3, *random.normal(0, 0.1, N_OBJECTS)])
    feet = np.zeros((N_OBJECTS, 2, 2))
    feet[:, :, 0] = random.uniform([50, 200], [600, 460], (N_OBJECTS, 2))
    feet_root = random.normal(size=(N_OBJECTS, 2, 2, 2)) * 5
    objects = Objects(
        feet=feet,
        feet_covariance=feet_root @ feet_root.swapaxes(2, 3) + 4 * np.eye(2),
        heights=random.uniform(60, 150, N_OBJECTS),
        aspects=random.uniform(0.3, 0.6, N_OBJECTS),
        aspect_variances=np.full(N_OBJECTS, 0.01),
        trust=random.normal(1, 1, N_OBJECTS),
        unseen=random.uniform(0, 2, N_OBJECTS),
    )
    return scene, covariance, objects


def boxes_of(random: np.random.Generator, objects: Objects, places: NDArray[np.intp]) -> Observed:
    """Boxes near where they are expected, one of them cut off by the picture's lower edge."""
    boxes = np.empty((len(places), 4))
    boxes[:, [FOOT_X, FOOT_Y]] = objects.feet[places, :, 0] + random.normal(0, 8, (len(places), 2))
    boxes[:, HEIGHT] = objects.heights[places] * random.uniform(0.6, 1.2, len(places))
    boxes[:, WIDTH] = 0.4 * boxes[:, HEIGHT]
    boxes[0, FOOT_Y] = 479.5
    roots = random.normal(size=(len(places), 4, 4)) * 3
    covariances = roots @ roots.swapaxes(1, 2) + np.eye(4)
    return Observed(places, boxes, covariances, random.uniform(0.5, 1, len(places)))


def good_over_bad(squares: Numbers, variance: Numbers, more: Numbers) -> Numbers:
    bad = variance + more
    return np.asarray(np.sqrt(bad / variance) * np.exp(-0.5 * squares * (1 / variance - 1 / bad)))


def joint_update(
    scene: Numbers, covariance: Numbers, objects: Objects, observed: Observed
) -> tuple[Numbers, Numbers]:
    """The plane after all boxes at once, in dense matrices."""
    places, boxes, spread, existence = observed
    below, height, slope = boxes[:, FOOT_Y] - 240, boxes[:, HEIGHT], scene[1]
    noise = spread[:, HEIGHT, HEIGHT] + slope**2 * spread[:, FOOT_Y, FOOT_Y]
    noise -= 2 * slope * spread[:, FOOT_Y, HEIGHT]
    of_plane = np.column_stack([np.ones(len(below)), below])
    variance = ((of_plane @ covariance[:2, :2]) * of_plane).sum(axis=1)
    share = 1 / (1 + variance / (HALF_HIDDEN * height) ** 2)
    own = np.maximum(height + share * (of_plane @ scene[:2] - height), 0.25 * height)
    noise += (MODEL.spread * own) ** 2
    design = np.zeros((len(places), len(scene)))
    design[:, :2] = of_plane
    design[np.arange(len(places)), 2 + places] = own
    expected, known = design @ scene, design @ covariance @ design.T
    ratio = good_over_bad((height - expected) ** 2, known.diagonal() + noise, (HALF_HIDDEN * own) ** 2)
    odds = ratio * (1 / MODEL.outliers - 1)
    whole = boxes[:, FOOT_Y] < 479
    on_plane = existence / (1 + np.exp(-objects.trust[places]))
    worth = np.minimum(objects.unseen[places] / MODEL.observation_time, 1)
    weight = np.maximum(whole * on_plane * odds / (1 + odds) * worth, 1e-9)
    gain = np.linalg.solve(known + np.diag(noise / weight), design @ covariance)
    return scene + (height - expected) @ gain, covariance - covariance @ design.T @ gain


@pytest.mark.parametrize("seed", range(5))
def test_boxes_one_after_the_other_are_all_at_once(seed: int) -> None:
    random = np.random.default_rng(seed)
    scene, covariance, objects = people(random)
    observed = boxes_of(random, objects, np.array([0, 2, 3]))
    expected = joint_update(scene, covariance, objects, observed)
    observe(observed, MODEL, 0.4, scene, covariance, objects)
    np.testing.assert_allclose(scene, expected[0], rtol=1e-9)
    np.testing.assert_allclose(covariance, expected[1], rtol=1e-7, atol=1e-9 * np.abs(covariance).max())


def test_those_not_seen_keep_what_is_their_own() -> None:
    random = np.random.default_rng(1)
    scene, covariance, objects = people(random)
    before = Objects(*(array.copy() for array in objects))
    observe(boxes_of(random, objects, np.array([0, 2, 3])), MODEL, 0.4, scene, covariance, objects)
    for was, is_now in zip(before, objects, strict=True):
        np.testing.assert_array_equal(was[[1, 4]], is_now[[1, 4]])
        assert not np.array_equal(was[2], is_now[2])
    assert (objects.unseen[[0, 2, 3]] == 0).all()


def test_aspects_of_whole_boxes_are_summed() -> None:
    """With boxes that certainly show whole people on the plane, weights are what they are worth."""
    random = np.random.default_rng(2)
    scene, covariance, objects = people(random)
    objects.trust[:], objects.unseen[:] = 30.0, 0.5
    places = np.array([1, 3])
    observed = boxes_of(random, objects, places)
    observed.boxes[:, FOOT_Y] = objects.feet[places, 1, 0]
    heights = scene[0] + scene[1] * (observed.boxes[:, FOOT_Y] - 240)
    observed.boxes[:, HEIGHT] = heights
    observed.boxes[:, WIDTH] = heights * (0.5, 0.6)
    observed.existence[:] = 1.0
    sure = MODEL._replace(outliers=1e-9)
    weight, first, second = observe(observed, sure, 0.4, scene, covariance, objects)
    np.testing.assert_allclose([weight, first, second], [1.0, 0.15, 0.025], rtol=1e-6)

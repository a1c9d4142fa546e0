"""Poses of upper bodies against rotations of scipy and against pictures that one can imagine."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.upper_body import BodyPoses, shoulder_rotations, transport
from scipy.spatial.transform import Rotation

from ...support.body_poses import from_angles

Array = NDArray[np.float64]

seeds = st.integers(0, 10**6)


def units(shape: tuple[int, ...], seed: int) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def random_poses(n: int, seed: int) -> BodyPoses:
    random = np.random.default_rng(seed)
    return BodyPoses(
        100 * random.normal(size=(n, 2)),
        0.2 * random.normal(size=(n, 3)),
        0.4 * random.normal(size=(n, 3)),
        units((n, 2, 2), seed),
    )


@given(seeds)
def test_arms_lead_back_to_the_same_angles(seed: int) -> None:
    random = np.random.default_rng(seed)
    angles = random.normal(size=(20, 16))
    for first in (8, 12):
        vectors = units((20,), seed + first) * random.uniform(0, np.pi - 1e-3, (20, 1))
        angles[:, first : first + 3], angles[:, first + 3] = vectors, random.uniform(0.01, np.pi - 0.01, 20)
    np.testing.assert_allclose(from_angles(angles).angles, angles, atol=1e-9)


@given(seeds)
def test_angles_are_a_ball_joint_and_a_hinge(seed: int) -> None:
    random = np.random.default_rng(seed)
    angles = random.uniform(-1.5, 1.5, (1, 16))
    arms = from_angles(angles).arms[0]
    for side, first in enumerate((8, 12)):
        shoulder = Rotation.from_rotvec(angles[0, first : first + 3])
        # the forearm of a hanging arm turns about x, towards the viewer
        elbow = Rotation.from_rotvec([-angles[0, first + 3], 0, 0])
        np.testing.assert_allclose(arms[side, 0], shoulder.apply([0, 1, 0]), atol=1e-12)
        np.testing.assert_allclose(arms[side, 1], (shoulder * elbow).apply([0, 1, 0]), atol=1e-12)


@given(seeds)
def test_a_straight_arm_is_turned_the_shortest_way(seed: int) -> None:
    directions = units((10,), seed)
    rotations, flexions = shoulder_rotations(np.stack([directions, directions], axis=1))
    np.testing.assert_allclose(flexions, 0, atol=1e-7)
    np.testing.assert_allclose(rotations, transport(directions), atol=1e-12)
    turned = Rotation.from_matrix(rotations).magnitude()
    np.testing.assert_allclose(np.cos(turned), directions[:, 1], atol=1e-9)


@given(seeds, st.floats(-12, 0))
def test_transport_is_exact_up_to_straight_up(seed: int, power: float) -> None:
    aside = 10**power * np.random.default_rng(seed).normal(size=(8, 2))
    directions = np.stack([aside[:, 0], np.full(8, -1.0), aside[:, 1]], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rotations = transport(directions)
    np.testing.assert_allclose(rotations @ rotations.swapaxes(1, 2), np.tile(np.eye(3), (8, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    np.testing.assert_array_equal(rotations[:, :, 1], directions)


def test_poses_are_taken_and_joined() -> None:
    poses = random_poses(6, 0)
    joined = BodyPoses.concatenated([poses.take(slice(0, 2)), poses.take(np.array([4, 5]))])
    assert len(joined) == 4
    np.testing.assert_array_equal(joined.arms, poses.arms[[0, 1, 4, 5]])
    np.testing.assert_array_equal(joined.turns, poses.turns[[0, 1, 4, 5]])
    assert len(poses.take(np.zeros(6, bool)).angles) == 0

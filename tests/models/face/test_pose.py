"""Small changes of poses and their means against scipy and definitions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.numerics.rotations import exponential
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

seeds = st.integers(0, 10**6)


def random_poses(n: int, n_bases: int, seed: int) -> Poses:
    random = np.random.default_rng(seed)
    rotations = Rotation.random(n, random_state=seed).as_matrix()
    morphs = 40 * random.normal(size=(n, n_bases))
    morphs[:, 0] = random.uniform(20, 90, n)
    return Poses(rotations, 100 * random.normal(size=(n, 2)), morphs)


@given(seeds, st.integers(1, 4))
def test_changes_lead_from_one_pose_to_the_other(seed: int, n_bases: int) -> None:
    first, second = random_poses(6, n_bases, seed), random_poses(6, n_bases, seed + 1)
    changes = second.changes_from(first)
    assert changes.shape == (6, first.dimension) == (6, 5 + n_bases)
    reached = first.moved(changes)
    np.testing.assert_allclose(reached.rotations, second.rotations, atol=1e-12)
    np.testing.assert_allclose(reached.translations, second.translations, atol=1e-9)
    np.testing.assert_allclose(reached.morphs, second.morphs, atol=1e-9)


def test_one_pose_is_moved_in_many_ways() -> None:
    pose, changes = random_poses(1, 3, 0), 0.1 * np.random.default_rng(0).normal(size=(7, 8))
    np.testing.assert_allclose(pose.moved(changes).changes_from(pose), changes, atol=1e-12)


@given(seeds)
def test_mean_rotation_minimises_the_chordal_distance(seed: int) -> None:
    random = np.random.default_rng(seed)
    middle = Rotation.random(random_state=seed).as_matrix()
    poses = random_poses(8, 2, seed)
    poses = Poses(exponential(0.4 * random.normal(size=(8, 3))) @ middle, poses.translations, poses.morphs)
    weights = random.uniform(0, 3, 8)
    mean = poses.mean(weights)
    # scipy's mean of unit quaternions is the same optimum
    expected = Rotation.from_matrix(poses.rotations).mean(weights).as_matrix()
    np.testing.assert_allclose(mean.rotations[0], expected, atol=1e-9)
    np.testing.assert_allclose(mean.translations[0], np.average(poses.translations, axis=0, weights=weights))
    np.testing.assert_allclose(mean.morphs[0], np.average(poses.morphs, axis=0, weights=weights))

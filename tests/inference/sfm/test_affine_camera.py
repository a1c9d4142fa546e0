"""From affine to Euclidean, and when the motion does not tell; shapes brought onto each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.inference.sfm.affine_camera import affine_alignment, euclidean, scaled_rotations
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise
from scipy.spatial import procrustes

from ...support.turning import rotation, turning

Numbers = NDArray[np.float64]


def similarity_error(shape: Numbers, target: Numbers) -> float:
    """Root mean square distance, once a shape is scaled, turned or reflected, and moved onto another."""
    *_, disparity = procrustes(target, shape)
    return float(np.sqrt(disparity * np.square(target - target.mean(axis=0)).sum() / len(target)))


def sheared(cameras: Numbers, shape: Numbers, seed: int) -> tuple[Numbers, Numbers]:
    """The same pictures by affinely changed shape and cameras."""
    change = np.random.default_rng(seed).normal(size=(3, 3)) + np.eye(3)
    rows = np.concatenate([cameras[..., :3] @ np.linalg.inv(change), cameras[..., 3:]], axis=2)
    return rows, shape @ change.T


def seen(cameras: Numbers, shape: Numbers) -> Numbers:
    positions: Numbers = np.einsum("tcj,ij->tic", cameras[..., :3], shape) + cameras[:, None, :, 3]
    return positions


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), degrees=st.floats(10, 300))
def test_a_known_rotation_is_recovered(seed: int, degrees: float) -> None:
    _, cameras, shape = turning(degrees=degrees, seed=seed)
    found = euclidean(*sheared(cameras, shape, seed))
    assert found.determined
    assert found.reason == ""
    # conditions of the random change of space are up to about 1e4
    assert similarity_error(found.shape, shape) < 1e-6
    np.testing.assert_allclose(seen(found.cameras, found.shape), seen(cameras, shape), atol=1e-7)
    np.testing.assert_allclose(found.shape, sheared(cameras, shape, seed)[1] @ found.transform.T, atol=1e-7)
    rows = found.scales[:, None, None] * found.rotations[:, :2]
    np.testing.assert_allclose(rows, found.cameras[..., :3], atol=1e-7)
    np.testing.assert_allclose(found.rotations[0], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1)
    # relative rotations are the true ones, or those of the mirror image
    truth = scaled_rotations(cameras[..., :3])[1]
    relative = truth[-1] @ truth[0].T
    mirror = np.diag([1, 1, -1])
    assert min(
        np.abs(found.rotations[-1] - each).max() for each in (relative, mirror @ relative @ mirror)
    ) == pytest.approx(0, abs=1e-6)
    assert np.exp(np.mean(np.log(found.scales))) == pytest.approx(1)


def test_shape_and_cameras_from_noisy_positions() -> None:
    positions, _, shape = turning(n_frames=40, n_points=60, noise=1.0)
    for coherence in (False, True):
        found = factorise(positions, coherence=coherence)
        metric = euclidean(found.cameras, found.shape, found.camera_covariance)
        assert metric.determined
        # no Euclidean shape is nearer than the best affine one, and not much further
        affine = affine_alignment(found.shape, shape).error
        assert affine < similarity_error(metric.shape, shape) < 2 * affine + 1
        assert metric.uncertainty < 0.02


@pytest.mark.slow
def test_uncertainty_is_as_large_as_errors() -> None:
    """Logs of stretches that are left over their standard deviation, twenty times: about 1."""
    ratios = []
    for seed in range(20):
        positions, _, shape = turning(n_frames=30, n_points=40, degrees=15)
        noisy = positions + 0.5 * np.random.default_rng(seed).normal(size=positions.shape)
        found = factorise(noisy)
        metric = euclidean(found.cameras, found.shape, found.camera_covariance)
        assert metric.determined
        stretches = np.log(np.linalg.svd(affine_alignment(metric.shape, shape).matrix, compute_uv=False))
        ratios.append(np.linalg.norm(stretches - stretches.mean()) / metric.uncertainty)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 2


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("motion", ["static", "pan", "zoom", "about the optical axis"])
def test_a_motion_that_tells_nothing_of_depth_is_named(motion: str, noise: float) -> None:
    generator = np.random.default_rng(3)
    shape = 100 * generator.normal(size=(40, 3))
    cameras = np.zeros((30, 2, 4))
    for t in range(30):
        turned = rotation(2, 0.05 * t if motion == "about the optical axis" else 0.0)
        cameras[t, :, :3] = turned[:2] * (1 + 0.02 * t if motion == "zoom" else 1)
        cameras[t, :, 3] = 5 * t if motion == "pan" else 0
    positions = seen(cameras, shape) + noise * generator.normal(size=(30, 40, 2))
    given_cameras, given_shape, covariance = cameras, shape, None
    if noise:
        found = factorise(positions)
        given_cameras, given_shape, covariance = found.cameras, found.shape, found.camera_covariance
    metric = euclidean(given_cameras, given_shape, covariance)
    assert not metric.determined
    assert "no depth is visible" in metric.reason
    assert np.isnan(metric.scales).all()
    np.testing.assert_array_equal(metric.shape, given_shape)
    np.testing.assert_array_equal(metric.cameras, given_cameras)


def test_two_views_do_not_fix_depth() -> None:
    _, cameras, shape = turning(n_frames=3)
    metric = euclidean(cameras[:2], shape)
    assert not metric.determined
    assert metric.reason == "2 views do not fix depth, 3 may"
    # a turn about one axis in the picture plane, seen twice
    again = euclidean(np.concatenate([cameras[:2], cameras[:1]]), shape)
    assert not again.determined


def test_bad_input_is_named() -> None:
    _, cameras, shape = turning()
    for arguments, message in (
        ((cameras[:, :, :3], shape), r"cameras: got \(20, 2, 3\), expected finite \(n_frames, 2, 4\)"),
        ((np.full_like(cameras, np.nan), shape), "cameras: got"),
        ((cameras, shape[:, :2]), r"shape: got \(15, 2\), expected \(n_points, 3\)"),
        ((cameras, shape, np.eye(4)), r"camera_covariance: got \(4, 4\), expected \(20, 4, 4\)"),
    ):
        with pytest.raises(ValueError, match=message):
            euclidean(*arguments)
    with pytest.raises(ValueError, match=r"shape, target: got \(15, 3\) and \(14, 3\)"):
        affine_alignment(shape, shape[1:])


@settings(max_examples=20)
@given(seed=st.integers(0, 1000))
def test_an_affine_map_is_undone(seed: int) -> None:
    generator = np.random.default_rng(seed)
    shape, change, shift = (generator.normal(size=size) for size in ((12, 3), (3, 3), 3))
    target = shape @ change.T + shift
    found = affine_alignment(shape, target)
    assert found.error < 1e-9
    np.testing.assert_allclose(found.aligned, target, atol=1e-9)
    np.testing.assert_allclose(shape @ found.matrix.T + found.translation, target, atol=1e-9)

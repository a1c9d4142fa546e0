"""The smoother of coherent cameras beside a dense joint Gaussian."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference.sfm.factor_analysis.em import CameraPrior, estimate_cameras
from rsmcm.inference.sfm.factor_analysis.kernels import smooth_cameras

Numbers = NDArray[np.float64]

MOVE = np.kron([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]], np.eye(4))
PRECISION = 2.3


def observed_frames(n_frames: int, seed: int = 0) -> tuple[Numbers, Numbers, Numbers, Numbers, Numbers]:
    """Information, vector, noise, start mean and variance; a frame shows nothing, another one point only."""
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(n_frames, 6, 4))
    points[3] = 0
    points[4, 1:] = 0
    positions = generator.normal(size=(n_frames, 6, 2))
    return (
        np.einsum("tij,tik->tjk", points, points),
        np.einsum("tij,tic->tjc", points, positions),
        generator.uniform(0.01, 0.1, 12),
        generator.normal(size=(12, 2)),
        generator.uniform(1, 3, 12),
    )


def joint(
    information: Numbers, vector: Numbers, noise: Numbers, mean: Numbers, variance: Numbers
) -> tuple[Numbers, Numbers, float]:
    """Means `(n, 12, 2)`, covariances `(n, 12, 12)` and log evidence from one Gaussian over all states."""
    n = len(information)
    precision, pull = np.zeros((12 * n, 12 * n)), np.zeros((12 * n, 2))
    precision[:12, :12], pull[:12] = np.diag(1 / variance), mean / variance[:, None]
    for t in range(n - 1):
        step = np.zeros((12, 12 * n))
        step[:, 12 * t : 12 * t + 12], step[:, 12 * t + 12 : 12 * t + 24] = -MOVE, np.eye(12)
        precision += step.T / noise @ step
    before = 0.5 * np.sum(pull * np.linalg.solve(precision, pull)) - np.linalg.slogdet(precision)[1]
    for t in range(n):
        part = slice(12 * t, 12 * t + 4)
        precision[part, part] += PRECISION * information[t]
        pull[part] += PRECISION * vector[t]
    after = 0.5 * np.sum(pull * np.linalg.solve(precision, pull)) - np.linalg.slogdet(precision)[1]
    covariance = np.linalg.inv(precision)
    blocks = np.array([covariance[12 * t : 12 * t + 12, 12 * t : 12 * t + 12] for t in range(n)])
    return (covariance @ pull).reshape(n, 12, 2), blocks, float(after - before)


def test_equals_the_joint_gaussian() -> None:
    problem = observed_frames(8)
    information, vector, *rest = problem
    cameras, covariance, evidence, _, _ = smooth_cameras(information, vector, PRECISION, *rest)
    means, covariances, expected = joint(*problem)
    # the joint precision has a condition number of about 1e5
    np.testing.assert_allclose(cameras, means[:, :4].transpose(0, 2, 1), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariance, covariances[:, :4, :4], rtol=1e-10, atol=1e-10)
    assert evidence == pytest.approx(expected, rel=1e-10)


def test_derivative_of_the_evidence_by_the_noise() -> None:
    information, vector, noise, mean, variance = observed_frames(7, seed=1)
    *_, squares, counts = smooth_cameras(information, vector, PRECISION, noise, mean, variance)
    for j in range(12):
        step = np.zeros(12)
        step[j] = 1e-5
        more = joint(information, vector, noise + step, mean, variance)[2]
        less = joint(information, vector, noise - step, mean, variance)[2]
        assert 0.5 * (squares - counts)[j] == pytest.approx((more - less) / 2e-5, rel=1e-5, abs=1e-6)


def test_frames_before_the_first_observation_are_foreseen_backwards() -> None:
    information, vector, noise, mean, variance = observed_frames(9, seed=2)
    information[:2] = vector[:2] = 0
    cameras, covariance, _, _, _ = smooth_cameras(information, vector, PRECISION, noise, mean, variance)
    later, spreads, _ = joint(information[2:], vector[2:], noise, mean, variance)
    state, spread = later[0], spreads[0]
    back = np.linalg.inv(MOVE)
    for t in (1, 0):
        state, spread = back @ state, back @ (spread + np.diag(noise)) @ back.T
        np.testing.assert_allclose(cameras[t], state[:4].T, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariance[t], spread[:4, :4], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("precision", [1e12])
def test_covariances_stay_positive_definite(precision: float) -> None:
    information, vector, _, _, _ = observed_frames(40)
    noise = np.repeat([1e-8, 1e-9, 1e-10], 4)
    start = np.repeat([1e2, 0.1, 0.01], 4)
    _, covariance, _, squares, counts = smooth_cameras(
        information, vector, precision, noise, np.zeros((12, 2)), start
    )
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(covariance)[:, 0] > 0).all()
    assert (counts > 0).all()
    assert (squares >= 0).all()


@pytest.mark.parametrize("coherent", [True, False])
def test_learning_the_prior_never_lowers_the_evidence(coherent: bool) -> None:
    information, vector, _, _, _ = observed_frames(30, seed=3)
    prior = CameraPrior(np.full((3, 2), 1e-2) if coherent else np.ones((1, 2)), coherent)
    evidence = []
    for _ in range(30):
        estimate = estimate_cameras(information, vector, 0.5, prior)
        evidence.append(estimate.log_evidence)
        prior = estimate.better
    assert (np.diff(evidence) > -1e-9 * np.abs(evidence[:-1])).all()
    assert evidence[-1] > evidence[0]

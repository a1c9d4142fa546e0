"""Smoothed tracks against the joint Gaussian of all positions, and what is learned of how points move."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.points.trajectory import MotionModel, StackedMessages, smoothed_trajectory
from rsmcm.models.core.gaussian_message import GaussianMessage
from scipy.stats import multivariate_normal

Array = NDArray[np.float64]

MOTION = MotionModel(acceleration=50.0, speed=30.0, extent=200.0)
TIMES = np.array([0.0, 0.04, 0.08, 0.16, 0.2, 0.3])
ANY = 1e9
"""px: any position counts as known."""


def prior_covariance(times: Array, motion: MotionModel) -> Array:
    """Covariance `(n, n)` of a coordinate at `times`: an integrated Wiener process, in closed form."""
    s, t = np.meshgrid(times, times)
    low, high = np.minimum(s, t), np.maximum(s, t)
    process = low**2 * (3 * high - low) / 6
    covariance: Array = motion.extent**2 + motion.speed**2 * s * t + motion.acceleration * process
    return covariance


def messages(random: np.random.Generator, seen: NDArray[np.bool_]) -> list[GaussianMessage]:
    """Densities of positions about (50, 50) of the points that are `seen`, `(n_frames, n_points)`."""
    result = []
    for frame in seen:
        identities = np.flatnonzero(frame)
        roots = random.normal(size=(len(identities), 2, 2))
        means = random.normal(50, 3, (len(identities), 2))
        result.append(
            GaussianMessage.from_moments(identities, means, roots @ roots.transpose(0, 2, 1) + np.eye(2))
        )
    return result


def stacked(parts: list[GaussianMessage], n_points: int) -> StackedMessages:
    return StackedMessages.of(parts, TIMES, np.arange(n_points))


def dense(parts: list[GaussianMessage], point: int) -> tuple[Array, Array, float]:
    """Mean `(n_frames, 2)` and covariance `(n_frames, 2, 2)` of a point's positions, and log evidence."""
    prior = np.kron(prior_covariance(TIMES, MOTION), np.eye(2))
    rows, means, noise = [], [], []
    for time, part in enumerate(parts):
        if point in part.identities:
            mean, covariance = part.marginal(point)
            rows += [2 * time, 2 * time + 1]
            means.append(mean)
            noise.append(covariance)
    if not rows:
        return (
            np.zeros((len(TIMES), 2)),
            np.array([prior[i : i + 2, i : i + 2] for i in range(0, 12, 2)]),
            0.0,
        )
    whole = prior[np.ix_(rows, rows)]
    for k, covariance in enumerate(noise):
        whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += covariance
    gain = np.linalg.solve(whole, prior[rows]).T
    mean = (gain @ np.concatenate(means)).reshape(-1, 2)
    covariance = prior - gain @ prior[rows]
    blocks = np.array([covariance[i : i + 2, i : i + 2] for i in range(0, len(covariance), 2)])
    return mean, blocks, float(multivariate_normal(cov=whole).logpdf(np.concatenate(means)))


@given(st.integers(0, 2**32))
def test_tracks_and_messages_equal_the_joint_gaussian(seed: int) -> None:
    random = np.random.default_rng(seed)
    evidence = messages(random, random.random((6, 3)) < 0.6)
    others = messages(random, random.random((6, 3)) < 0.4)
    found = smoothed_trajectory(stacked(evidence, 3), stacked(others, 3), MOTION, ANY, None)
    for point in range(3):
        both = [one * other for one, other in zip(evidence, others, strict=True)]
        mean, covariance, _ = dense(both, point)
        np.testing.assert_allclose(found.position[:, point], mean, atol=1e-5)
        np.testing.assert_allclose(found.covariance[:, point], covariance, rtol=1e-6, atol=1e-6)
    for time, message in enumerate(found.messages()):
        rest = [*evidence[:time], GaussianMessage.uniform(2), *evidence[time + 1 :]]
        for point in range(3):
            mean, covariance, _ = dense(rest, point)
            said_mean, said_covariance = message.marginal(point)
            np.testing.assert_allclose(said_mean, mean[time], rtol=1e-4, atol=0.01)
            np.testing.assert_allclose(said_covariance, covariance[time], rtol=1e-4, atol=0.1)  # of 4e4


@given(st.integers(0, 2**32))
def test_prior_and_masses_make_the_log_evidence_of_all_tracks(seed: int) -> None:
    random = np.random.default_rng(seed)
    evidence = messages(random, random.random((6, 3)) < 0.6)
    found = smoothed_trajectory(stacked(evidence, 3), stacked([UNSAID] * 6, 3), MOTION, ANY, None)
    total = found.log_prior
    for message, seen in zip(found.messages(), evidence, strict=True):
        total += (message * seen).log_mass
    expected = sum(dense(evidence, point)[2] for point in range(3))
    # where a track begins is left out
    for point in range(3):
        first = next((t for t in range(6) if point in evidence[t].identities), None)
        if first is not None:
            alone = [evidence[t] if t == first else UNSAID for t in range(6)]
            expected -= dense(alone, point)[2] if first == 0 else 0.0
    assert total == pytest.approx(expected, abs=1e-4)


UNSAID = GaussianMessage.uniform(2)

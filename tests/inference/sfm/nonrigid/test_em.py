"""Steps of EM for deforming shapes: against dense Gaussians and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference.sfm.nonrigid import em
from rsmcm.models.numerics.rotations import exponential
from scipy.stats import multivariate_normal

from ....support.deforming import N_BASES, N_POINTS, SIZE, deforming, holes

Numbers = NDArray[np.float64]


def some_state(missing: float = 0.3) -> tuple[em.Tracks, em.State]:
    """A state that is not at any optimum, and tracks with gaps."""
    positions, _ = deforming(n_frames=8)
    partial = holes(positions, missing)
    partial -= np.nanmean(partial, axis=1, keepdims=True)
    partial /= SIZE
    random = np.random.default_rng(2)
    bases = 0.3 * random.standard_normal((N_BASES, N_POINTS, 3))
    bases[0, :, :2] = partial[0]
    state = em.State(
        bases,
        exponential(0.2 * random.standard_normal((8, 3))),
        random.uniform(0.9, 1.1, 8),
        0.1 * random.standard_normal((8, 2)),
        0.04,
        np.full(8, em.FIRST_DAMPING),
    )
    return em.Tracks.of(partial), state


def test_weights_and_likelihood_are_those_of_the_joint_gaussian() -> None:
    tracks, state = some_state()
    found = em.e_step(state, em.point_sums(tracks, state.bases))
    for frame, axes in enumerate(state.seen_axes):
        seen = tracks.seen[frame] > 0
        matrix = np.stack([(basis[seen] @ axes.T).ravel() for basis in state.bases], axis=1)
        mean = matrix[:, 0] + np.tile(state.translations[frame], seen.sum())
        modes = matrix[:, 1:]
        covariance = modes @ modes.T + state.noise * np.eye(len(mean))
        observed = tracks.positions[frame, seen].ravel()
        gain = modes.T @ np.linalg.inv(covariance)
        assert found.log_likelihood[frame] == pytest.approx(
            multivariate_normal(mean, covariance).logpdf(observed), rel=1e-10
        )
        np.testing.assert_allclose(found.mean[frame], gain @ (observed - mean), atol=1e-10)
        np.testing.assert_allclose(found.covariance[frame], np.eye(N_BASES - 1) - gain @ modes, atol=1e-10)


def moved(state: em.State, changes: Numbers) -> em.State:
    """Poses changed by `(6,)`: rotation vector, logarithm of scale, translation."""
    n = len(state.scales)
    return replace(
        state,
        rotations=exponential(np.tile(changes[:3], (n, 1))) @ state.rotations,
        scales=state.scales * np.exp(changes[3]),
        translations=state.translations + changes[4:],
    )


def test_poses_climb_to_where_the_likelihood_without_weights_is_flat() -> None:
    tracks, state = some_state()
    sums = em.point_sums(tracks, state.bases)
    found = em.e_step(state, sums)

    def slopes(at: em.State) -> Numbers:
        """`(6, n_frames)` by central differences; their rounding error is about 1e-6."""
        step = 1e-5
        ends = (
            [em.e_step(moved(at, sign * step * axis), sums).log_likelihood for sign in (1, -1)]
            for axis in np.eye(6)
        )
        return np.array([(up - down) / (2 * step) for up, down in ends])

    before = np.abs(slopes(state)).max()
    for _ in range(60):
        likelihood = found.log_likelihood
        state, found = em.pose_step(state, sums, found)
        assert (found.log_likelihood >= likelihood).all()
    assert before > 10
    # where two poses of a frame are nearly as good, the way to the better one is long
    after = np.abs(slopes(state)).max(axis=0)
    assert (after < 1e-3).mean() > 0.8
    assert after.max() < 0.1 * before
    again = em.e_step(state, sums)
    np.testing.assert_allclose(found.mean, again.mean, atol=1e-12)
    np.testing.assert_allclose(found.products, again.products, atol=1e-12)


def test_bases_are_where_the_expected_squares_with_the_prior_are_least() -> None:
    tracks, state = some_state()
    found = em.e_step(state, em.point_sums(tracks, state.bases))
    # without the change back to N(0, I)
    found = replace(found, mean=found.mean - found.mean.mean(axis=0))
    second = found.mean.T @ found.mean / 8 + found.covariance.mean(axis=0)
    prior = em.basis_covariance(state.bases, state.seen_axes)
    after, _ = em.shape_step(state, tracks, found, prior)
    after.bases[1:] = np.tensordot(np.linalg.inv(np.linalg.cholesky(second)).T, after.bases[1:], 1)

    def cost(bases: Numbers) -> float:
        extended = found.extended
        shapes = np.tensordot(extended, bases, 1)
        axes = state.seen_axes
        residual = tracks.positions - state.translations[:, None] - shapes @ axes.transpose(0, 2, 1)
        seen = np.einsum("kja,nca->nkjc", bases[1:], axes)
        spread = np.einsum("nkl,nkjc,nljc->nj", found.covariance, seen, seen)
        squares = float(np.sum(tracks.seen * (np.sum(residual**2, axis=2) + spread)))
        return squares / (2 * state.noise) - em.log_prior(bases, prior)

    least = cost(after.bases)
    assert least < cost(state.bases)
    random = np.random.default_rng(0)
    for _ in range(20):
        change = 1e-4 * random.standard_normal(after.bases.shape)
        up, down = cost(after.bases + change), cost(after.bases - change)
        assert min(up, down) > least
        # a quadratic has its least value halfway; elsewhere the two differ more than they rise
        assert abs(up - down) < 1e-4 * (up + down - 2 * least)

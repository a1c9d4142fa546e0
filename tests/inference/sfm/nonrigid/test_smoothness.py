"""Smooth weights and turns: against dense Gaussians, and people before a shaky tracker."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.inference.sfm.nonrigid import em
from rsmcm.inference.sfm.nonrigid.learning import learn_shape
from rsmcm.inference.sfm.nonrigid.shape import shape_error
from rsmcm.models.numerics.rotations import exponential
from scipy.stats import multivariate_normal

from ....support.deforming import deforming
from ....support.stick_figures import stick_figure

N, MODES, POINTS = 7, 2, 6


def some_state() -> tuple[em.Tracks, em.State]:
    random = np.random.default_rng(0)
    positions = random.standard_normal((N, POINTS, 2))
    positions[2, 1:4] = np.nan
    state = em.State(
        0.5 * random.standard_normal((1 + MODES, POINTS, 3)),
        exponential(random.standard_normal((N, 3))),
        random.uniform(0.8, 1.2, N),
        0.1 * random.standard_normal((N, 2)),
        0.2,
        np.full(N, em.FIRST_DAMPING),
    )
    return em.Tracks.of(positions), state


def test_weights_and_likelihood_are_those_of_the_joint_gaussian_of_all_frames() -> None:
    tracks, state = some_state()
    correlations = np.array([0.9, 0.3])
    found, cross, likelihood = em.smooth_weights(state, em.point_sums(tracks, state.bases), correlations)
    lags = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    by_modes = np.zeros((N, MODES, N, MODES))
    for mode, correlation in enumerate(correlations):
        by_modes[:, mode, :, mode] = correlation**lags
    prior = by_modes.reshape(N * MODES, -1)
    rows, observed = [], []
    for frame, axes in enumerate(state.seen_axes):
        seen = tracks.seen[frame] > 0
        matrix = np.stack([(basis[seen] @ axes.T).ravel() for basis in state.bases], axis=1)
        row = np.zeros((len(matrix), N, MODES))
        row[:, frame] = matrix[:, 1:]
        rows.append(row.reshape(len(matrix), -1))
        shift = np.tile(state.translations[frame], seen.sum())
        observed.append(tracks.positions[frame, seen].ravel() - matrix[:, 0] - shift)
    modes, away = np.concatenate(rows), np.concatenate(observed)
    covariance = modes @ prior @ modes.T + state.noise * np.eye(len(away))
    gain = prior @ modes.T @ np.linalg.inv(covariance)
    after = (prior - gain @ modes @ prior).reshape(N, MODES, N, MODES)
    np.testing.assert_allclose(found.mean.ravel(), gain @ away, atol=1e-10)
    for frame in range(N):
        np.testing.assert_allclose(found.covariance[frame], after[frame, :, frame], atol=1e-10)
        if frame:
            np.testing.assert_allclose(cross[frame], after[frame, :, frame - 1], atol=1e-10)
    expected = multivariate_normal(np.zeros(len(away)), covariance).logpdf(away)
    assert likelihood == pytest.approx(expected, rel=1e-10)


def test_a_steady_turn_has_no_second_differences() -> None:
    steady = exponential(np.outer(np.arange(9), [0.02, 0.1, -0.03])) @ exponential(
        np.array([[1.0, 2.0, 0.5]])
    )
    np.testing.assert_allclose(em.second_differences(steady), 0, atol=1e-12)
    assert np.abs(em.second_differences(steady[[0, 1, 3, 4]])).max() > 0.05


@pytest.mark.slow
def test_turns_of_noisy_tracks_are_smoother_and_shapes_hardly_worse() -> None:
    """Of 20 people, the error in 3-D was .90 to 1.12 of that without, .97 in the mean, and .055 about it."""
    truth = stick_figure(120, seed=10)
    noise = 0.03 * truth[..., :2].std(axis=1).mean()
    tracks = truth[..., :2] + noise * np.random.default_rng(0).standard_normal(truth[..., :2].shape)
    rough, smooth = (learn_shape(tracks, 4, iterations=60, smooth=each) for each in (False, True))
    assert shape_error(smooth.shapes(), truth) < 1.25 * shape_error(rough.shapes(), truth)
    shaking = [np.abs(em.second_differences(each.rotations)).mean() for each in (rough, smooth)]
    assert shaking[1] < 0.5 * shaking[0]


def test_posterior_of_poses_never_falls() -> None:
    tracks, state = some_state()
    sums, correlations, spread = em.point_sums(tracks, state.bases), np.array([0.9, 0.3]), 0.01

    def posterior(at: em.State) -> float:
        squares = np.sum(em.second_differences(at.rotations) ** 2)
        return float(em.smooth_weights(at, sums, correlations)[2] - squares / (2 * spread))

    # turns small enough for their differences to be nearly linear
    state = replace(state, rotations=exponential(0.05 * np.random.default_rng(1).standard_normal((N, 3))))
    reached, damping = [posterior(state)], em.DAMPING.first
    for _ in range(8):
        found = em.smooth_weights(state, sums, correlations)[0]
        normal, pull = (each / state.noise for each in em.pose_equations(state, sums, found))
        state, damping = em._turned(state, sums, correlations, spread, normal, pull, damping)
        reached.append(posterior(state))
    assert (np.diff(reached) >= 0).all()
    assert reached[-1] > reached[0] + 1


def test_too_few_frames() -> None:
    with pytest.raises(ValueError, match=r"got 4 frames .*, expected 5 at least for smooth"):
        learn_shape(deforming(n_frames=4)[0], 2, smooth=True)

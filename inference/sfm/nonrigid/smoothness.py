"""Weights and turns of a deforming thing that change smoothly from frame to frame, as much as they do.

Weights of modes are first-order autoregressive, z_t = a z_t-1 + noise, each N(0, 1) by itself: correlations
a are learned by EM (Shumway and Stoffer 1982), with modes turned to where those of successive frames are
diagonal. Turns are a walk whose steps are a walk: second differences of rotations are N(0, s^2 I), with s^2
from what is expected of their squares. Poses climb the posterior with the weights of all frames integrated
out, by damped Gauss-Newton steps that move all frames together. Frames that are left out count as none.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ....models.numerics.rotations import logarithm
from ...least_squares import Damping, levenberg_marquardt
from .em import (
    RIDGE,
    PointSums,
    State,
    Tracks,
    WeightPosterior,
    basis_covariance,
    e_step,
    moved_poses,
    point_sums,
    pose_equations,
    shape_step,
)

Numbers = NDArray[np.float64]

SMOOTH_FRAMES = 5
"""Fewer say nothing about differences of differences."""
ITERATIONS = 40
DAMPING = Damping(1e-4, most=1e6)
MOST_STEPS = 20
"""That are tried, with more and more damping."""
MOST_CORRELATION = 0.9999
LEAST_SPREAD = 1e-4
"""Of second differences of turns, rad: finer ones no film shows."""
WINDOW = 200
"""Frames from which the spread of turns is learned; its posterior takes the cube of their number."""


def smoothed(tracks: Tracks, state: State, on_iteration: Callable[[], None]) -> tuple[State, WeightPosterior]:
    """The state and its weights after so many iterations of EM with the prior of smoothness.

    The log likelihoods of the posterior are those of frames by themselves.
    """
    correlations, spread = np.zeros(len(state.bases) - 1), None
    prior, damping = basis_covariance(state), DAMPING.first
    for _ in range(ITERATIONS):
        sums = point_sums(tracks, state.bases)
        found = smooth_weights(state, sums, correlations)[0]
        normal, pull = (each / state.noise for each in pose_equations(state, sums, found))
        spread = _spread_of_turns(state.rotations, normal, spread)
        state, damping = _turned(state, sums, correlations, spread, normal, pull, damping)
        found, cross, _ = smooth_weights(state, sums, correlations)
        correlations, modes = _correlations(found, cross)
        state, prior = shape_step(state, tracks, found, prior)
        state.bases[1:] = np.tensordot(modes.T, state.bases[1:], 1)
        prior[1:, 1:] = modes.T @ prior[1:, 1:] @ modes
        on_iteration()
    return state, smooth_weights(state, point_sums(tracks, state.bases), correlations)[0]


def smooth_weights(
    state: State, sums: PointSums, correlations: Numbers
) -> tuple[WeightPosterior, Numbers, float]:
    """Posterior of weights given all frames, covariances of each frame's with the one before, log likelihood.

    Information is block tridiagonal: elimination forward, and back (Rauch, Tung and Striebel 1965).
    """
    alone = e_step(state, sums)
    n, n_modes = alone.mean.shape
    innovation = 1 - correlations**2
    own = alone.products[:, 1:, 1:] / state.noise
    pull = np.matmul(own + np.eye(n_modes), alone.mean[..., None])[..., 0]
    information = own + np.diag((1 + correlations**2) / innovation)
    information[[0, -1]] = own[[0, -1]] + np.diag(1 / innovation)
    outer = -correlations / innovation
    inverses, means = np.empty_like(own), pull.copy()
    for frame in range(n):
        reduced = information[frame]
        if frame:
            reduced = reduced - outer[:, None] * inverses[frame - 1] * outer
            means[frame] -= outer * (inverses[frame - 1] @ means[frame - 1])
        inverses[frame] = np.linalg.inv(reduced)
    covariances, cross = inverses.copy(), np.zeros_like(inverses)
    means[-1] = inverses[-1] @ means[-1]
    for frame in range(n - 2, -1, -1):
        gain = inverses[frame] * outer
        means[frame] = inverses[frame] @ (means[frame] - outer * means[frame + 1])
        cross[frame + 1] = -covariances[frame + 1] @ gain.T
        covariances[frame] += gain @ covariances[frame + 1] @ gain.T
    # against weights that know nothing of each other
    gained = np.sum(pull * (means - alone.mean)) + np.linalg.slogdet(inverses)[1].sum()
    gained += np.linalg.slogdet(own + np.eye(n_modes))[1].sum() - (n - 1) * np.log(innovation).sum()
    likelihood = float(alone.log_likelihood.sum() + gained / 2)
    return replace(alone, mean=means, covariance=covariances), cross, likelihood


def _correlations(found: WeightPosterior, cross: Numbers) -> tuple[Numbers, Numbers]:
    """Correlations of successive weights, and the modes (columns) in terms of those of `shape_step`."""
    away = found.mean - found.mean.mean(axis=0)
    squares = away[:, :, None] * away[:, None] + found.covariance
    white = np.linalg.inv(np.linalg.cholesky(squares.mean(axis=0)))
    successive = white @ ((away[1:].T @ away[:-1] + cross[1:].sum(axis=0)) @ white.T)
    both = white @ ((squares[1:] + squares[:-1]).sum(axis=0) / 2) @ white.T
    modes = np.linalg.eigh((successive + successive.T) / 2)[1]
    ratio = np.diag(modes.T @ successive @ modes) / np.diag(modes.T @ both @ modes)
    return np.clip(ratio, 0, MOST_CORRELATION), modes


def second_differences(rotations: Numbers) -> Numbers:
    """`(n_frames - 2, 3)` rad: by how much the turn from frame to frame changes, about the camera's axes."""
    turns = logarithm(rotations[1:] @ rotations[:-1].transpose(0, 2, 1))
    return np.diff(turns, axis=0)


def _differences(n: int) -> sparse.csr_matrix:
    """`(3 (n - 2), 3 n)`: second differences of turns, to first order."""
    rows = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    return sparse.csr_matrix(sparse.kron(rows, sparse.eye(3)))


def _spread_of_turns(rotations: Numbers, normal: Numbers, spread: float | None) -> float:
    """Variance of second differences, expected under their posterior by the spread before; rad^2."""
    n = min(len(rotations), WINDOW)
    about, rest = normal[:n, :3, :3], normal[:n, 3:, 3:]
    information = about - normal[:n, :3, 3:] @ np.linalg.solve(rest, normal[:n, 3:, :3])
    rows = _differences(n)
    whole = sparse.block_diag(list(information)).toarray()
    whole[np.diag_indices_from(whole)] += 1.0  # known to a radian before
    if spread is not None:
        whole += (rows.T @ rows).toarray() / spread
    uncertain = np.sum(rows.toarray() * (rows @ np.linalg.inv(whole))) / rows.shape[0]
    return max(float(np.mean(second_differences(rotations) ** 2)) + float(uncertain), LEAST_SPREAD**2)


def _turned(
    state: State,
    sums: PointSums,
    correlations: Numbers,
    spread: float,
    normal: Numbers,
    pull: Numbers,
    damping: float,
) -> tuple[State, float]:
    """One step of all poses together, and the damping of the next."""

    def posterior(at: State) -> float:
        squares = float(np.sum(second_differences(at.rotations) ** 2))
        return smooth_weights(at, sums, correlations)[2] - squares / (2 * spread)

    def linearised(at: State) -> Callable[[float], State | None]:
        n, before = len(normal), posterior(at)
        rows = _differences(n)
        turns = sparse.kron(sparse.eye(n), sparse.eye(6, 3))
        smooth_pull = (turns @ (rows.T @ second_differences(at.rotations).ravel()) / spread).reshape(n, 6)
        right = (pull - smooth_pull).ravel()
        smooth = turns @ (rows.T @ rows) @ turns.T / spread
        diagonal = np.diagonal(normal, axis1=1, axis2=2)
        ridge = RIDGE * diagonal.max(axis=1)[:, None]

        def step(damping: float) -> State | None:
            added = (damping * diagonal + ridge).ravel()
            whole = smooth + sparse.block_diag(list(normal)) + sparse.diags(added)
            change = spsolve(sparse.csc_matrix(whole), right, permc_spec="NATURAL").reshape(n, 6)
            moved = moved_poses(at, change)
            return moved if posterior(moved) >= before else None

        return step

    damped = replace(DAMPING, first=damping)
    found = levenberg_marquardt(state, linearised, lambda *_: True, damped, most_steps=MOST_STEPS)
    return found.place, DAMPING.first if found.place is state else found.damping

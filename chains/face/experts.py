"""Experts of a Rao-Blackwellised particle filter of pose: look ahead, weigh, resample (G-flow, Table 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, normalised, systematic
from ...models.face.pose import Poses
from .background import OccludedBackground
from .gauss_newton import Modes
from .pose_dynamics import PosePrior
from .texture_likelihood import NO_MAP, TextureLikelihood

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Particles:
    """Experts after a frame.

    Parameters
    ----------
    poses
        theirs.
    log_weights
        `(n,)`, normalised.
    parents
        `(n,)`: the expert of the frame before whose history and texture each has.
    log_evidence
        nats: log p(y_t | y_1:t-1) of the effective pixels.
    covariance
        `(n, dimension, dimension)`: Laplace's, of what each one's parent believed.
    """

    poses: Poses
    log_weights: Array
    parents: NDArray[np.int64]
    log_evidence: float
    covariance: Array


def log_likelihood(
    likelihood: TextureLikelihood,
    poses: Poses,
    owner: NDArray[np.int64],
    effective_pixels: float,
    background: OccludedBackground | None = None,
) -> Array:
    """log p(y_t | u_1:t, y_1:t-1) of `effective_pixels`, `(n,)` nats, eq. (17).

    Departures: the sum over pixels is tempered to that over an effective number of independent ones. Without
    a background it is the mean over the pixels that the pose covers, since a sum would favour poses that
    cover few. With a `background` foreground less background is summed over the covered pixels, eq. (18),
    relative to anything, and a common factor turns areas into effective pixels. Covered pixels whose
    background is not known count as if it explained them as well as the texture does on average: they must
    favour neither large nor small poses. A pose of which nothing faces the viewer is impossible.
    """
    squares, logs, areas, units = likelihood.sums(
        poses, owner, NO_MAP if background is None else background.contrast.unit
    ).T
    own = -0.5 * (squares + logs + np.log(2 * np.pi) * areas)
    nothing_seen = areas <= 0
    areas = np.maximum(areas, 1e-9)
    if background is None:
        alone: Array = effective_pixels * own / areas
        return np.where(nothing_seen, -np.inf, alone)
    own += units
    usual, area = float(np.median(own / areas)), float(np.median(areas))
    unknown = usual * (areas - area - background.trusted_area(likelihood, poses, owner))
    total: Array = own - unknown - background.hidden_contrast(poses, owner) + background.everywhere(owner)
    return np.where(nothing_seen, -np.inf, effective_pixels * total / area)


def propagated(log_weights: Array, modes: Modes, prior: PosePrior, log_likelihoods: Array) -> Particles:
    """Continuation frame: every expert goes on at its mode, weighed by Laplace's evidence.

    The paper's single sample with alpha = 0 makes the proposal a point mass, against which nothing can be
    weighed; the integral over the belief is (2 pi)^(d/2) |H|^(-1/2) times its maximum instead.
    """
    every = np.arange(len(log_weights))
    half_log_determinant = 0.5 * np.linalg.slogdet(modes.precision)[1]
    weights = (
        log_weights
        + log_likelihoods
        + prior.log_density(modes.poses, every)
        + 0.5 * modes.poses.dimension * np.log(2 * np.pi)
        - half_log_determinant
    )
    return Particles(modes.poses, normalised(weights), every, float(log_sum(weights)), modes.covariance)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Samples of what experts believe, from which the next particles are drawn.

    Parameters
    ----------
    poses
        `n_experts * n_samples` of them.
    owner
        expert of each.
    log_proposal
        log pi of each, in the tangent coordinates of its mode.
    covariance
        `(n_experts, dimension, dimension)`: Laplace's, before it is widened by alpha.
    """

    poses: Poses
    owner: NDArray[np.int64]
    log_proposal: Array
    covariance: Array


def sampled(modes: Modes, n_samples: int, spread: float, random: np.random.Generator) -> Proposal:
    """`n_samples` an expert from its Gaussian, eq. (19): delta = L z with L L' = alpha H^-1."""
    n, d = len(modes.poses), modes.poses.dimension
    lower = np.linalg.cholesky(modes.precision)
    z = random.standard_normal((n, n_samples, d))
    delta = np.sqrt(spread) * np.swapaxes(
        np.linalg.solve(np.swapaxes(lower, 1, 2), np.swapaxes(z, 1, 2)), 1, 2
    )
    log_determinant = 0.5 * d * np.log(spread) - np.log(np.einsum("nii->ni", lower)).sum(axis=1)
    log_proposal = -0.5 * (z**2).sum(axis=2) - 0.5 * d * np.log(2 * np.pi) - log_determinant[:, None]
    owner = np.repeat(np.arange(n), n_samples)
    poses = modes.poses[owner].moved(delta.reshape(n * n_samples, d))
    return Proposal(poses, owner, log_proposal.reshape(-1), modes.covariance)


def resampled(
    log_weights: Array,
    proposal: Proposal,
    prior: PosePrior,
    log_likelihoods: Array,
    random: np.random.Generator,
) -> Particles:
    """Resampling frame: importance weights eq. (21), credibilities eq. (28), new particles eq. (31)."""
    n, owner = len(log_weights), proposal.owner
    log_importance = log_likelihoods + prior.log_density(proposal.poses, owner) - proposal.log_proposal
    weights = log_weights[owner] + log_importance - np.log(len(owner) // n)
    chosen = systematic(weights, n, random)
    return Particles(
        proposal.poses[chosen],
        np.full(n, -np.log(n)),
        owner[chosen],
        float(log_sum(weights)),
        proposal.covariance[owner[chosen]],
    )

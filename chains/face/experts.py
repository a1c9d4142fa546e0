"""Experts of a Rao-Blackwellised particle filter of pose: find modes, weigh, resample (G-flow §3.4, Table 2).

The appendix with the formulas of Gauss-Newton is not public: `find_modes` states them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, normalised, systematic
from ...models.face.morphable_model import Poses
from ...models.numerics.threads import over_bands
from . import kernels
from .background import OccludedBackground
from .pose_terms import PointTerms, PoseEvidence, PosePrior
from .texture_likelihood import NO_MAP, TextureLikelihood

Array = NDArray[np.float64]

LONGEST_STEP = (2.0, 4.0, 8.0)  # px: longest motion of a vertex in a step, by level, at `REFERENCE_SIZE`
RELATIVE_ROUNDING = 1e-6  # of float32 sums
SHORTEST_STEP = 0.03  # px: shorter steps end the search on a level
REFERENCE_SIZE = 40.0  # px: size of the object to which lengths of steps refer
FIRST_DAMPING = 1e-3  # Levenberg's, a share of the curvature
FEW = 3  # experts up to which one thread is faster than several
MOST_STEPS = (6, 4, 4)  # evaluations on each level, fine to coarse, that at the start included


ObjectiveAt = Callable[[Poses, NDArray[np.int64]], kernels.Objective]


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of the experts' posteriors."""

    poses: Poses
    precision: Array  # `(n_experts, dimension, dimension)`: second derivatives of the energy there

    @property
    def covariance(self) -> Array:
        """Laplace's covariance `(n_experts, dimension, dimension)`."""
        return np.asarray(np.linalg.inv(self.precision), np.float64)


def find_modes(
    likelihood: TextureLikelihood,
    prior: PosePrior,
    start: Poses,
    effective_pixels: float,
    coarsest: int,
    more: Sequence[PoseEvidence] = (),
) -> Modes:
    """Find the mode of each expert's posterior from `start`, on level `coarsest` down to the finest.

    Minimises eq. (18) without its background and log terms, E(u) = beta / 2 sum a_i e_i^2 / tau_i - log
    p(u | u_t-1), with beta = effective_pixels / sum a_i: thousands of correlated pixels count as a few
    hundred. Steps are Levenberg-damped, limited in the motion of vertices, and accepted only if E falls.
    `more` evidence is added to E, linearised at the poses with which each level begins.

    With a turn w of the object as the camera sees it and p = r h c, dx/dw = -g [p]x, dx/dl = 1 and
    dx/dc = g r h; with J = (grad y)' dx/du the curvature is beta sum a_i J_i' J_i / tau_i and the prior's.
    """
    n, poses = len(start), start
    unit = float(start.sizes.mean()) / REFERENCE_SIZE
    precision = np.empty((n, start.dimension, start.dimension))
    for level in range(coarsest, -1, -1):
        terms = [evidence.around(poses, level) for evidence in more]
        objective = partial(_objective, likelihood, level, effective_pixels, terms)
        after = kernels.PoseArrays(*(part.copy() for part in _parts(poses)))

        def work(
            a: int,
            b: int,
            level: int = level,
            objective: ObjectiveAt = objective,
            after: kernels.PoseArrays = after,
        ) -> None:
            some = kernels.PoseArrays(*(part[a:b] for part in after))
            precision[a:b] = _climb(objective, prior, level, unit, some, np.arange(a, b))

        over_bands(work, n, worth=n > FEW)
        poses = Poses(*after)
    # single precision sums may miss positive definiteness by a rounding
    diagonal = np.arange(start.dimension)
    precision[:, diagonal, diagonal] *= 1 + RELATIVE_ROUNDING
    return Modes(poses, precision)


def _objective(
    likelihood: TextureLikelihood,
    level: int,
    effective_pixels: float,
    terms: Sequence[PointTerms],
    poses: Poses,
    owner: NDArray[np.int64],
) -> kernels.Objective:
    """Return the energy of poses on a level, without the prior, and its derivatives."""
    equations = likelihood.equations(level, poses, owner)
    area = equations.sums[:, 2]
    beta = effective_pixels / np.maximum(area, 1e-9)
    energy = 0.5 * beta * equations.sums[:, 0]
    gradient = beta[:, None] * equations.vectors
    curvature = beta[:, None, None] * equations.matrices
    for term in terms:
        its_energy, its_gradient, its_curvature = term.equations(poses, owner)
        energy += its_energy
        gradient += its_gradient
        curvature += its_curvature
    return kernels.Objective(energy, gradient, curvature, area > 0, equations.rows)


def _climb(
    objective: ObjectiveAt,
    prior: PosePrior,
    level: int,
    unit: float,
    poses: kernels.PoseArrays,
    experts: NDArray[np.int64],
) -> Array:
    """Minimise the energy of some experts from `poses`, overwrite these, and return the curvature there."""
    n, dimension = len(experts), len(prior.variance)
    mean = kernels.PoseArrays(*(part[experts] for part in _parts(prior.mean)))
    active, tried = np.arange(n), Poses(*poses)
    there = objective(tried, experts)
    climb = kernels.SearchState(
        poses=poses,
        energy=np.empty(n),
        gradient=np.empty((n, dimension)),
        curvature=np.empty((n, dimension, dimension)),
        rows=np.empty_like(there.rows),
        damping=np.full(n, FIRST_DAMPING),
    )
    longest, shortest = LONGEST_STEP[level] * unit, SHORTEST_STEP * unit
    for number in range(MOST_STEPS[level]):
        if number:
            there = objective(tried, experts[active])
        going = np.empty_like(active)
        following = kernels.PoseArrays(*(np.empty_like(part) for part in _parts(tried)))
        pace = kernels.StepLimits(longest, shortest, number == 0)
        n_going = kernels.advance(
            active, _parts(tried), there, mean, prior.precision, climb, pace, going, following
        )
        active, tried = going[:n_going], Poses(*(part[:n_going] for part in following))
        if not n_going:
            break
    return climb.curvature


def _parts(poses: Poses) -> kernels.PoseArrays:
    return kernels.PoseArrays(*(np.ascontiguousarray(part, np.float64) for part in poses.arrays))


@dataclass(frozen=True, eq=False)
class Particles:
    """Experts after a frame."""

    poses: Poses
    log_weights: Array  # `(n,)`, normalised
    parents: NDArray[np.int64]  # `(n,)`: the expert of the frame before from which each comes
    log_evidence: float  # nats: log p(y_t | y_1:t-1) of the effective pixels
    covariance: Array  # `(n, dimension, dimension)`: Laplace's, of each one's parent


def log_likelihood(
    likelihood: TextureLikelihood,
    poses: Poses,
    owner: NDArray[np.int64],
    effective_pixels: float,
    background: OccludedBackground | None = None,
) -> Array:
    """Return log p(y_t | u_1:t, y_1:t-1) of `effective_pixels`, `(n,)` nats, eq. (17).

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


def propagate(log_weights: Array, modes: Modes, prior: PosePrior, log_likelihoods: Array) -> Particles:
    """Move every expert to its mode, weighted by Laplace's evidence (continuation frame).

    The paper's single sample with alpha = 0 makes the proposal a point mass, against which nothing can be
    weighed; the integral over the posterior is (2 pi)^(d/2) |H|^(-1/2) times its maximum instead.
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
    """Samples of the experts' posteriors, from which the next particles are drawn."""

    poses: Poses  # `n_experts * n_samples`
    owner: NDArray[np.int64]  # expert of each
    log_proposal: Array  # log pi of each, in the tangent coordinates of its mode
    covariance: Array  # `(n_experts, dimension, dimension)`: Laplace's, before it is widened by alpha


def draw_samples(modes: Modes, n_samples: int, scale: float, random: np.random.Generator) -> Proposal:
    """Draw `n_samples` of each expert's Gaussian, eq. (19): delta = L z with L L' = alpha H^-1."""
    n, d = len(modes.poses), modes.poses.dimension
    lower = np.linalg.cholesky(modes.precision)
    z = random.standard_normal((n, n_samples, d))
    delta = np.sqrt(scale) * np.swapaxes(
        np.linalg.solve(np.swapaxes(lower, 1, 2), np.swapaxes(z, 1, 2)), 1, 2
    )
    log_determinant = 0.5 * d * np.log(scale) - np.log(np.einsum("nii->ni", lower)).sum(axis=1)
    log_proposal = -0.5 * (z**2).sum(axis=2) - 0.5 * d * np.log(2 * np.pi) - log_determinant[:, None]
    owner = np.repeat(np.arange(n), n_samples)
    poses = modes.poses[owner].moved(delta.reshape(n * n_samples, d))
    return Proposal(poses, owner, log_proposal.reshape(-1), modes.covariance)


def resample(
    log_weights: Array,
    proposal: Proposal,
    prior: PosePrior,
    log_likelihoods: Array,
    random: np.random.Generator,
) -> Particles:
    """Resample: importance weights eq. (21), credibilities eq. (28), new particles eq. (31)."""
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

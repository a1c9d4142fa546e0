"""Mode and spread of what experts believe of the pose: Gauss-Newton on several levels, Laplace's covariance.

G-flow paper §3.4.1; its appendix with the formulas is not public: `find_modes` states them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...models.face.pose import Poses
from .pose_dynamics import PosePrior
from .pose_terms import PoseEvidence, PoseTerm
from .texture_likelihood import Equations

Array = NDArray[np.float64]

LONGEST_STEP = (2.0, 4.0, 8.0)
"""px of the picture that a vertex may move in one step, by level, for an object of `REFERENCE_SIZE`."""
RELATIVE_ROUNDING = 1e-6
SHORTEST_STEP = 0.03
"""px: shorter steps end the search on a level."""
REFERENCE_SIZE = 40.0
FIRST_DAMPING = 1e-3
"""Of Levenberg, on every level: a share of the curvature."""
MOST_STEPS = (6, 4, 4)
"""Evaluations on each level, fine to coarse, the first at the start included."""


class PoseLikelihood(Protocol):
    """What a picture says of poses, as `TextureLikelihood` does for textures that experts remember."""

    def equations(self, level: int, poses: Poses, owner: NDArray[np.int64]) -> Equations:
        """Normal equations on a level at `poses`, of which number m belongs to expert `owner[m]`."""
        ...


@dataclass(frozen=True, eq=False)
class Modes:
    """Where each expert's belief has its mode.

    Parameters
    ----------
    poses
        the modes.
    precision
        `(n_experts, dimension, dimension)`: second derivatives of minus its log there.
    """

    poses: Poses
    precision: Array

    @property
    def covariance(self) -> Array:
        """Laplace's, `(n_experts, dimension, dimension)`."""
        return np.asarray(np.linalg.inv(self.precision), np.float64)


def find_modes(
    likelihood: PoseLikelihood,
    prior: PosePrior,
    start: Poses,
    effective_pixels: float,
    coarsest: int,
    more: Sequence[PoseEvidence] = (),
) -> Modes:
    """Climb from `start`, one pose an expert, with all texels on level `coarsest` down to the finest.

    Minimises eq. (18) without its background and log terms, E(u) = beta / 2 sum a_i e_i^2 / tau_i - log
    p(u | u_t-1), with beta = effective_pixels / sum a_i: thousands of correlated pixels count for a few
    hundred. Steps are Levenberg-damped, capped in the motion of vertices, and taken only when they pay.
    `more` evidence is added to E, made anew about the poses with which each level begins.

    With a turn w of the object as the camera sees it and p = r h c, dx/dw = -g [p]x, dx/dl = 1 and
    dx/dc = g r h; with J = (grad y)' dx/du the curvature is beta sum a_i J_i' J_i / tau_i and the prior's.
    """
    n, poses = len(start), start
    unit = float(start.sizes.mean()) / REFERENCE_SIZE
    for level in range(coarsest, -1, -1):
        active = np.arange(n)
        damping = np.full(n, FIRST_DAMPING)
        terms = [evidence.around(poses, level) for evidence in more]
        equations = likelihood.equations(level, poses, active)
        energy, gradient, curvature = _system(equations, prior, poses, active, effective_pixels, terms)
        for _ in range(MOST_STEPS[level] - 1):
            step = _step(gradient[active], curvature[active], damping[active])
            moves = np.einsum("nvad,nd->nva", equations.rows[active], step)
            longest = np.sqrt((moves**2).sum(axis=2).max(axis=1))
            step *= np.minimum(1, LONGEST_STEP[level] * unit / np.maximum(longest, 1e-9))[:, None]
            going = longest > SHORTEST_STEP * unit
            if not going.any():
                break
            active, step = active[going], step[going]
            tried = poses[active].moved(step)
            there = likelihood.equations(level, tried, active)
            its_energy, its_gradient, its_curvature = _system(
                there, prior, tried, active, effective_pixels, terms
            )
            better = its_energy < energy[active]
            won = active[better]
            poses = poses.replaced(won, tried[better])
            damping[won] *= 0.3
            damping[active[~better]] *= 10
            energy[won], gradient[won] = its_energy[better], its_gradient[better]
            curvature[won] = its_curvature[better]
            equations.rows[won] = there.rows[better]
    # single precision sums may miss positive definiteness by a rounding
    diagonal = np.arange(curvature.shape[1])
    precision = 0.5 * (curvature + np.swapaxes(curvature, 1, 2))
    precision[:, diagonal, diagonal] *= 1 + RELATIVE_ROUNDING
    return Modes(poses, precision)


def _system(
    equations: Equations,
    prior: PosePrior,
    poses: Poses,
    owner: NDArray[np.int64],
    effective_pixels: float,
    terms: Sequence[PoseTerm],
) -> tuple[Array, Array, Array]:
    """Energy, gradient and curvature of minus the log of the belief."""
    area = equations.sums[:, 2]
    beta = effective_pixels / np.maximum(area, 1e-9)
    energy, gradient = prior.energy(poses, owner)
    energy = np.where(area > 0, energy, np.inf)  # of an object of which nothing faces the viewer
    curvature = beta[:, None, None] * equations.matrices
    diagonal = np.arange(curvature.shape[1])
    curvature[:, diagonal, diagonal] += prior.precision
    energy = energy + 0.5 * beta * equations.sums[:, 0]
    gradient = gradient + beta[:, None] * equations.vectors
    for term in terms:
        its_energy, its_gradient, its_curvature = term.equations(poses, owner)
        energy += its_energy
        gradient += its_gradient
        curvature += its_curvature
    return energy, gradient, curvature


def _step(gradient: Array, curvature: Array, damping: Array) -> Array:
    """Solve (H + damping diag H) step = -gradient in columns of like scale (radians stand beside px)."""
    scale = 1 / np.sqrt(np.einsum("nii->ni", curvature))
    scaled = curvature * scale[:, :, None] * scale[:, None, :]
    diagonal = np.arange(scaled.shape[1])
    scaled[:, diagonal, diagonal] += damping[:, None]
    step: Array = -np.linalg.solve(scaled, (gradient * scale)[:, :, None])[:, :, 0] * scale
    return step

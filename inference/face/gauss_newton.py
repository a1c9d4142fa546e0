"""Mode and spread of what experts believe of the pose: Gauss-Newton on several levels, Laplace's covariance.

G-flow paper §3.4.1; its appendix with the formulas is not public: `find_modes` states them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...models.face.pose import Poses
from .kernels import newton as kernels
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
    unit = float(start.sizes.mean()) / REFERENCE_SIZE
    climb = _start_of_climb(start)
    for level in range(coarsest, -1, -1):
        active, tried = np.arange(len(start)), Poses(*(part.copy() for part in climb.poses))
        terms = [evidence.around(tried, level) for evidence in more]
        climb.damping[:] = FIRST_DAMPING
        for number in range(MOST_STEPS[level]):
            pace = kernels.Pace(LONGEST_STEP[level] * unit, SHORTEST_STEP * unit, number == 0)
            equations = likelihood.equations(level, tried, active)
            belief = _belief(equations, tried, active, effective_pixels, terms)
            if number == 0:
                climb = climb._replace(rows=belief.rows.copy())
            active, tried = _advanced(climb, tried, active, belief, prior, pace)
            if not len(active):
                break
    # single precision sums may miss positive definiteness by a rounding
    precision = climb.curvature
    diagonal = np.arange(precision.shape[1])
    precision[:, diagonal, diagonal] *= 1 + RELATIVE_ROUNDING
    return Modes(Poses(*climb.poses), precision)


def _start_of_climb(start: Poses) -> kernels.Climb:
    n, d = len(start), start.dimension
    parts = (start.rotations, start.translations, start.morphs)
    return kernels.Climb(
        poses=kernels.PoseArrays(*(np.array(part, np.float64, order="C") for part in parts)),
        energy=np.empty(n),
        gradient=np.empty((n, d)),
        curvature=np.empty((n, d, d)),
        rows=np.empty((n, 0, 2, 0), np.float32),
        damping=np.empty(n),
    )


def _belief(
    equations: Equations,
    poses: Poses,
    owner: NDArray[np.int64],
    effective_pixels: float,
    terms: Sequence[PoseTerm],
) -> kernels.Belief:
    """Minus the log of the belief at poses, but for the prior."""
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
    return kernels.Belief(energy, gradient, curvature, area > 0, equations.rows)


def _advanced(
    climb: kernels.Climb,
    tried: Poses,
    active: NDArray[np.int64],
    belief: kernels.Belief,
    prior: PosePrior,
    pace: kernels.Pace,
) -> tuple[NDArray[np.int64], Poses]:
    """Experts that go on, and the poses that they try next."""
    going = np.empty_like(active)
    following = kernels.PoseArrays(*(np.empty_like(part) for part in _parts(tried)))
    n = kernels.advance(
        active, _parts(tried), belief, _parts(prior.mean), prior.precision, climb, pace, going, following
    )
    return going[:n], Poses(*(part[:n] for part in following))


def _parts(poses: Poses) -> kernels.PoseArrays:
    parts = (poses.rotations, poses.translations, poses.morphs)
    return kernels.PoseArrays(*(np.ascontiguousarray(part, np.float64) for part in parts))

"""Mode and spread of what experts believe of the pose: Gauss-Newton on several levels, Laplace's covariance.

G-flow paper §3.4.1; its appendix with the formulas is not public: `find_modes` states them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...models.face.pose import Poses
from ...models.numerics.threads import over_bands
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
FEW = 3
"""Experts of which the search is done before another thread is awake."""
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
    precision = np.empty((n, start.dimension, start.dimension))
    for level in range(coarsest, -1, -1):
        terms = [evidence.around(poses, level) for evidence in more]
        belief = _Belief(likelihood, prior, level, effective_pixels, unit, terms)
        after = kernels.PoseArrays(*(part.copy() for part in _parts(poses)))

        def work(a: int, b: int, belief: "_Belief" = belief, after: kernels.PoseArrays = after) -> None:
            found = belief.climbed(kernels.PoseArrays(*(part[a:b] for part in after)), np.arange(a, b))
            precision[a:b] = found.curvature

        over_bands(work, n, worth=n > FEW)
        poses = Poses(*after)
    # single precision sums may miss positive definiteness by a rounding
    diagonal = np.arange(start.dimension)
    precision[:, diagonal, diagonal] *= 1 + RELATIVE_ROUNDING
    return Modes(poses, precision)


@dataclass(frozen=True, eq=False)
class _Belief:
    """Minus the log of what experts believe on a level."""

    likelihood: PoseLikelihood
    prior: PosePrior
    level: int
    effective_pixels: float
    unit: float
    terms: Sequence[PoseTerm]

    def climbed(self, poses: kernels.PoseArrays, experts: NDArray[np.int64]) -> kernels.Climb:
        """Climb from the `poses` of some experts, and leave the best ones found in their place."""
        n, dimension = len(experts), len(self.prior.variance)
        mean = kernels.PoseArrays(*(part[experts] for part in _parts(self.prior.mean)))
        active, tried = np.arange(n), Poses(*poses)
        there = self.at(tried, experts)
        climb = kernels.Climb(
            poses=poses,
            energy=np.empty(n),
            gradient=np.empty((n, dimension)),
            curvature=np.empty((n, dimension, dimension)),
            rows=np.empty_like(there.rows),
            damping=np.full(n, FIRST_DAMPING),
        )
        longest, shortest = LONGEST_STEP[self.level] * self.unit, SHORTEST_STEP * self.unit
        for number in range(MOST_STEPS[self.level]):
            if number:
                there = self.at(tried, experts[active])
            going = np.empty_like(active)
            following = kernels.PoseArrays(*(np.empty_like(part) for part in _parts(tried)))
            pace = kernels.Pace(longest, shortest, number == 0)
            n_going = kernels.advance(
                active, _parts(tried), there, mean, self.prior.precision, climb, pace, going, following
            )
            active, tried = going[:n_going], Poses(*(part[:n_going] for part in following))
            if not n_going:
                break
        return climb

    def at(self, poses: Poses, owner: NDArray[np.int64]) -> kernels.Belief:
        """Of poses of owners, but for the prior."""
        equations = self.likelihood.equations(self.level, poses, owner)
        area = equations.sums[:, 2]
        beta = self.effective_pixels / np.maximum(area, 1e-9)
        energy = 0.5 * beta * equations.sums[:, 0]
        gradient = beta[:, None] * equations.vectors
        curvature = beta[:, None, None] * equations.matrices
        for term in self.terms:
            its_energy, its_gradient, its_curvature = term.equations(poses, owner)
            energy += its_energy
            gradient += its_gradient
            curvature += its_curvature
        return kernels.Belief(energy, gradient, curvature, area > 0, equations.rows)


def _parts(poses: Poses) -> kernels.PoseArrays:
    parts = (poses.rotations, poses.translations, poses.morphs)
    return kernels.PoseArrays(*(np.ascontiguousarray(part, np.float64) for part in parts))

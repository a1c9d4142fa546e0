"""Evidence of poses besides the texture: where points of the surface are in the picture, as Gaussians."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..models.pose import RIGID, Poses
from . import place_kernels

Array = NDArray[np.float64]


class PoseTerm(Protocol):
    """A quadratic part of minus the log of what experts believe of the pose."""

    def equations(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Energy `(n,)`, gradient `(n, dimension)` and curvature `(n, dimension, dimension)` of the poses,
        of which number m belongs to expert `owner[m]`."""
        ...


class PoseEvidence(Protocol):
    """What else is known of poses, of which a `PoseTerm` can be made about any."""

    def around(self, poses: Poses, level: int) -> PoseTerm:
        """Term that holds about the experts' `poses` when they are sought on a `level` of the picture."""
        ...


@dataclass(frozen=True, eq=False)
class PointTerms:
    """Points of the surface that are known to be at a place: sum of (x_i - t_i)' I_i (x_i - t_i) / 2.

    Parameters
    ----------
    bases
        `(n, n_points, n_bases, 3)`: the points as linear combinations of the morph coefficients, those of
        each expert, or one row for all.
    targets
        `(n, n_points, 2)` px.
    information
        `(n, n_points, 3)` 1/px^2: the elements xx, xy and yy of I, all 0 where nothing is known.
    """

    bases: Array
    targets: Array
    information: Array

    def around(self, poses: Poses, level: int) -> Self:
        """These terms: they hold about all poses."""
        return self

    def equations(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Energy, gradient and Gauss-Newton curvature; see `PoseTerm`."""
        n, dimension = len(poses), RIGID + self.bases.shape[2]
        energy, gradient = np.empty(n), np.empty((n, dimension))
        curvature = np.empty((n, dimension, dimension))
        which = owner if len(self.bases) > 1 else np.zeros(n, np.int64)
        place_kernels.place_equations(
            poses.rotations, poses.translations, poses.morphs, which, self.bases, self.targets,
            self.information, energy, gradient, curvature,
        )  # fmt: skip
        return energy, gradient, curvature

"""Evidence of poses besides the texture: where points of the surface are in the picture, as Gaussians."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.gaussian_message import GaussianMessage
from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import RIGID, Poses
from ...models.face.surface_points import SurfacePoints
from .kernels import pose_terms as place_kernels
from .pose_dynamics import PosePrior

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


def measured_points(model: MorphableModel, message: GaussianMessage, chosen: NDArray[np.int64]) -> PointTerms:
    """What a message says of the places of vertices, of which the identities are their numbers.

    Others than those `chosen`, and those of whose place not enough is said, are left out.
    """
    identities, means, covariances = message.moments
    known = np.isin(identities, chosen)
    numbers, means = identities[known], means[known]
    precision = np.linalg.inv(covariances[known])
    information = np.stack([precision[:, 0, 0], precision[:, 0, 1], precision[:, 1, 1]], axis=1)
    bases = np.ascontiguousarray(np.swapaxes(model.bases[:, numbers], 0, 1))
    return PointTerms(bases[None], means[None], information[None])


def predicted_points(
    model: MorphableModel, prior: PosePrior, weights: Array, chosen: NDArray[np.int64]
) -> GaussianMessage:
    """Where the vertices `chosen` should be, as experts expect their poses before the picture.

    Moments of the mixture over experts, with x_i linear in the change of the pose.
    """
    model = model.of_points(SurfacePoints.of_vertices(chosen))
    places, rows = model.project(prior.mean), model.jacobian(prior.mean)
    moved = np.einsum("n,nvap,p,nvbp->vab", weights, rows, prior.variance, rows)
    mean = np.einsum("n,nva->va", weights, places)
    off = places - mean
    return GaussianMessage.from_moments(chosen, mean, moved + np.einsum("n,nva,nvb->vab", weights, off, off))

"""Evidence of poses besides the texture: points of the surface in the picture, and the object's outline.

The region terms of G-flow eq. (18) change with the pose only where the outline moves. Gauss-Newton cannot
see that in them, so the edge is searched for across the outline. Its mean and variance are Gaussian terms of
the pose, as those of points are.
"""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.gaussian_message import GaussianMessage
from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import RIGID, Poses
from ...models.face.surface_points import SurfacePoints
from ...models.face.visibility import MeshEdges, covered, outline
from .background import BackgroundContrast
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


REACH = 4
"""Steps of a scan to either side, each of a pixel of the level."""

NOISE = 1.0
"""Squared steps by which the outline of a coarse mesh is off the object's."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Evidence of the outline.

    Parameters
    ----------
    model
        shape.
    edges
        of its triangles.
    contrast
        what is known of the background.
    effective_pixels
        number of independent pixels that the object's pixels are worth.
    """

    model: MorphableModel
    edges: MeshEdges
    contrast: BackgroundContrast
    effective_pixels: float

    def around(self, poses: Poses, level: int) -> PointTerms:
        """Points of the outlines in `poses`, known along their normals where the background ends.

        Every 3 px of the outline the edge is at s on its normal, within 4 px of the level, with density
        exp(sum of the border beyond s): known background against the object's tones. Its mean and variance
        make a Gaussian, and that of the scan itself is taken out again.
        """
        positions = self.model.project(poses)
        box = self.contrast.box
        inside = covered(positions, self.edges.triangles, box)
        found = outline(positions, self.edges, inside, box)
        every = np.arange(len(poses))[:, None, None]
        ends = positions[every, found.vertices]
        places = (ends * found.weights[..., None]).sum(axis=2)
        share = self.effective_pixels / np.maximum(inside.sum(axis=(1, 2)), 1)
        targets = np.empty_like(places)
        information = np.empty((*places.shape[:2], 3))
        scans = place_kernels.Scans(
            places, found.normals.astype(np.float64), found.lengths.astype(np.float64), REACH, float(2**level)
        )
        place_kernels.find_edges(self.contrast.border, box, scans, share, NOISE, targets, information)
        bases = self.model.bases[:, found.vertices]  # (n_bases, n, n_points, 2, 3)
        bases = np.einsum("npe,knpec->npkc", found.weights, bases)
        return PointTerms(np.ascontiguousarray(bases), targets, information)

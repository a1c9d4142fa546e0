"""Terms of the pose besides the texture: dynamics, points of the surface, and the outline.

The region terms of G-flow eq. (18) change with the pose only where the outline moves, for which Gauss-Newton
has no derivative. So the edge is searched for across the outline; its mean and variance are Gaussian terms of
the pose, as those of points.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Positive, checked
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.face.morphable_model import RIGID, MorphableModel, Poses, SurfacePoints
from ...models.face.surface import MeshEdges, covered, outline
from . import kernels
from .background import BackgroundContrast

Array = NDArray[np.float64]

SHORTEST = 1e-6  # s: least time between two pictures, so that no variance is 0


@checked
@short_repr
@dataclass(frozen=True)
class PoseDynamics:
    """Random walk of poses in continuous time, mean-reverting in size and shape.

    Rotation and translation: du = Q^1/2 dw. A morph coefficient c of mean m, range s and walk q is an
    Ornstein-Uhlenbeck process, dc = q (m - c) / (2 s^2) dt + q^1/2 dw, whose distribution in the long run is
    N(m, s^2). Departure: the paper (§2.3) multiplies the walk by N(m, s^2) once a frame, which draws the more
    the more frames a second has.

    Lengths are in sizes of the object, its first morph coefficient; standard deviations.

    Parameters
    ----------
    rotation
        rad after one second.
    translation
        sizes after one second.
    size
        of the size, after one second of a free walk.
    morphs
        of the other coefficients in sizes, after one second of a free walk.
    size_range
        of the size about the one at the start.
    morph_range
        of the other coefficients about zero, in sizes.
    """

    rotation: Positive = 0.6
    translation: Positive = 1.0
    size: Positive = 0.05
    morphs: Positive = 4.0
    size_range: Positive = 0.11
    morph_range: Positive = 0.8

    def transition(self, size: float, dimension: int, elapsed: float) -> tuple[Array, Array]:
        """Return the transition after `elapsed` seconds, for an object that had `size` px at the start.

        Returns
        -------
        memory
            `(dimension - 5,)`: remaining share of the deviations from the mean morph coefficients.
        variance
            `(dimension,)` of the change.
        """
        rates = np.full(dimension, (self.morphs * size) ** 2)
        rates[:3] = self.rotation**2
        rates[3:RIGID] = (self.translation * size) ** 2
        rates[RIGID] = (self.size * size) ** 2
        walk = rates * max(elapsed, SHORTEST)
        range_variance = np.full(dimension - RIGID, (self.morph_range * size) ** 2)
        range_variance[0] = (self.size_range * size) ** 2
        decay = walk[RIGID:] / range_variance
        walk[RIGID:] = -range_variance * np.expm1(-decay)
        return np.exp(-0.5 * decay), walk


@dataclass(frozen=True, eq=False)
class PosePrior:
    """p(u_t | u_s) of experts: Gaussian in the change from the predicted poses."""

    mean: Poses  # predicted
    variance: Array  # `(dimension,)` of a change from them

    @classmethod
    def after(cls, previous: Poses, dynamics: PoseDynamics, size: float, elapsed: float) -> "PosePrior":
        """Return the prior `elapsed` s after `previous`, of an object that had `size` px at the start."""
        memory, variance = dynamics.transition(size, previous.dimension, elapsed)
        usual = np.zeros(len(memory))
        usual[0] = size
        return cls(replace(previous, morphs=usual + memory * (previous.morphs - usual)), variance)

    def energy(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return minus the log density `(n,)` up to a constant, and its gradient `(n, dimension)`.

        The gradient identifies the tangent spaces of both poses, an approximation for small rotations.
        """
        change = poses.changes_from(self.mean[owner])
        gradient = change * self.precision
        return 0.5 * (change * gradient).sum(axis=1), gradient

    @property
    def precision(self) -> Array:
        """`(dimension,)`: second derivatives of the energy."""
        return 1 / self.variance

    def log_density(self, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """Return log p(u_t | u_s) `(n,)`."""
        normaliser = -0.5 * np.log(2 * np.pi * self.variance).sum()
        density: Array = normaliser - self.energy(poses, owner)[0]
        return density


@dataclass(frozen=True, eq=False)
class PointTerms:
    """Gaussian terms of points of the surface: sum of (x_i - t_i)' I_i (x_i - t_i) / 2."""

    bases: Array  # `(n, n_points, n_bases, 3)`: the points' bases, of each expert, or one row for all
    targets: Array  # `(n, n_points, 2)` px
    information: Array  # `(n, n_points, 3)` 1/px^2: the elements xx, xy and yy of I

    def around(self, poses: Poses, level: int) -> Self:
        """Return these terms, which hold about all poses."""
        return self

    def equations(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return energy `(n,)`, gradient `(n, dimension)` and Gauss-Newton curvature `(n, dimension,
        dimension)` of poses, of which number m belongs to expert `owner[m]`."""
        n, dimension = len(poses), RIGID + self.bases.shape[2]
        energy, gradient = np.empty(n), np.empty((n, dimension))
        curvature = np.empty((n, dimension, dimension))
        which = owner if len(self.bases) > 1 else np.zeros(n, np.int64)
        kernels.place_equations(
            poses.rotations, poses.translations, poses.morphs, which, self.bases, self.targets,
            self.information, energy, gradient, curvature,
        )  # fmt: skip
        return energy, gradient, curvature


def measured_points(model: MorphableModel, message: GaussianMessage, chosen: NDArray[np.int64]) -> PointTerms:
    """Return the terms of a message about vertices, whose identities are their numbers.

    Only those `chosen` that have a proper density are included.
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
    """Return the predicted positions of the vertices `chosen`.

    Moments of the mixture over experts, with x_i linear in the change of the pose.
    """
    model = model.of_points(SurfacePoints.of_vertices(chosen))
    places, rows = model.project(prior.mean), model.jacobian(prior.mean)
    moved = np.einsum("n,nvap,p,nvbp->vab", weights, rows, prior.variance, rows)
    mean = np.einsum("n,nva->va", weights, places)
    off = places - mean
    return GaussianMessage.from_moments(chosen, mean, moved + np.einsum("n,nva,nvb->vab", weights, off, off))


REACH = 4  # steps of a scan to either side, each of a pixel of the level
NOISE = 1.0  # squared steps: variance of a coarse mesh's outline about the object's


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Evidence of the outline."""

    model: MorphableModel
    edges: MeshEdges
    contrast: BackgroundContrast
    effective_pixels: float  # effective number of independent pixels of the object

    def around(self, poses: Poses, level: int) -> PointTerms:
        """Return the terms of the outlines in `poses`: where the background ends along their normals.

        Every 3 px of the outline the edge is at s on its normal, within 4 px of the level, with density
        exp(sum of the border beyond s): background against the object's tones. The term is the Gaussian of
        the same mean and variance, divided by that of the scan itself.
        """
        positions = self.model.project(poses)
        region = self.contrast.region
        inside = covered(positions, self.edges.triangles, region)
        found = outline(positions, self.edges, inside, region)
        every = np.arange(len(poses))[:, None, None]
        ends = positions[every, found.vertices]
        places = (ends * found.weights[..., None]).sum(axis=2)
        share = self.effective_pixels / np.maximum(inside.sum(axis=(1, 2)), 1)
        targets = np.empty_like(places)
        information = np.empty((*places.shape[:2], 3))
        scans = kernels.Scans(
            places, found.normals.astype(np.float64), found.lengths.astype(np.float64), REACH, float(2**level)
        )
        kernels.find_edges(self.contrast.border, region, scans, share, NOISE, targets, information)
        bases = self.model.bases[:, found.vertices]  # (n_bases, n, n_points, 2, 3)
        bases = np.einsum("npe,knpec->npkc", found.weights, bases)
        return PointTerms(np.ascontiguousarray(bases), targets, information)


PoseEvidence = PointTerms | Silhouette  # further evidence of poses

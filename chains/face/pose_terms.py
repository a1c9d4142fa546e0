"""What is known of poses besides the texture: how an object moves, points of its surface, and its outline.

The region terms of G-flow eq. (18) change with the pose only where the outline moves. Gauss-Newton cannot
see that in them, so the edge is searched for across the outline. Its mean and variance are Gaussian terms of
the pose, as those of points are.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.face.morphable_model import RIGID, MorphableModel, Poses, SurfacePoints
from ...models.face.surface import MeshEdges, covered, outline
from . import kernels
from .background import BackgroundContrast

Array = NDArray[np.float64]

SHORTEST = 1e-6  # s: two pictures of one time are taken for this far apart, so that no variance is 0


@short_repr
@dataclass(frozen=True)
class PoseDynamics:
    """A random walk in continuous time, of which size and shape are drawn back to what is usual.

    Rotation and translation: du = Q^1/2 dw. A morph coefficient c of usual value m, range s and walk q is an
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

    rotation: float = 0.6
    translation: float = 1.0
    size: float = 0.05
    morphs: float = 4.0
    size_range: float = 0.11
    morph_range: float = 0.8

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name}: got {value}, expected more than 0")

    def transition(self, size: float, dimension: int, elapsed: float) -> tuple[Array, Array]:
        """Moments of poses after `elapsed` seconds, for an object that had `size` px at the start.

        Returns
        -------
        memory
            `(dimension - 5,)`: share of the deviations from the usual morph coefficients that is left.
        variance
            `(dimension,)` of the change about that.
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
    """p(u_t | u_s) of experts, each with its own earlier pose: Gaussian in a change from the expected one."""

    mean: Poses  # the expected poses
    variance: Array  # `(dimension,)` of a change from them

    @classmethod
    def after(cls, previous: Poses, dynamics: PoseDynamics, size: float, elapsed: float) -> "PosePrior":
        """Prior of poses `elapsed` seconds after `previous`, of an object that had `size` px at the start."""
        memory, variance = dynamics.transition(size, previous.dimension, elapsed)
        usual = np.zeros(len(memory))
        usual[0] = size
        return cls(replace(previous, morphs=usual + memory * (previous.morphs - usual)), variance)

    def energy(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array]:
        """Minus log density `(n,)` up to a constant, and its gradient `(n, dimension)` in a change of pose.

        The gradient takes the tangent spaces of both poses for one, which they are for small turns.
        """
        change = poses.changes_from(self.mean[owner])
        gradient = change * self.precision
        return 0.5 * (change * gradient).sum(axis=1), gradient

    @property
    def precision(self) -> Array:
        """`(dimension,)`: second derivatives of the energy."""
        return 1 / self.variance

    def log_density(self, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """log p(u_t | u_s) `(n,)`."""
        normaliser = -0.5 * np.log(2 * np.pi * self.variance).sum()
        density: Array = normaliser - self.energy(poses, owner)[0]
        return density


@dataclass(frozen=True, eq=False)
class PointTerms:
    """Points of the surface that are known to be at a place: sum of (x_i - t_i)' I_i (x_i - t_i) / 2."""

    # `(n, n_points, n_bases, 3)`: the points by morph coefficients, of each expert, or one row for all
    bases: Array
    targets: Array  # `(n, n_points, 2)` px
    # `(n, n_points, 3)` 1/px^2: the elements xx, xy and yy of I, all 0 where nothing is known
    information: Array

    def around(self, poses: Poses, level: int) -> Self:
        """These terms: they hold about all poses."""
        return self

    def equations(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Energy `(n,)`, gradient `(n, dimension)` and Gauss-Newton curvature `(n, dimension, dimension)` of
        poses, of which number m belongs to expert `owner[m]`."""
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


REACH = 4  # steps of a scan to either side, each of a pixel of the level
NOISE = 1.0  # squared steps by which the outline of a coarse mesh is off the object's


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Evidence of the outline."""

    model: MorphableModel  # shape
    edges: MeshEdges  # of its triangles
    contrast: BackgroundContrast  # what is known of the background
    effective_pixels: float  # number of independent pixels that the object's pixels are worth

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
        scans = kernels.Scans(
            places, found.normals.astype(np.float64), found.lengths.astype(np.float64), REACH, float(2**level)
        )
        kernels.find_edges(self.contrast.border, box, scans, share, NOISE, targets, information)
        bases = self.model.bases[:, found.vertices]  # (n_bases, n, n_points, 2, 3)
        bases = np.einsum("npe,knpec->npkc", found.weights, bases)
        return PointTerms(np.ascontiguousarray(bases), targets, information)


PoseEvidence = PointTerms | Silhouette  # what else is known of poses, of which terms can be made about any

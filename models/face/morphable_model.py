"""A 3-D morphable model: vertices that are linear in morph coefficients, seen under weak perspective."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.short_repr import PickledByFields, short_repr
from ..numerics.rotations import cross_matrices
from .pose import RIGID, Poses
from .surface_points import SurfacePoints

Array = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class MorphableModel(PickledByFields):
    """Shape of a deformable object (G-flow paper §2.1): vertex i is at h_i c in the object's coordinates.

    Seen from the front and upright (rotation 1) x points right, y down and z away from the viewer. Bases are
    scaled so that c_1 is in px of the picture (the first basis, the typical shape, has root mean square
    distance 1 from its centroid over x and y) and that c_j / c_1 of the others is about standard normal.

    Parameters
    ----------
    bases
        `(n_bases, n_vertices, 3)`: the first is the typical shape, the others deform it; a single one is a
        rigid object.
    triangles
        `(n_triangles, 3)` int64, vertex numbers; counter-clockwise as the viewer in front sees them with
        y down, so that normals (cross products of edges) of what he sees have z < 0.
    identity
        how many bases after the first say who it is and not what the face does; constant for a person.
    names
        of the bases, or none.
    landmarks
        `(n_landmarks,)` int64: the vertex at each landmark of the list that belongs to the model, -1 where
        it has none; `None` without such a list.

    Raises
    ------
    ValueError
        if shapes do not fit, a number is not finite, or a triangle or landmark names a vertex that is not
        there.
    """

    bases: Array
    triangles: NDArray[np.int64]
    identity: int = 0
    names: tuple[str, ...] = ()
    landmarks: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.bases)
        if len(shape) != 3 or shape[2] != 3 or 0 in shape:
            raise ValueError(f"bases: got {shape}, expected (n_bases, n_vertices, 3)")
        if not np.isfinite(self.bases).all():
            basis, vertex = np.argwhere(~np.isfinite(self.bases))[0, :2]
            raise ValueError(f"bases: got a number that is not finite in basis {basis} at vertex {vertex}")
        if np.ndim(self.triangles) != 2 or np.shape(self.triangles)[1] != 3:
            raise ValueError(f"triangles: got {np.shape(self.triangles)}, expected (n_triangles, 3)")
        if not 0 <= self.identity < len(self.bases):
            raise ValueError(f"identity: got {self.identity}, expected 0 to {len(self.bases) - 1}")
        if self.names and len(self.names) != len(self.bases):
            raise ValueError(
                f"names: got {len(self.names)}, expected one for each of {len(self.bases)} bases"
            )
        landmarks = np.zeros(0, np.int64) if self.landmarks is None else self.landmarks
        if np.ndim(landmarks) != 1:
            raise ValueError(f"landmarks: got {np.shape(landmarks)}, expected (n_landmarks,)")
        for what, least, numbers in (("triangle", 0, self.triangles), ("landmark", -1, landmarks)):
            if numbers.dtype.kind not in "iu":
                raise ValueError(f"{what}s: got {numbers.dtype}, expected whole numbers of vertices")
            wrong = np.argwhere((numbers < least) | (numbers >= shape[1]))
            if len(wrong):
                number, found = wrong[0, 0], numbers[tuple(wrong[0])]
                raise ValueError(f"{what} {number}: got vertex {found}, expected {least} to {shape[1] - 1}")

    @property
    def n_bases(self) -> int:
        """Number of morph bases, k."""
        return len(self.bases)

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        return len(self.bases[0])

    @cached_property
    def _flat_bases(self) -> Array:
        return np.ascontiguousarray(self.bases.reshape(self.n_bases, -1))

    def turned(self, poses: Poses) -> Array:
        """r h_i c: `(n, n_vertices, 3)` px in the camera's axes, from the object's origin."""
        shapes = (poses.morphs @ self._flat_bases).reshape(len(poses), self.n_vertices, 3)
        return shapes @ np.swapaxes(poses.rotations, -1, -2)

    def positions(self, poses: Poses) -> Array:
        """`(n, n_vertices, 3)` px: where vertices are seen (x, y), and how far they are behind the origin."""
        turned = self.turned(poses)
        turned[..., :2] += poses.translations[:, None, :]
        return turned

    def project(self, poses: Poses) -> Array:
        """x_i = g r h_i c + l: `(n, n_vertices, 2)` px."""
        projected: Array = self.positions(poses)[..., :2]
        return projected

    def jacobian(self, poses: Poses) -> Array:
        """d x_i / d u at each pose: `(n, n_vertices, 2, dimension)`, in the order of a change of `Poses`."""
        return self._jacobian(poses, 2)

    def jacobian_with_depth(self, poses: Poses) -> Array:
        """The same of `positions`: `(n, n_vertices, 3, dimension)`."""
        return self._jacobian(poses, 3)

    def _jacobian(self, poses: Poses, n_axes: int) -> Array:
        turned = self.turned(poses)
        rows = np.zeros((len(poses), self.n_vertices, n_axes, poses.dimension))
        rows[..., :3] = -cross_matrices(turned)[..., :n_axes, :]
        rows[..., 0, 3] = rows[..., 1, 4] = 1
        rows[..., RIGID:] = np.einsum("nab,kvb->nvak", poses.rotations[:, :n_axes], self.bases)
        return rows

    def of_points(self, points: SurfacePoints) -> "MorphableModel":
        """The model whose vertices are `points` on the surface of this one, without triangles."""
        return replace(self, bases=points.bases(self), triangles=np.zeros((0, 3), np.int64), landmarks=None)

    def landmark_points(self, numbers: ArrayLike) -> SurfacePoints:
        """The points at landmarks of the model's own list, given by their `numbers` `(n,)` in it (from 1).

        Raises
        ------
        ValueError
            if the model has no such list, or no vertex at one of the landmarks.
        """
        if self.landmarks is None:
            raise ValueError("the model has no list of landmarks")
        chosen = np.asarray(numbers, np.int64)
        inside = (chosen >= 1) & (chosen <= len(self.landmarks))
        vertices = np.where(inside, self.landmarks[np.where(inside, chosen, 1) - 1], -1)
        if (vertices < 0).any():
            raise ValueError(
                f"landmark {chosen[vertices < 0][0]}: the model has no vertex there; it has "
                f"{(self.landmarks >= 0).sum()} of landmarks 1 to {len(self.landmarks)}"
            )
        return SurfacePoints.of_vertices(vertices)

    def personalised(self, morphs: Array) -> "MorphableModel":
        """The model of one person: what the identity bases say goes into the typical shape.

        Parameters
        ----------
        morphs
            `(n_bases,)` px, of that person in any pose of this model; those of expressions are not used.

        Returns
        -------
        MorphableModel
            with 1 + n_bases - 1 - identity bases, scaled to the new typical shape. Ratios c_j / c_1 of the
            expressions mean the same as before.

        Raises
        ------
        ValueError
            if the number of coefficients is not the model's, or the first is not positive.
        """
        if np.shape(morphs) != (self.n_bases,) or not morphs[0] > 0:
            raise ValueError(
                f"morphs: got {np.shape(morphs)}, expected ({self.n_bases},) with a first one above 0"
            )
        end = 1 + self.identity
        shares = np.append(1.0, morphs[1:end] / morphs[0])
        typical = np.einsum("k,kvc->vc", shares, self.bases[:end])
        bases = np.concatenate([typical[None], self.bases[end:]]) / spread(typical)
        return replace(self, bases=bases, identity=0, names=self.names[:1] + self.names[end:])


def spread(shape: Array) -> float:
    """Root mean square distance of vertices `(n_vertices, 3)` from their centroid, over x and y."""
    return float(np.sqrt(shape[:, :2].var(axis=0).sum()))

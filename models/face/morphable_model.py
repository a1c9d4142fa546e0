"""A 3-D morphable model under weak perspective, its poses u = {r, l, c}, and points on its surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.checks import Bound, Count, Shape, checked
from ..core.short_repr import PickledByFields, Rows, short_repr
from ..numerics.rotations import cross_matrices, exponential, logarithm, nearest_rotation

Array = NDArray[np.float64]

FROM_0 = Bound(lambda numbers: bool((numbers >= 0).all()), "numbers of vertices, from 0")
RIGID = 5  # degrees of freedom of rotation and translation, which come before the morph coefficients


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class Poses(Rows):
    """Array of poses under weak perspective (G-flow paper §2.1); NaN in those of which nothing is known.

    Small changes of a pose are vectors of `dimension` numbers: a rotation vector w (rad) that turns the
    object as the camera sees it, r <- exp([w]x) r, then px of translation, then changes of the coefficients.

    Parameters
    ----------
    rotations
        `(n, 3, 3)`, from the object to the camera: x right, y down, z away from the viewer.
    translations
        `(n, 2)` px: where the object's origin is seen.
    morphs
        `(n, n_bases)` px: weights of the morph bases; the first is the size of the object in the picture.
    """

    rotations: Annotated[Array, Shape("n", 3, 3, finite=False)]
    translations: Annotated[Array, Shape("n", 2, finite=False)]
    morphs: Annotated[Array, Shape("n", "n_bases", finite=False)]

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, chosen: Any) -> Self:
        """Select poses by a slice, a mask or indices; a single number gives a batch of one."""
        if isinstance(chosen, int | np.integer):
            chosen = [chosen]
        return self.only(chosen)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """Rotations, translations and morphs."""
        return self.rotations, self.translations, self.morphs

    @property
    def dimension(self) -> int:
        """Degrees of freedom: five and one for each morph basis."""
        return RIGID + int(self.morphs.shape[1])

    @property
    def sizes(self) -> Array:
        """`(n,)` px: the first morph coefficient, c_1."""
        return self.morphs[:, 0]

    @classmethod
    @checked
    def upright(
        cls,
        translations: Annotated[Array, Shape("n", 2)],
        sizes: Annotated[Array, Shape("n")],
        n_bases: Count,
    ) -> Self:
        """Return upright, undeformed poses at `translations` `(n, 2)` px, of `sizes` `(n,)` px."""
        n = len(translations)
        morphs = np.zeros((n, n_bases))
        morphs[:, 0] = sizes
        return cls(np.tile(np.eye(3), (n, 1, 1)), np.asarray(translations, np.float64), morphs)

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """Concatenate poses."""
        return parts[0].joined(parts[1:])

    def replaced(self, which: NDArray[np.int64], poses: "Poses") -> Self:
        """Return these poses with rows `which` `(k,)` replaced by `poses`."""
        changed = type(self)(*(each.copy() for each in self.arrays))
        for own, new in zip(changed.arrays, poses.arrays, strict=True):
            own[which] = new
        return changed

    def moved(self, changes: Array) -> Self:
        """Apply `changes` `(n, dimension)` to these poses, or to one pose."""
        turned = exponential(changes[:, :3]) @ self.rotations
        # one Newton step towards the nearest rotation keeps rounding from growing over a long film
        turned = turned @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(turned, -1, -2) @ turned)
        return type(self)(turned, self.translations + changes[:, 3:5], self.morphs + changes[:, 5:])

    def changes_from(self, other: "Poses") -> Array:
        """Return the changes `(n, dimension)` from `other` to these poses, inverse to `other.moved(...)`."""
        turned = logarithm(self.rotations @ np.swapaxes(other.rotations, -1, -2))
        return np.concatenate(
            [turned, self.translations - other.translations, self.morphs - other.morphs], axis=1
        )

    def mean(self, weights: Array) -> Self:
        """Return the weighted mean pose, of rotations the chordal one (nearest to the mean matrix)."""
        share = weights / weights.sum()
        rotation = nearest_rotation(np.einsum("n,nij->ij", share, self.rotations))
        return type(self)(rotation[None], (share @ self.translations)[None], (share @ self.morphs)[None])


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points by three vertices each: sum_a weights_a h_a c + c_1 offset in the object's coordinates."""

    vertices: Annotated[NDArray[np.int64], Shape("n", 3), FROM_0]
    weights: Annotated[Array, Shape("n", 3)]  # summing to one
    offsets: Annotated[Array, Shape("n", 3)]  # from the surface, in units of c_1 and the object's axes

    def __len__(self) -> int:
        return len(self.vertices)

    @classmethod
    def of_vertices(cls, numbers: ArrayLike) -> Self:
        """Return the points at the vertices with these `numbers` `(n,)`."""
        chosen = np.asarray(numbers, np.int64)
        weights = np.tile([1.0, 0.0, 0.0], (len(chosen), 1))
        return cls(np.repeat(chosen[:, None], 3, axis=1), weights, np.zeros((len(chosen), 3)))

    @classmethod
    def attached(cls, model: "MorphableModel", pose: Poses, places: Array) -> Self:
        """Return points on the surface that are seen at `places` when the object is in `pose`.

        Each is on the front-most triangle at its place. Outside of the silhouette it is the nearest visible
        surface point with an offset in the plane of the picture; so all places are met exactly in this pose.

        `model`: with triangles; `pose`: one; `places` `(n, 2)` px. Raises `ValueError` if there is more than
        one pose, the model has no triangles, or a place is not finite.
        """
        if len(pose) != 1 or len(model.triangles) == 0:
            raise ValueError(
                f"attaching points: got {len(pose)} poses and {len(model.triangles)} triangles, "
                "expected one pose and a model with triangles"
            )
        places = np.asarray(places, np.float64)
        if places.ndim != 2 or places.shape[1] != 2:
            raise ValueError(f"places: got {places.shape}, expected (n, 2) px")
        if not np.isfinite(places).all():
            place = np.argwhere(~np.isfinite(places))[0, 0]
            raise ValueError(f"place {place}: got {places[place].tolist()}, expected finite px")
        corners = model.positions(pose)[0][model.triangles]
        chosen, weights = _seen_at(places, corners)
        held = np.einsum("na,nac->nc", weights, corners[chosen, :, :2])
        missing = np.concatenate([places - held, np.zeros((len(places), 1))], axis=1)
        missing[np.abs(missing) < 1e-9 * pose.sizes[0]] = 0  # rounding: it is on the surface
        return cls(model.triangles[chosen], weights, missing @ pose.rotations[0] / pose.sizes[0])

    def bases(self, model: "MorphableModel") -> Array:
        """Return the bases of the points, `(n_bases, n, 3)`."""
        bases: Array = np.einsum("na,knac->knc", self.weights, model.bases[:, self.vertices])
        bases[0] += self.offsets
        return bases

    def project(self, model: "MorphableModel", poses: Poses) -> Array:
        """Return image positions of the points, `(n_poses, n, 2)` px."""
        return model.of_points(self).project(poses)


def _seen_at(places: Array, corners: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the triangle at each place and weights of its corners: the front-most, or the nearest one."""
    weights = _nearest_weights(places, corners[..., :2])
    found = np.einsum("nta,tac->ntc", weights, corners)
    distance = np.linalg.norm(places[:, None] - found[..., :2], axis=2)
    # As near as the nearest, up to rounding: all triangles over the place, or those that share the point.
    reach = 1e-9 * (1 + np.ptp(corners[..., :2]))
    near = distance <= distance.min(axis=1, keepdims=True) + reach
    chosen = np.where(near, found[..., 2], np.inf).argmin(axis=1)
    return chosen, weights[np.arange(len(places)), chosen]


def _nearest_weights(places: Array, corners: Array) -> Array:
    """Weights `(n, n_triangles, 3)` of corners `(n_triangles, 3, 2)` at the point nearest to each place."""
    weights = np.zeros((len(places), len(corners), 3))
    least = np.full((len(places), len(corners)), np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):  # on the edges
        edge = corners[:, b] - corners[:, a]
        away = places[:, None] - corners[:, a]
        length = np.maximum((edge**2).sum(axis=1), 1e-300)
        along = np.clip(np.einsum("ntc,tc->nt", away, edge) / length, 0, 1)
        squared = ((away - along[..., None] * edge) ** 2).sum(axis=2)
        nearer = squared < least
        least = np.where(nearer, squared, least)
        on_edge = np.zeros_like(weights)
        on_edge[..., a], on_edge[..., b] = 1 - along, along
        weights = np.where(nearer[..., None], on_edge, weights)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    flat = np.abs(area) < 1e-12
    away = places[:, None] - corners[:, 0]
    of_b = (away[..., 0] * second[:, 1] - away[..., 1] * second[:, 0]) / np.where(flat, 1, area)
    of_c = (first[:, 0] * away[..., 1] - first[:, 1] * away[..., 0]) / np.where(flat, 1, area)
    within = np.stack([1 - of_b - of_c, of_b, of_c], axis=2)
    inside = (within.min(axis=2) >= 0) & ~flat
    chosen: Array = np.where(inside[..., None], within, weights)
    return chosen


KNOWN = Bound(lambda poses: all(np.isfinite(each).all() for each in poses.arrays), "poses without NaN")
"""Of poses of which everything is known."""


@checked
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
        number of bases after the first that describe the person, not the expression; constant for a person.
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

    bases: Annotated[Array, Shape("n_bases", "n_vertices", 3, finite=False)]
    triangles: Annotated[NDArray[np.int64], Shape("n_triangles", 3)]
    identity: int = 0
    names: tuple[str, ...] = ()
    landmarks: Annotated[NDArray[np.int64], Shape("n_landmarks")] | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.bases)
        if len(shape) != 3 or shape[2] != 3 or 0 in shape:
            raise ValueError(f"bases: got {shape}, expected (n_bases, n_vertices, 3)")
        if not np.isfinite(self.bases).all():
            basis, vertex = np.argwhere(~np.isfinite(self.bases))[0, :2]
            raise ValueError(f"bases: got a number that is not finite in basis {basis} at vertex {vertex}")
        if not 0 <= self.identity < len(self.bases):
            raise ValueError(f"identity: got {self.identity}, expected 0 to {len(self.bases) - 1}")
        if self.names and len(self.names) != len(self.bases):
            raise ValueError(
                f"names: got {len(self.names)}, expected one for each of {len(self.bases)} bases"
            )
        landmarks = np.zeros(0, np.int64) if self.landmarks is None else self.landmarks
        for what, least, numbers in (("triangle", 0, self.triangles), ("landmark", -1, landmarks)):
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
        """Return r h_i c, `(n, n_vertices, 3)` px in the camera's axes, from the object's origin."""
        if not isinstance(poses, Poses):
            raise TypeError(f"poses: got a {type(poses).__name__}, expected Poses")
        if poses.morphs.shape[1] != self.n_bases:
            raise ValueError(f"poses: got {poses.morphs.shape[1]} morphs each, expected {self.n_bases}")
        shapes = (poses.morphs @ self._flat_bases).reshape(len(poses), self.n_vertices, 3)
        return shapes @ np.swapaxes(poses.rotations, -1, -2)

    def positions(self, poses: Poses) -> Array:
        """Return image positions of vertices and their depths from the origin, `(n, n_vertices, 3)` px."""
        turned = self.turned(poses)
        turned[..., :2] += poses.translations[:, None, :]
        return turned

    def project(self, poses: Poses) -> Array:
        """Return x_i = g r h_i c + l, `(n, n_vertices, 2)` px."""
        projected: Array = self.positions(poses)[..., :2]
        return projected

    def jacobian(self, poses: Poses, n_axes: int = 2) -> Array:
        """Return d x_i / d u, with depth for three axes, `(n, n_vertices, n_axes, dimension)`.

        The order of u is that of a change of `Poses`.
        """
        turned = self.turned(poses)
        rows = np.zeros((len(poses), self.n_vertices, n_axes, poses.dimension))
        rows[..., :3] = -cross_matrices(turned)[..., :n_axes, :]
        rows[..., 0, 3] = rows[..., 1, 4] = 1
        rows[..., RIGID:] = np.einsum("nab,kvb->nvak", poses.rotations[:, :n_axes], self.bases)
        return rows

    def of_points(self, points: SurfacePoints) -> "MorphableModel":
        """Return the model whose vertices are `points` of this one, without triangles."""
        return replace(self, bases=points.bases(self), triangles=np.zeros((0, 3), np.int64), landmarks=None)

    def landmark_points(self, numbers: ArrayLike) -> SurfacePoints:
        """Return the points at landmarks of the model's own list, by their `numbers` `(n,)` in it (from 1).

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
        """Return the model of one person, with the identity bases absorbed in the typical shape.

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
        bases = np.concatenate([typical[None], self.bases[end:]]) / rms_radius(typical)
        return replace(self, bases=bases, identity=0, names=self.names[:1] + self.names[end:])


def rms_radius(shape: Array) -> float:
    """Return the root mean square distance of vertices `(n_vertices, 3)` from their centroid, over x, y."""
    return float(np.sqrt(shape[:, :2].var(axis=0).sum()))

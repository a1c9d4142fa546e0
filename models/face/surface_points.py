"""Points that ride on the surface of a morphable model: landmarks, texels, whatever moves with the object."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .pose import Poses

if TYPE_CHECKING:
    from .morphable_model import MorphableModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points given by three vertices each: sum_a weights_a h_a c + c_1 offset in the object's coordinates.

    Parameters
    ----------
    vertices
        `(n, 3)` int64, vertex numbers.
    weights
        `(n, 3)`, summing to one for a point on the surface or beside it.
    offsets
        `(n, 3)` in units of c_1, in the object's axes: how far off the surface a point is held.
    """

    vertices: NDArray[np.int64]
    weights: Array
    offsets: Array

    def __len__(self) -> int:
        return len(self.vertices)

    @classmethod
    def of_vertices(cls, numbers: ArrayLike) -> Self:
        """The vertices with these `numbers` `(n,)`."""
        chosen = np.asarray(numbers, np.int64)
        weights = np.tile([1.0, 0.0, 0.0], (len(chosen), 1))
        return cls(np.repeat(chosen[:, None], 3, axis=1), weights, np.zeros((len(chosen), 3)))

    @classmethod
    def attached(cls, model: "MorphableModel", pose: Poses, places: Array) -> Self:
        """Fix points to the surface that are seen at `places` when the object is in `pose`.

        Each is on the front-most triangle under its place. Beside the object's silhouette it is held by the
        surface point that is seen nearest to it, at the offset in the plane of the picture that is missing;
        so all places are met exactly in this pose.

        Parameters
        ----------
        model
            with triangles.
        pose
            one.
        places
            `(n, 2)` px.

        Raises
        ------
        ValueError
            if there is more than one pose, the model has no triangles, or a place is not finite.
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
        """`(n_bases, n, 3)`: the points as linear combinations of the morph coefficients, like vertices."""
        bases: Array = np.einsum("na,knac->knc", self.weights, model.bases[:, self.vertices])
        bases[0] += self.offsets
        return bases

    def positions(self, model: "MorphableModel", poses: Poses) -> Array:
        """`(n_poses, n, 3)` px: where the points are seen (x, y), and how far behind the origin they are."""
        return model.of_points(self).positions(poses)

    def project(self, model: "MorphableModel", poses: Poses) -> Array:
        """`(n_poses, n, 2)` px: where the points are seen."""
        return model.of_points(self).project(poses)


def _seen_at(places: Array, corners: Array) -> tuple[NDArray[np.int64], Array]:
    """The triangle of each place, and weights of its corners: front-most under it, or else the nearest.

    `places` `(n, 2)`; `corners` `(n_triangles, 3, 3)` as seen.
    """
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

"""Where the texels of an object's surface lie: a dense mesh of them, or small circular patches."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from .morphable_model import MorphableModel


@dataclass(frozen=True, eq=False)
class SurfaceTexels:
    """Texels in groups, each moving with the same three vertices (a triangle) or with one (a patch).

    Texel i of group (a, b, c) is seen at w_a x_a + w_b x_b + w_c x_c + offset.

    Parameters
    ----------
    groups
        `(n_groups, 3)` int32, vertex numbers; a patch names one vertex three times.
    first
        `(n_groups + 1,)` int32: texels `first[g]:first[g + 1]` belong to group g. Within a group any first
        part is spread evenly, so that coarse levels use a prefix.
    weights
        `(n_texels, 3)` float32, barycentric; (1, 0, 0) in a patch.
    offsets
        `(n_texels, 2)` float32 px in the picture; zero in a mesh.
    areas
        `(n_groups,)` float32 px squared that a texel of the group stands for; 0 in a mesh, where it is the
        triangle's projected area by the number of its texels.
    """

    groups: NDArray[np.int32]
    first: NDArray[np.int32]
    weights: NDArray[np.float32]
    offsets: NDArray[np.float32]
    areas: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def group_of_texel(self) -> NDArray[np.int64]:
        """`(n_texels,)`: number of the group that each texel belongs to."""
        return np.repeat(np.arange(len(self.groups)), np.diff(self.first))

    @classmethod
    def dense(cls, model: MorphableModel, n_texels: int) -> Self:
        """About `n_texels` texels over all triangles, in proportion to their area on the typical shape.

        Raises
        ------
        ValueError
            if the model has no triangles or `n_texels` is below 1.
        """
        if not len(model.triangles) or n_texels < 1:
            raise ValueError(
                f"dense texels: got {n_texels} on {len(model.triangles)} triangles, expected some of both"
            )
        corners = model.bases[0][model.triangles]
        area = 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        # of the fractional parts as many are rounded up as make the sum right, spread along the list
        ends = np.floor(np.cumsum(area) / area.sum() * n_texels + 0.5).astype(np.int64)
        first = np.concatenate([[0], ends])
        counts = np.diff(first)
        number = np.arange(first[-1]) - np.repeat(first[:-1], counts)
        weights = _spread_in_triangle(number)
        return cls(
            groups=model.triangles.astype(np.int32),
            first=first.astype(np.int32),
            weights=weights.astype(np.float32),
            offsets=np.zeros((len(weights), 2), np.float32),
            areas=np.zeros(len(model.triangles), np.float32),
        )

    @classmethod
    def patches(cls, model: MorphableModel, radius: float) -> Self:
        """Discs of `radius` px about every vertex, a texel a pixel (the paper's small circular patches).

        Raises
        ------
        ValueError
            if the radius is below 1 px.
        """
        if radius < 1:
            raise ValueError(f"radius: got {radius} px, expected 1 or more")
        reach = int(radius)
        grid = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
        disc = grid[(grid**2).sum(axis=1) <= radius**2]
        # in an order of which every prefix is spread over the disc
        disc = disc[np.argsort(np.modf(np.arange(len(disc)) * 0.6180339887)[0])]
        n = model.n_vertices
        return cls(
            groups=np.repeat(np.arange(n, dtype=np.int32)[:, None], 3, axis=1),
            first=(np.arange(n + 1) * len(disc)).astype(np.int32),
            weights=np.tile(np.array([[1, 0, 0]], np.float32), (n * len(disc), 1)),
            offsets=np.tile(disc, (n, 1)).astype(np.float32),
            areas=np.ones(n, np.float32),
        )


def _spread_in_triangle(number: NDArray[np.int64]) -> NDArray[np.float64]:
    """`(n, 3)` barycentric weights: the sequence R2 of Roberts, folded into the triangle; 0 is its centre."""
    first = np.modf(0.5 + number * 0.7548776662466927)[0]
    second = np.modf(0.5 + number * 0.5698402909980532)[0]
    over = first + second > 1
    a = np.where(over, 1 - first, first)
    b = np.where(over, 1 - second, second)
    weights = np.stack([a, b, 1 - a - b], axis=1)
    weights[number == 0] = 1 / 3
    return weights

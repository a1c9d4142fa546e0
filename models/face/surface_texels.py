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

    Texels lie in rows: row k holds the k-th texel of every group that has so many, in the order of groups, of
    which those with more texels come first. All texels of a row have the same weights and offset.

    Parameters
    ----------
    groups
        `(n_groups, 3)` int32, vertex numbers, of groups that have texels; a patch names one vertex three
        times.
    first
        `(n_rows + 1,)` int32: texels `first[k]:first[k + 1]` make row k, those of groups 0, 1, ... The first
        part of a group is spread evenly, so that coarse levels use a prefix of the rows and of each row.
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
    def row_of_texel(self) -> NDArray[np.int64]:
        """`(n_texels,)`: number of the row that each texel lies in, its place in its group."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    @property
    def group_of_texel(self) -> NDArray[np.int64]:
        """`(n_texels,)`: number of the group that each texel belongs to."""
        return np.arange(len(self)) - np.repeat(self.first[:-1], np.diff(self.first)).astype(np.int64)

    @property
    def counts(self) -> NDArray[np.int64]:
        """`(n_groups,)`: how many texels each group has, falling."""
        return np.bincount(self.group_of_texel, minlength=len(self.groups)).astype(np.int64)

    def used_on(self, level: int) -> NDArray[np.bool_]:
        """`(n_texels,)`: which are used on a level of the picture, a fourth of those of the level before."""
        most = -(-self.counts // 4**level)
        used: NDArray[np.bool_] = self.row_of_texel < most[self.group_of_texel]
        return used

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
        counts = np.diff(ends, prepend=0)
        order = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
        counts = counts[order]
        lengths = (counts > np.arange(counts[0])[:, None]).sum(axis=1)
        weights = np.repeat(_spread_in_triangle(np.arange(counts[0])), lengths, axis=0)
        return cls(
            groups=model.triangles[order].astype(np.int32),
            first=np.append(0, np.cumsum(lengths)).astype(np.int32),
            weights=weights.astype(np.float32),
            offsets=np.zeros((len(weights), 2), np.float32),
            areas=np.zeros(len(order), np.float32),
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
            first=(np.arange(len(disc) + 1) * n).astype(np.int32),
            weights=np.tile(np.array([[1, 0, 0]], np.float32), (n * len(disc), 1)),
            offsets=np.repeat(disc, n, axis=0).astype(np.float32),
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

"""Texels of an object's surface, their visibility, and the outline of the projected mesh."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..numerics.threads import over_bands
from . import kernels
from .morphable_model import MorphableModel

Array = NDArray[np.float64]
Map = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SurfaceTexels:
    """Texels in groups, each attached to three vertices (a triangle) or to one (a patch).

    Texel i of group (a, b, c) is seen at w_a x_a + w_b x_b + w_c x_c + offset.

    Texels lie in rows: row k holds the k-th texel of every group with more than k texels, in the order of
    groups, the largest first. All texels of a row have the same weights and offset.
    """

    # `(n_groups, 3)` int32, vertex numbers, of groups that have texels; a patch names one vertex three times
    groups: NDArray[np.int32]
    # `(n_rows + 1,)` int32: texels `first[k]:first[k + 1]` are row k, of groups 0, 1, ... Any first part of a
    # group is spread evenly, so that coarse levels use the first rows
    first: NDArray[np.int32]
    weights: NDArray[np.float32]  # `(n_texels, 3)` float32, barycentric; (1, 0, 0) in a patch
    offsets: NDArray[np.float32]  # `(n_texels, 2)` float32 px in the picture; zero in a mesh
    areas: NDArray[np.float32]  # `(n_groups,)` px squared of each texel; 0 in a mesh: from the triangle

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def group_of_texel(self) -> NDArray[np.int64]:
        """Group of each texel, `(n_texels,)`."""
        return np.arange(len(self)) - np.repeat(self.first[:-1], np.diff(self.first)).astype(np.int64)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of texels of each group, `(n_groups,)`, not increasing."""
        return np.bincount(self.group_of_texel, minlength=len(self.groups)).astype(np.int64)

    @classmethod
    def dense(cls, model: MorphableModel, n_texels: int) -> Self:
        """Return `n_texels` texels over all triangles, in proportion to their area on the typical shape.

        Raises `ValueError` if the model has no triangles or `n_texels` is below 1.
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
        """Return discs of `radius` px about every vertex, a texel a pixel (the paper's circular patches).

        Raises `ValueError` if the radius is below 1 px.
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
    """Return barycentric weights `(n, 3)`: Roberts' sequence R2 in the triangle, from its centre on."""
    first = np.modf(0.5 + number * 0.7548776662466927)[0]
    second = np.modf(0.5 + number * 0.5698402909980532)[0]
    over = first + second > 1
    a = np.where(over, 1 - first, first)
    b = np.where(over, 1 - second, second)
    weights = np.stack([a, b, 1 - a - b], axis=1)
    weights[number == 0] = 1 / 3
    return weights


FACING = 0.3  # least cosine between a triangle's normal and the direction to the viewer for texels in use
_CELLS = 128  # most cells of the z-buffer along the longer side of the object's box
_LEAST_CELL = 1.0  # px: least side of a cell
_TOLERANCE = 0.02  # least distance of an occluder in front of a point, as a share of the object's depth


def visible(
    positions: Array, triangles: NDArray[np.int64], texels: SurfaceTexels, facing: float = FACING
) -> NDArray[np.bool_]:
    """Return which texels of a triangle mesh are visible in each pose, `(n_poses, n_texels)`.

    A texel is visible if its triangle faces the viewer and no other part of the mesh is in front. The latter
    is looked up in a z-buffer of coarse cells (1 px, or 1/128 of the object's longer side if that is more):
    results are uncertain within a cell of an outline, and parts less than 2 % of the object's depth in front
    do not occlude. Triangles occlude from both sides.

    `positions` `(n_poses, n_vertices, 3)` px, z away from the viewer; `triangles` `(n_triangles, 3)`, in the
    order of `MorphableModel`; `texels`: in groups with vertices in the order of a triangle, or patches, which
    face everywhere and whose offsets do not count; `facing`: least cosine between the normal and the
    direction to the viewer.
    """
    seen = np.empty((len(positions), len(texels)), np.bool_)
    positions = np.ascontiguousarray(positions, np.float64)
    mesh = np.ascontiguousarray(triangles, np.uint32)
    groups, weights = texels.groups.astype(np.uint32), np.ascontiguousarray(texels.weights.T)

    def work(a: int, b: int) -> None:
        kernels.find_visible(
            positions[a:b], mesh, groups, texels.first, weights, float(facing), _CELLS, _LEAST_CELL,
            _TOLERANCE, seen[a:b],
        )  # fmt: skip

    over_bands(work, len(positions), worth=len(positions) > 4)
    return seen


SPACING = 3.0  # px between points of an outline
DEPTH = 1.5  # px outside of an edge of the outline that must not be covered
MOST_POINTS = 512  # points of one outline, at most


class Region(NamedTuple):
    """Rectangle of whole pixels, which may reach over the picture's edge."""

    # first row and column
    top: int
    left: int
    # px
    height: int
    width: int

    @classmethod
    def around(cls, positions: NDArray[np.floating], margin: float, size: tuple[int, int]) -> Self:
        """Return the part of a picture of `size` `(height, width)` within `margin` px of `positions`.

        At least one pixel, even if all positions are far from the picture.
        """
        flat = positions.reshape(-1, 2)
        limit = np.array(size[::-1])
        first = np.clip(np.floor(flat.min(axis=0) - margin), 0, limit - 1).astype(int)
        end = np.clip(np.ceil(flat.max(axis=0) + margin) + 1, first + 1, limit).astype(int)
        (left, top), (right, bottom) = first.tolist(), end.tolist()
        return cls(top, left, bottom - top, right - left)

    @property
    def window(self) -> tuple[slice, slice]:
        """Slices of rows and columns in the picture."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class MeshEdges(NamedTuple):
    """Edges of a triangle mesh."""

    triangles: NDArray[np.int64]  # `(n_triangles, 3)` int64
    ends: NDArray[np.int64]  # `(n_edges, 2)` int64, vertices
    # `(n_edges, 2)` int64: triangles at the edge, the second -1 at the border of the mesh
    sides: NDArray[np.int64]

    @classmethod
    def of(cls, triangles: NDArray[np.int64]) -> Self:
        """Return the edges of a mesh, each with its first two triangles."""
        each = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        ends, numbers = np.unique(each, axis=0, return_inverse=True)
        order = np.argsort(numbers.reshape(-1), kind="stable")
        first = np.searchsorted(numbers.reshape(-1)[order], np.arange(len(ends)))
        owners = order // 3
        alone = np.diff(first, append=len(order)) == 1
        second = np.where(alone, -1, owners[np.minimum(first + 1, len(order) - 1)])
        return cls(triangles, ends, np.stack([owners[first], second], axis=1))


@dataclass(frozen=True, eq=False)
class Outline:
    """Points on the outlines of a mesh in several poses, each on an edge."""

    vertices: NDArray[np.int64]  # `(n, n_points, 2)` int64: ends of the edge
    weights: Map  # `(n, n_points, 2)` float32: of the ends
    lengths: Map  # `(n, n_points)` float32 px: length of outline at the point, 0 after the last one
    normals: Map  # `(n, n_points, 2)` float32: outward, of unit length


def covered(
    positions: NDArray[np.floating], triangles: NDArray[np.int64], region: Region
) -> NDArray[np.uint8]:
    """Return the pixels of the region whose centres a mesh covers, `(n, height, width)`: 1 or 0.

    `positions` are `(n, n_vertices, 2)` px.
    """
    out = np.zeros((len(positions), region.height, region.width), np.uint8)
    kernels.cover(np.ascontiguousarray(positions, np.float32), triangles, region, out)
    return out


def outline(
    positions: NDArray[np.floating], edges: MeshEdges, inside: NDArray[np.uint8], region: Region
) -> Outline:
    """Return points about every 3 px (more on large objects) of the outline of a mesh.

    `positions` `(n, n_vertices, 2)` px; `edges`: of the mesh; `inside` `(n, height, width)` as `covered`
    gives them; `region`: of `inside`.
    """
    n = len(positions)
    # a large object's outline, longer than its box's perimeter by folds, has to fit in `MOST_POINTS`
    spacing = max(SPACING, 3 * (region.height + region.width) / MOST_POINTS)
    vertices = np.zeros((n, MOST_POINTS, 2), np.int64)
    weights = np.zeros((n, MOST_POINTS, 3), np.float32)
    normals = np.zeros((n, MOST_POINTS, 2), np.float32)
    count = np.zeros(n, np.int64)
    points = kernels.OutlinePoints(vertices, weights, normals, count)
    kernels.trace(
        np.ascontiguousarray(positions, np.float32),
        edges,
        inside,
        region,
        np.float32(spacing),
        np.float32(DEPTH),
        points,
    )
    most = int(count.max(initial=0))
    return Outline(vertices[:, :most], weights[:, :most, :2], weights[:, :most, 2], normals[:, :most])

"""Which points of a surface are seen, and the outline of a projected mesh against what is behind it."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import LANES
from ..numerics.threads import over_bands
from . import kernels as outline_kernels
from . import kernels as visibility_kernels
from .surface_texels import SurfaceTexels

Array = NDArray[np.float64]

FACING = 0.3
"""Least cosine between a triangle's normal and the direction to the viewer at which its texels are used."""

_CELLS = 128
"""Most cells of the z-buffer along the longer side of the object's box."""

_LEAST_CELL = 1.0
"""px, least side of a cell."""

_TOLERANCE = 0.02
"""Share of the object's depth by which what hides a point is nearer."""


def visible(
    positions: Array,
    triangles: NDArray[np.int64],
    texels: SurfaceTexels,
    facing: float = FACING,
) -> NDArray[np.bool_]:
    """Find the texels of a triangle mesh that are seen, in many poses at once.

    A texel is seen if its triangle faces the viewer and no other part of the mesh is in front. The latter is
    looked up in a z-buffer of coarse cells (1 px, or 1/128 of the object's longer side if that is more), so
    answers are unsure within a cell of an outline, and parts less than 2 % of the object's depth in front
    hide nothing. Triangles hide from both sides.

    Parameters
    ----------
    positions
        `(n_poses, n_vertices, 3)` px, z away from the viewer.
    triangles
        `(n_triangles, 3)`, in the order of `MorphableModel`.
    texels
        in groups of which the vertices are in the order of a triangle. Where they are none (a patch) texels
        have no facing and are only hidden by what is in front. Their offsets do not count.
    facing
        least cosine between the normal and the direction to the viewer.

    Returns
    -------
    NDArray[np.bool_]
        `(n_poses, n_texels)`.
    """
    seen = np.empty((len(positions), len(texels)), np.bool_)
    positions = np.ascontiguousarray(positions, np.float64)
    mesh = np.ascontiguousarray(triangles, np.uint32)
    groups, weights = texels.groups.astype(np.uint32), np.ascontiguousarray(texels.weights.T)

    def work(a: int, b: int) -> None:
        visibility_kernels.see(
            positions[a:b], mesh, groups, texels.first, weights, float(facing), _CELLS, _LEAST_CELL,
            _TOLERANCE, seen[a:b],
        )  # fmt: skip

    over_bands(work, len(positions), worth=len(positions) > 4)
    return seen


def front_triangles(
    vertices: Array, triangles: NDArray[np.int64], size: tuple[int, int]
) -> NDArray[np.int64]:
    """Which triangle of a mesh is seen at each pixel of a picture.

    Parameters
    ----------
    vertices
        `(n_vertices, 3)` px, z away from the viewer; triangles are seen from both sides.
    triangles
        `(n_triangles, 3)`.
    size
        `(width, height)` px of the picture.

    Returns
    -------
    NDArray[np.int64]
        `(height, width)`, -1 where there is none.
    """
    width, height = size
    corners = vertices + np.array([0.5, 0.5, 1 - vertices[:, 2].min()])
    buffer = np.empty((height, width + LANES), np.int64)
    planes = np.empty((len(triangles) + 1, 4), np.float32)
    mesh = np.ascontiguousarray(triangles, np.uint32)
    visibility_kernels.draw(corners, mesh, 1.0, width, planes, buffer)
    numbers: NDArray[np.int64] = (buffer[:, :width] & 0xFFFFFFFF) - 1
    return numbers


Map = NDArray[np.float32]

SPACING = 3.0
"""px between points of an outline."""

DEPTH = 1.5
"""px outside an edge at which nothing may be covered, for it to be on the outline."""

MOST_POINTS = 512
"""Points of one outline."""


class Box(NamedTuple):
    """A rectangle of whole pixels, which may reach over the picture's edge.

    Parameters
    ----------
    top, left
        first row and column.
    height, width
        px.
    """

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def around(cls, positions: NDArray[np.floating], margin: float, size: tuple[int, int]) -> Self:
        """The part of a picture of `size` `(height, width)` within `margin` px of `positions` `(..., 2)`.

        At least one pixel, even if nothing is near the picture.
        """
        flat = positions.reshape(-1, 2)
        limit = np.array(size[::-1])
        first = np.clip(np.floor(flat.min(axis=0) - margin), 0, limit - 1).astype(int)
        end = np.clip(np.ceil(flat.max(axis=0) + margin) + 1, first + 1, limit).astype(int)
        (left, top), (right, bottom) = first.tolist(), end.tolist()
        return cls(top, left, bottom - top, right - left)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns in the picture."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class MeshEdges(NamedTuple):
    """Edges of a triangle mesh.

    Parameters
    ----------
    triangles
        `(n_triangles, 3)` int64.
    ends
        `(n_edges, 2)` int64, vertices.
    sides
        `(n_edges, 2)` int64: triangles at the edge, the second -1 at the border of the mesh.
    """

    triangles: NDArray[np.int64]
    ends: NDArray[np.int64]
    sides: NDArray[np.int64]

    @classmethod
    def of(cls, triangles: NDArray[np.int64]) -> Self:
        """Edges of the mesh; of more than two triangles at an edge the first two count."""
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
    """Points on the outlines of a mesh in several poses, each on an edge; of pose n the first `count[n]`.

    Parameters
    ----------
    vertices
        `(n, n_points, 2)` int64: ends of the edge.
    weights
        `(n, n_points, 2)` float32: shares of the ends.
    lengths
        `(n, n_points)` float32 px of outline that the point stands for, 0 after the last one.
    normals
        `(n, n_points, 2)` float32, of unit length, away from the object.
    """

    vertices: NDArray[np.int64]
    weights: Map
    lengths: Map
    normals: Map


def covered(positions: NDArray[np.floating], triangles: NDArray[np.int64], box: Box) -> NDArray[np.uint8]:
    """Pixels of the box whose centres a mesh covers, `(n, height, width)`: 1 or 0.

    `positions` are `(n, n_vertices, 2)` px.
    """
    out = np.zeros((len(positions), box.height, box.width), np.uint8)
    outline_kernels.cover(np.ascontiguousarray(positions, np.float32), triangles, box, out)
    return out


def outline(
    positions: NDArray[np.floating], edges: MeshEdges, inside: NDArray[np.uint8], box: Box
) -> Outline:
    """Points about every 3 px (farther apart on large objects) where a mesh borders on what is behind it.

    Parameters
    ----------
    positions
        `(n, n_vertices, 2)` px.
    edges
        of the mesh.
    inside
        `(n, height, width)` as `covered` gives them.
    box
        of `inside`.
    """
    n = len(positions)
    # a large object's outline, which may be longer than its box's by folds, must not end halfway round
    spacing = max(SPACING, 3 * (box.height + box.width) / MOST_POINTS)
    vertices = np.zeros((n, MOST_POINTS, 2), np.int64)
    weights = np.zeros((n, MOST_POINTS, 3), np.float32)
    normals = np.zeros((n, MOST_POINTS, 2), np.float32)
    count = np.zeros(n, np.int64)
    points = outline_kernels.OutlinePoints(vertices, weights, normals, count)
    outline_kernels.trace(
        np.ascontiguousarray(positions, np.float32),
        edges,
        inside,
        box,
        np.float32(spacing),
        np.float32(DEPTH),
        points,
    )
    most = int(count.max(initial=0))
    return Outline(vertices[:, :most], weights[:, :most, :2], weights[:, :most, 2], normals[:, :most])

"""Which points of a surface are seen: they face the viewer and nothing of the same object is before them."""

import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import LANES
from ..numerics.threads import over_bands
from .kernels import visibility as visibility_kernels
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

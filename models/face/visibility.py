"""Which points of a surface are seen: they face the viewer and nothing of the same object is before them."""

import numpy as np
from numpy.typing import NDArray

from .kernels import visibility as visibility_kernels

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
    vertices: NDArray[np.int64],
    weights: Array,
    facing: float = FACING,
) -> NDArray[np.bool_]:
    """Find the points of a triangle mesh that are seen, in many poses at once.

    A point is seen if its triangle faces the viewer and no other part of the mesh is in front. The latter is
    looked up in a z-buffer of coarse cells (1 px, or 1/128 of the object's longer side if that is more), so
    answers are unsure within a cell of an outline, and parts less than 2 % of the object's depth in front
    hide nothing. Triangles hide from both sides.

    Parameters
    ----------
    positions
        `(n_poses, n_vertices, 3)` px, z away from the viewer.
    triangles
        `(n_triangles, 3)`, in the order of `MorphableModel`.
    vertices, weights
        `(n_points, 3)`: points as weighted means of three vertices, which are in the order of a triangle.
        Where they are none (three times one vertex, say) the point has no facing and is only hidden by
        what is in front.
    facing
        least cosine between the normal and the direction to the viewer.

    Returns
    -------
    NDArray[np.bool_]
        `(n_poses, n_points)`.
    """
    seen = np.empty((len(positions), len(vertices)), np.bool_)
    visibility_kernels.see(
        np.ascontiguousarray(positions, np.float64),
        np.ascontiguousarray(triangles, np.int64),
        np.ascontiguousarray(vertices, np.int64),
        np.ascontiguousarray(weights, np.float64),
        float(facing),
        _CELLS,
        _LEAST_CELL,
        _TOLERANCE,
        seen,
    )
    return seen

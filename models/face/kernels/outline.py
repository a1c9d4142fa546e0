"""Loops over triangles and edges of projected meshes: which pixels they cover, where the outline is."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled

_f4 = np.float32


class OutlinePoints(NamedTuple):
    """Room for points on outlines: `(n, room)` with two vertices, their shares and px of outline that the
    point stands for, and the unit normal outwards; `counts` `(n,)` says how many there are."""

    vertices: NDArray[np.int64]
    weights: NDArray[np.float32]
    normals: NDArray[np.float32]
    counts: NDArray[np.int64]


@compiled
def cover(positions, triangles, box, covered):
    """Mark the pixels whose centres lie in a triangle, pose by pose.

    `positions` `(n, n_vertices, 2)` float32 px, `covered` `(n, height, width)` uint8 of the `box`, zero
    before.
    """
    top, left, height, width = box
    for pose in range(len(positions)):
        places, out = positions[pose], covered[pose]
        for number in range(len(triangles)):
            a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
            ax, ay = places[a, 0] - left, places[a, 1] - top
            bx, by = places[b, 0] - left, places[b, 1] - top
            cx, cy = places[c, 0] - left, places[c, 1] - top
            first = max(np.int64(np.ceil(min(ay, by, cy))), 0)
            last = min(np.int64(np.floor(max(ay, by, cy))), height - 1)
            for row in range(first, last + 1):
                y = _f4(row)
                begin, end = _f4(1e9), _f4(-1e9)
                # where the row enters and leaves the triangle
                if (ay <= y) != (by <= y):
                    x = ax + (y - ay) * (bx - ax) / (by - ay)
                    begin, end = min(begin, x), max(end, x)
                if (by <= y) != (cy <= y):
                    x = bx + (y - by) * (cx - bx) / (cy - by)
                    begin, end = min(begin, x), max(end, x)
                if (cy <= y) != (ay <= y):
                    x = cx + (y - cy) * (ax - cx) / (ay - cy)
                    begin, end = min(begin, x), max(end, x)
                if begin > end:
                    continue
                start = max(np.int64(np.ceil(max(begin, _f4(0)))), 0)
                stop = np.int64(np.floor(min(end, _f4(width - 1))))
                for column in range(start, stop + 1):
                    out[row, column] = 1


@compiled
def _inside(covered, x, y):
    column, row = np.int64(np.floor(x + _f4(0.5))), np.int64(np.floor(y + _f4(0.5)))
    if row < 0 or column < 0 or row >= covered.shape[0] or column >= covered.shape[1]:
        return False
    return covered[row, column] != 0


@compiled
def trace(positions, edges, covered, box, spacing, depth, points):
    """Points along the outline about every `spacing` px, at most as many as there is room for.

    An edge is on the outline where only one of its triangles faces the viewer, or where it has but one, and
    what is `depth` px outside it is not covered but what is inside is. Writes `points`.
    """
    triangles, ends, sides = edges
    vertices, weights, normals, count = points
    top, left = box.top, box.left
    room = vertices.shape[1]
    turned = np.empty(len(triangles), np.bool_)
    for pose in range(len(positions)):
        places = positions[pose]
        for number in range(len(triangles)):
            a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
            area = (places[b, 0] - places[a, 0]) * (places[c, 1] - places[a, 1])
            area -= (places[b, 1] - places[a, 1]) * (places[c, 0] - places[a, 0])
            turned[number] = area > _f4(0)
        found = 0
        for edge in range(len(ends)):
            one, other = sides[edge, 0], sides[edge, 1]
            if other >= 0 and turned[one] == turned[other]:
                continue
            a, b = ends[edge, 0], ends[edge, 1]
            ax, ay = places[a, 0] - left, places[a, 1] - top
            along, down = places[b, 0] - places[a, 0], places[b, 1] - places[a, 1]
            length = np.sqrt(along * along + down * down)
            if length < _f4(1e-3):
                continue
            nx, ny = down / length, -along / length
            parts = max(np.int64(np.floor(length / spacing + _f4(0.5))), 1)
            for k in range(parts):
                share = _f4(k + 0.5) / _f4(parts)
                x, y = ax + share * along, ay + share * down
                before = _inside(covered[pose], x + depth * nx, y + depth * ny)
                behind = _inside(covered[pose], x - depth * nx, y - depth * ny)
                if before == behind or found == room:
                    continue
                sign = _f4(-1) if before else _f4(1)
                vertices[pose, found, 0], vertices[pose, found, 1] = a, b
                weights[pose, found, 0], weights[pose, found, 1] = _f4(1) - share, share
                normals[pose, found, 0], normals[pose, found, 1] = sign * nx, sign * ny
                weights[pose, found, 2] = length / _f4(parts)
                found += 1
        count[pose] = found

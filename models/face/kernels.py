"""Compiled loops over projected meshes: coarse z-buffer of triangles with queries, coverage, outlines."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import LANES, MOST, compiled, float_as_bits, own_array

_f4 = np.float32
_FAR = _f4(1e30)
_EMPTY = np.int64(0x7F800000) << np.int64(32)


@compiled
def fill_z_buffer(corners, triangles, per_px, columns, planes, buffer):
    """Fill the z-buffer with the front-most triangle at the middle of each cell, and its depth.

    `corners` `(n_vertices, 3)` are px from the upper left of the buffer, at depths above 0. A cell has the
    bits of the depth, which rise with it, before the triangle's number, from 1; 0 is none. The buffer has
    `LANES` more columns than are used. The `planes` of triangles are z at that corner, its slopes along x and
    y per px, and its least value.
    """
    rows = len(buffer)
    buffer[:] = _EMPTY
    planes[0, 0], planes[0, 1], planes[0, 2], planes[0, 3] = _FAR, _f4(0), _f4(0), _FAR
    for number in range(len(triangles)):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        ax, ay, az = corners[a, 0] * per_px, corners[a, 1] * per_px, corners[a, 2]
        bx, by, bz = corners[b, 0] * per_px, corners[b, 1] * per_px, corners[b, 2]
        cx, cy, cz = corners[c, 0] * per_px, corners[c, 1] * per_px, corners[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:  # seen from its edge: it hides nothing
            continue
        # weights of b and c, linear in the place
        b_x, b_y = (cy - ay) / area, (ax - cx) / area
        c_x, c_y = (ay - by) / area, (bx - ax) / area
        slope_x, slope_y = b_x * (bz - az) + c_x * (cz - az), b_y * (bz - az) + c_y * (cz - az)
        base = az - slope_x * ax - slope_y * ay
        planes[number + 1, 0], planes[number + 1, 3] = base, min(az, bz, cz)
        planes[number + 1, 1], planes[number + 1, 2] = slope_x * per_px, slope_y * per_px
        first_x = min(max(int(np.ceil(min(ax, bx, cx) - 0.5)), 0), columns)
        last_x = min(max(int(np.floor(max(ax, bx, cx) - 0.5)), -1), columns - 1)
        first_y = min(max(int(np.ceil(min(ay, by, cy) - 0.5)), 0), rows)
        last_y = min(max(int(np.floor(max(ay, by, cy) - 0.5)), -1), rows - 1)
        # whole vectors; what is past the triangle's box fails the test of being in it
        n = (last_x - first_x + LANES) // LANES * LANES
        own = np.int64(number + 1)
        for row in range(first_y, last_y + 1):
            x, y = first_x + 0.5, row + 0.5
            b_row, c_row = b_y * (y - ay) + b_x * (x - ax), c_y * (y - ay) + c_x * (x - ax)
            z_row = base + slope_y * y + slope_x * x
            cells = buffer[row, first_x:]
            for k in range(n):
                of_b, of_c = b_row + b_x * k, c_row + c_x * k
                key = (np.int64(float_as_bits(_f4(z_row + slope_x * k))) << np.int64(32)) | own
                # a little over the edges, so that no cell between two triangles stays open
                inside = min(of_b, of_c, 1 - of_b - of_c) >= -1e-6
                cells[k] = min(cells[k], key if inside else _EMPTY)


@compiled
def find_visible(positions, triangles, groups, first, weights, facing, cells, least_cell, tolerance, seen):
    """Write whether points are visible in each pose, `seen` `(n_poses, n_points)`; see `surface.visible`.

    The box of an object is cut into at most `cells` x `cells` of at least `least_cell` px.
    """
    n_vertices = positions.shape[1]
    corners = np.empty((n_vertices, 3))
    planes = np.empty((len(triangles) + 1, 4), _f4)
    whole = np.empty((cells, cells + LANES), np.int64)
    for pose in range(len(positions)):
        places = positions[pose]
        left = right = places[0, 0]
        top = bottom = places[0, 1]
        nearest = farthest = places[0, 2]
        for i in range(1, n_vertices):
            left, right = min(left, places[i, 0]), max(right, places[i, 0])
            top, bottom = min(top, places[i, 1]), max(bottom, places[i, 1])
            nearest, farthest = min(nearest, places[i, 2]), max(farthest, places[i, 2])
        for i in range(n_vertices):
            corners[i, 0], corners[i, 1] = places[i, 0] - left, places[i, 1] - top
            corners[i, 2] = places[i, 2] - nearest + 1
        cell = max(max(right - left, bottom - top) / cells, least_cell)
        columns = min(max(int(np.ceil((right - left) / cell)), 1), cells)
        rows = min(max(int(np.ceil((bottom - top) / cell)), 1), cells)
        buffer = whole[:rows]
        fill_z_buffer(corners, triangles, 1 / cell, columns, planes, buffer)
        slack = tolerance * (farthest - nearest)
        _query_z_buffer(
            corners, groups, first, weights, (facing, slack, cell), planes, buffer, columns, seen[pose]
        )


@compiled
def _query_z_buffer(corners, groups, first, weights, limits, planes, buffer, columns, seen):
    """Query visibility in a filled z-buffer; `limits`: facing, slack px, side of a cell px."""
    facing, slack, cell = limits
    keys, plane = buffer.reshape(-1), np.empty((MOST, 4), _f4)
    last_column, last_row = np.int32(columns - 1), np.int32(len(buffer) - 1)
    per_px, width = _f4(1 / cell), np.int32(buffer.shape[1])
    places, spare = np.empty((9, MOST), _f4), np.empty(MOST, _f4)
    xs, ys, zs, at = own_array(_f4), own_array(_f4), own_array(_f4), own_array(np.uint32)
    for block in range(0, len(groups), MOST):
        for g in range(min(len(groups) - block, MOST)):
            for corner in range(3):
                vertex = groups[block + g, corner]
                for axis in range(3):
                    places[3 * axis + corner, g] = corners[vertex, axis]
            spare[g] = _depth_tolerance(corners, groups[block + g], facing, slack, cell)
        ax, bx, cx, ay, by, cy, az, bz, cz = places
        for row in range(len(first) - 1):
            n = min(first[row + 1] - first[row] - block, MOST)
            if n <= 0:
                break
            start = first[row] + block
            wa, wb, wc, its_seen = weights[0, start:], weights[1, start:], weights[2, start:], seen[start:]
            for g in range(n):
                x = wa[g] * ax[g] + wb[g] * bx[g] + wc[g] * cx[g]
                y = wa[g] * ay[g] + wb[g] * by[g] + wc[g] * cy[g]
                xs[g], ys[g], zs[g] = x, y, wa[g] * az[g] + wb[g] * bz[g] + wc[g] * cz[g]
                column = min(max(np.int32(x * per_px), np.int32(0)), last_column)
                line = min(max(np.int32(y * per_px), np.int32(0)), last_row)
                at[g] = np.uint32(line * width + column)
            for g in range(n):
                other = np.uint32(keys[at[g]])
                for part in range(4):
                    plane[g, part] = planes[other, part]
            for g in range(n):
                # The plane of the triangle in front, followed to this very place: on one's own triangle that
                # is the point itself. Past its edge a steep plane would stand before everything beside it, so
                # it is followed no nearer than the triangle reaches.
                before = max(plane[g, 0] + plane[g, 1] * xs[g] + plane[g, 2] * ys[g], plane[g, 3])
                its_seen[g] = zs[g] <= before + spare[g]


@compiled
def _depth_tolerance(corners, group, facing, slack, cell):
    """Return the depth behind the z-buffer at which points of a group are still visible."""
    a, b, c = group[0], group[1], group[2]
    ux, uy, uz = corners[b, 0] - corners[a, 0], corners[b, 1] - corners[a, 1], corners[b, 2] - corners[a, 2]
    vx, vy, vz = corners[c, 0] - corners[a, 0], corners[c, 1] - corners[a, 1], corners[c, 2] - corners[a, 2]
    normal_x, normal_y, normal_z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    across = normal_x * normal_x + normal_y * normal_y
    length = np.sqrt(across + normal_z * normal_z)
    if normal_z > -facing * length:
        return -4 * _FAR
    rise = np.sqrt(across) / max(-normal_z, 0.1 * length) if length > 0 else 0.0
    return _f4(slack + rise * cell)


class OutlinePoints(NamedTuple):
    """Points on outlines `(n, room)`: two vertices, their weights and the length of outline in px, the
    outward unit normal; `counts` `(n,)` of them are used."""

    vertices: NDArray[np.int64]
    weights: NDArray[np.float32]
    normals: NDArray[np.float32]
    counts: NDArray[np.int64]


@compiled
def cover(positions, triangles, region, covered):
    """Mark the pixels whose centres lie in a triangle, pose by pose.

    `positions` `(n, n_vertices, 2)` float32 px, `covered` `(n, height, width)` uint8 of the `region`, zero
    before.
    """
    top, left, height, width = region
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
def trace(positions, edges, covered, region, spacing, depth, points):
    """Write points along the outline about every `spacing` px, at most as many as `points` has room for.

    An edge is on the outline if only one of its triangles faces the viewer, or if it has only one, and if
    the mesh covers `depth` px on its inner side but not on its outer side.
    """
    triangles, ends, sides = edges
    vertices, weights, normals, count = points
    top, left = region.top, region.left
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

"""Loops that find which points of a mesh are seen: a coarse z-buffer of triangles, then a query a point."""

import numpy as np

from ...numerics.compiled import compiled
from ...numerics.vectors import MOST, own_array

_f4 = np.float32
_FAR = _f4(1e30)


@compiled
def _draw(corners, triangles, per_px, planes, depth, front):
    """Fill the z-buffer: how deep the front-most triangle is at the middle of each cell, and its number.

    `corners` `(n_vertices, 3)` are px from the upper left of the buffer. Numbers begin with 1; 0 is nobody.
    The `planes` of triangles say where z is: at that corner, per px along x, per px along y, and its least.
    """
    rows, columns = depth.shape
    depth[:] = _FAR
    front[:] = 0
    planes[0, 0], planes[0, 1], planes[0, 2], planes[0, 3] = _FAR, _f4(0), _f4(0), _FAR
    middle, slope, back = np.empty(3), np.empty(3), np.empty(3)
    for number in range(len(triangles)):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        ax, ay, az = corners[a, 0] * per_px, corners[a, 1] * per_px, corners[a, 2]
        bx, by, bz = corners[b, 0] * per_px, corners[b, 1] * per_px, corners[b, 2]
        cx, cy, cz = corners[c, 0] * per_px, corners[c, 1] * per_px, corners[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:  # seen from its edge: it hides nothing
            continue
        # weights of b and c, linear in the place; that of a makes the sum 1
        b_x, b_y = (cy - ay) / area, (ax - cx) / area
        c_x, c_y = (ay - by) / area, (bx - ax) / area
        slope_x, slope_y = b_x * (bz - az) + c_x * (cz - az), b_y * (bz - az) + c_y * (cz - az)
        base = az - slope_x * ax - slope_y * ay
        planes[number + 1, 0], planes[number + 1, 3] = base, min(az, bz, cz)
        planes[number + 1, 1], planes[number + 1, 2] = slope_x * per_px, slope_y * per_px
        slope[0], slope[1], slope[2] = b_x, c_x, -b_x - c_x
        for corner in range(3):
            back[corner] = 1 / slope[corner] if abs(slope[corner]) > 1e-12 else 0.0
        first_x = min(max(int(np.ceil(min(ax, bx, cx) - 0.5)), 0), columns)
        last_x = min(max(int(np.floor(max(ax, bx, cx) - 0.5)), -1), columns - 1)
        first_y = min(max(int(np.ceil(min(ay, by, cy) - 0.5)), 0), rows)
        last_y = min(max(int(np.floor(max(ay, by, cy) - 0.5)), -1), rows - 1)
        for row in range(first_y, last_y + 1):
            y = row + 0.5
            middle[0] = b_y * (y - ay) - b_x * (ax - 0.5)
            middle[1] = c_y * (y - ay) - c_x * (ax - 0.5)
            middle[2] = 1 - middle[0] - middle[1]
            begin, end = first_x, last_x
            for corner in range(3):
                # a little over the edges, so that no cell between two triangles stays open
                least = -1e-6 - middle[corner]
                if slope[corner] > 1e-12:
                    begin = max(begin, int(np.ceil(max(least * back[corner], -1.0))))
                elif slope[corner] < -1e-12:
                    end = min(end, int(np.floor(min(least * back[corner], columns))))
                elif least > 0:
                    end = -1
            z_row, z_step = base + slope_y * y + 0.5 * slope_x, slope_x
            its_depth, its_front = depth[row], front[row]
            for column in range(begin, end + 1):
                z = _f4(z_row + z_step * column)
                if z < its_depth[column]:
                    its_depth[column] = z
                    its_front[column] = number + 1


@compiled
def see(positions, triangles, groups, first, weights, facing, cells, least_cell, tolerance, seen):
    """Whether points are seen, pose by pose, into `seen` `(n_poses, n_points)`; others as of `visible`.

    The box of an object is cut into at most `cells` x `cells` of at least `least_cell` px.
    """
    n_vertices = positions.shape[1]
    corners = np.empty((n_vertices, 3))
    planes = np.empty((len(triangles) + 1, 4), _f4)
    whole_depth = np.empty(cells * cells, _f4)
    whole_front = np.empty(cells * cells, np.uint32)
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
            corners[i, 2] = places[i, 2]
        cell = max(max(right - left, bottom - top) / cells, least_cell)
        columns = min(max(int(np.ceil((right - left) / cell)), 1), cells)
        rows = min(max(int(np.ceil((bottom - top) / cell)), 1), cells)
        depth = whole_depth[: rows * columns].reshape(rows, columns)
        front = whole_front[: rows * columns].reshape(rows, columns)
        _draw(corners, triangles, 1 / cell, planes, depth, front)
        slack = tolerance * (farthest - nearest)
        _query(corners, groups, first, weights, facing, slack, cell, planes, front, seen[pose])


@compiled
def _query(corners, groups, first, weights, facing, slack, cell, planes, front, seen):
    """Whether points are seen, once the z-buffer is filled."""
    rows, columns = front.shape
    numbers, plane = front.reshape(-1), np.empty((MOST, 4), _f4)
    last_column, last_row = np.int32(columns - 1), np.int32(rows - 1)
    per_px, width = _f4(1 / cell), np.int32(columns)
    places, spare = np.empty((9, MOST), _f4), np.empty(MOST, _f4)
    xs, ys, zs, at = own_array(_f4), own_array(_f4), own_array(_f4), own_array(np.uint32)
    for block in range(0, len(groups), MOST):
        for g in range(min(len(groups) - block, MOST)):
            for corner in range(3):
                vertex = groups[block + g, corner]
                for axis in range(3):
                    places[3 * axis + corner, g] = corners[vertex, axis]
            spare[g] = _spare(corners, groups[block + g], facing, slack, cell)
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
                other = numbers[at[g]]
                for part in range(4):
                    plane[g, part] = planes[other, part]
            for g in range(n):
                # The plane of the triangle in front, followed to this very place: on one's own triangle that
                # is the point itself. Past its edge a steep plane would stand before everything beside it, so
                # it is followed no nearer than the triangle reaches.
                before = max(plane[g, 0] + plane[g, 1] * xs[g] + plane[g, 2] * ys[g], plane[g, 3])
                its_seen[g] = zs[g] <= before + spare[g]


@compiled
def _spare(corners, group, facing, slack, cell):
    """How far behind what is in front points of a group are still seen; nowhere if it looks away."""
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

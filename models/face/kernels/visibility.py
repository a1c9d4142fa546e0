"""Loops that find which points of a mesh are seen: a coarse z-buffer of triangles, then a query a point."""

import numpy as np

from ...numerics.compiled import compiled

_NOBODY = np.int32(-1)


@compiled
def _draw(corners, triangles, left, top, per_px, planes, depth, front):
    """Fill the z-buffer: how deep the front-most triangle is at the middle of each cell, and which one it is.

    The `planes` of triangles say where z is: at the origin, per px along x, per px along y, and its least.
    """
    rows, columns = depth.shape
    depth[:] = np.float32(1e30)
    front[:] = _NOBODY
    for number in range(len(triangles)):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        ax, ay, az = (corners[a, 0] - left) * per_px, (corners[a, 1] - top) * per_px, corners[a, 2]
        bx, by, bz = (corners[b, 0] - left) * per_px, (corners[b, 1] - top) * per_px, corners[b, 2]
        cx, cy, cz = (corners[c, 0] - left) * per_px, (corners[c, 1] - top) * per_px, corners[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:  # seen from its edge: it hides nothing
            continue
        # weights of b and c, linear in the place
        b_x, b_y = (cy - ay) / area, (ax - cx) / area
        c_x, c_y = (ay - by) / area, (bx - ax) / area
        slope_x, slope_y = b_x * (bz - az) + c_x * (cz - az), b_y * (bz - az) + c_y * (cz - az)
        base = az - slope_x * ax - slope_y * ay
        planes[number, 0] = base - per_px * (slope_x * left + slope_y * top)
        planes[number, 1], planes[number, 2] = slope_x * per_px, slope_y * per_px
        planes[number, 3] = min(az, bz, cz)
        first_x = min(max(int(np.ceil(min(ax, bx, cx) - 0.5)), 0), columns)
        last_x = min(max(int(np.floor(max(ax, bx, cx) - 0.5)), -1), columns - 1)
        first_y = min(max(int(np.ceil(min(ay, by, cy) - 0.5)), 0), rows)
        last_y = min(max(int(np.floor(max(ay, by, cy) - 0.5)), -1), rows - 1)
        for row in range(first_y, last_y + 1):
            y = row + 0.5
            b_row = b_y * (y - ay) - b_x * ax
            c_row = c_y * (y - ay) - c_x * ax
            z_row = base + slope_y * y
            for column in range(first_x, last_x + 1):
                x = column + 0.5
                of_b, of_c = b_row + b_x * x, c_row + c_x * x
                # a little over the edges, so that no cell between two triangles stays open
                if min(of_b, of_c, 1 - of_b - of_c) >= -1e-6:
                    z = np.float32(z_row + slope_x * x)
                    if z < depth[row, column]:
                        depth[row, column] = z
                        front[row, column] = number


@compiled
def see(positions, triangles, vertices, weights, facing, cells, least_cell, tolerance, seen):
    """Whether points are seen, pose by pose, into `seen` `(n_poses, n_points)`; others as of `visible`.

    The box of an object is cut into at most `cells` x `cells` of at least `least_cell` px.
    """
    n_vertices = positions.shape[1]
    planes = np.zeros((len(triangles), 4))
    whole_depth = np.empty(cells * cells, np.float32)
    whole_front = np.empty(cells * cells, np.int32)
    for pose in range(len(positions)):
        corners = positions[pose]
        left = right = corners[0, 0]
        top = bottom = corners[0, 1]
        nearest = farthest = corners[0, 2]
        for i in range(1, n_vertices):
            left, right = min(left, corners[i, 0]), max(right, corners[i, 0])
            top, bottom = min(top, corners[i, 1]), max(bottom, corners[i, 1])
            nearest, farthest = min(nearest, corners[i, 2]), max(farthest, corners[i, 2])
        cell = max(max(right - left, bottom - top) / cells, least_cell)
        per_px = 1 / cell
        columns = min(max(int(np.ceil((right - left) * per_px)), 1), cells)
        rows = min(max(int(np.ceil((bottom - top) * per_px)), 1), cells)
        depth = whole_depth[: rows * columns].reshape(rows, columns)
        front = whole_front[: rows * columns].reshape(rows, columns)
        _draw(corners, triangles, left, top, per_px, planes, depth, front)
        slack = tolerance * (farthest - nearest)
        for point in range(len(vertices)):
            a, b, c = vertices[point, 0], vertices[point, 1], vertices[point, 2]
            ux, uy, uz = (
                corners[b, 0] - corners[a, 0],
                corners[b, 1] - corners[a, 1],
                corners[b, 2] - corners[a, 2],
            )
            vx, vy, vz = (
                corners[c, 0] - corners[a, 0],
                corners[c, 1] - corners[a, 1],
                corners[c, 2] - corners[a, 2],
            )
            normal_x, normal_y, normal_z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            across = normal_x * normal_x + normal_y * normal_y
            length = np.sqrt(across + normal_z * normal_z)
            if normal_z > -facing * length:
                seen[pose, point] = False
                continue
            wa, wb, wc = weights[point, 0], weights[point, 1], weights[point, 2]
            x = wa * corners[a, 0] + wb * corners[b, 0] + wc * corners[c, 0]
            y = wa * corners[a, 1] + wb * corners[b, 1] + wc * corners[c, 1]
            z = wa * corners[a, 2] + wb * corners[b, 2] + wc * corners[c, 2]
            column = min(max(int((x - left) * per_px), 0), columns - 1)
            row = min(max(int((y - top) * per_px), 0), rows - 1)
            other = front[row, column]
            hidden = False
            if other >= 0:
                # The plane of the triangle in front, followed to this very place: on one's own triangle that
                # is the point itself. Past its edge a steep plane would stand before everything beside it, so
                # it is followed no nearer than the triangle reaches.
                plane = planes[other, 0] + planes[other, 1] * x + planes[other, 2] * y
                before = max(plane, planes[other, 3])
                rise = np.sqrt(across) / max(-normal_z, 0.1 * length) if length > 0 else 0.0
                hidden = z > before + slack + rise * cell
            seen[pose, point] = not hidden

"""Loops of bundle adjustment: normal equations, and points eliminated from those of cameras and focal."""

import numpy as np

from ....models.numerics.compiled import compiled

CAMERA = 6

_at = np.uint64  # a number that is no index from the end, which loops would have to ask of each


@compiled
def sum_products(
    by_point, weights, by_camera, by_place, by_focal, errors,
    blocks, vectors, points, point_vector, mixed, mixed_border,
):  # fmt: skip
    """Add w J^T J and w J^T r of all observations to their blocks; q comes after the numbers of a camera."""
    edges, _, other, _, _, _ = by_point
    row = np.empty(CAMERA + 1)
    for i in range(edges.size - 1):
        for k in range(edges[i], edges[i + 1]):
            block, vector = blocks[other[k]], vectors[other[k]]
            for c in range(2):
                for m in range(CAMERA):
                    row[m] = by_camera[k, c, m]
                row[CAMERA] = by_focal[k, c]
                for m in range(CAMERA + 1):
                    weighted = weights[k] * row[m]
                    vector[m] += weighted * errors[k, c]
                    for n in range(CAMERA + 1):
                        block[m, n] += weighted * row[n]
                for m in range(3):
                    weighted = weights[k] * by_place[k, c, m]
                    point_vector[i, m] += weighted * errors[k, c]
                    mixed_border[i, m] += weighted * row[CAMERA]
                    for n in range(3):
                        points[i, m, n] += weighted * by_place[k, c, n]
                    for n in range(CAMERA):
                        mixed[k, m, n] += weighted * row[n]


@compiled
def eliminate_points(by_point, inverses, mixed, mixed_border, point_vector, matrix, vector):
    """Take the points out of the normal equations of cameras and q, in place; the lower half is right."""
    edges, _, other, _, _, _ = by_point
    last = vector.size - 1
    lifted, lines = np.empty((CAMERA, 3)), np.empty((3, last))
    until = np.empty(last // CAMERA, np.int64)
    for i in range(edges.size - 1):
        inverse = inverses[i]
        q0, q1, q2 = mixed_border[i, 0], mixed_border[i, 1], mixed_border[i, 2]
        e0 = inverse[0, 0] * q0 + inverse[0, 1] * q1 + inverse[0, 2] * q2
        e1 = inverse[1, 0] * q0 + inverse[1, 1] * q1 + inverse[1, 2] * q2
        e2 = inverse[2, 0] * q0 + inverse[2, 1] * q1 + inverse[2, 2] * q2
        g0, g1, g2 = point_vector[i, 0], point_vector[i, 1], point_vector[i, 2]
        matrix[last, last] -= e0 * q0 + e1 * q1 + e2 * q2
        vector[last] -= e0 * g0 + e1 * g1 + e2 * g2
        first, n_seen = edges[i], edges[i + 1] - edges[i]
        for k in range(n_seen - 1, -1, -1):
            # frames one after the other have their columns side by side, too
            joined = k + 1 < n_seen and other[first + k + 1] == other[first + k] + 1
            until[k] = until[k + 1] if joined else k + 1
            for m in range(CAMERA):
                for n in range(3):
                    lines[n, CAMERA * k + m] = mixed[first + k, n, m]
        for k in range(n_seen):
            row = CAMERA * other[first + k]
            for m in range(CAMERA):
                a0, a1, a2 = lines[0, CAMERA * k + m], lines[1, CAMERA * k + m], lines[2, CAMERA * k + m]
                for n in range(3):
                    lifted[m, n] = a0 * inverse[0, n] + a1 * inverse[1, n] + a2 * inverse[2, n]
                vector[row + m] -= lifted[m, 0] * g0 + lifted[m, 1] * g1 + lifted[m, 2] * g2
                matrix[last, row + m] -= lifted[m, 0] * q0 + lifted[m, 1] * q1 + lifted[m, 2] * q2
            run = 0
            while run <= k:  # frames of a point are in order
                end = min(until[run], k + 1)
                columns = CAMERA * run, CAMERA * (end - run)
                _take_out(lifted, lines, *columns, matrix, row, CAMERA * other[first + run])
                run = end


@compiled
def _take_out(lifted, lines, start, count, matrix, row, column):
    """A point's part in the rows of a camera, in as many columns as are side by side."""
    for m in range(0, CAMERA, 2):
        a0, a1, a2 = lifted[m, 0], lifted[m, 1], lifted[m, 2]
        b0, b1, b2 = lifted[m + 1, 0], lifted[m + 1, 1], lifted[m + 1, 2]
        for c in range(count):
            x, y, z = lines[0, _at(start + c)], lines[1, _at(start + c)], lines[2, _at(start + c)]
            matrix[row + m, _at(column + c)] -= a0 * x + a1 * y + a2 * z
            matrix[row + m + 1, _at(column + c)] -= b0 * x + b1 * y + b2 * z

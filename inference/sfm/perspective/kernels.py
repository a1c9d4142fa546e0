"""Loops of bundle adjustment: normal equations of cameras and points, points eliminated, put in again.

Observations come by point, as in `SparseObservations` of `factor_analysis`. The unknowns of a camera
are a turn w (R <- exp([w]x) R), log a, and u of `PerspectiveCameras`; of all frames q = 1 / f; of a point X.
"""

import numpy as np

from ....models.numerics.compiled import compiled, inlined

CAMERA = 6

_at = np.uint64  # a number that is no index from the end, which loops would have to ask of each


@compiled
def squared_distances(by_point, rotations, scales, shifts, curvature, shape, nearest, behind):
    """Return squared residuals `(n,)`; `behind` where depth < `nearest`."""
    edges, _, other, x, y, _ = by_point
    out = np.empty(x.size)
    for i in range(edges.size - 1):
        for k in range(edges[i], edges[i + 1]):
            t = other[k]
            px, py, pz = _turned(rotations[t], shape[i])
            d = 1.0 + curvature * scales[t] * pz
            if d < nearest:
                out[k] = behind
            else:
                dx = x[k] - (scales[t] * px + shifts[t, 0]) / d
                dy = y[k] - (scales[t] * py + shifts[t, 1]) / d
                out[k] = min(dx * dx + dy * dy, behind)
    return out


@compiled
def normal_equations(by_point, weight, rotations, scales, shifts, curvature, shape, nearest):
    """Return normal equations at weights `(n,)`: sums of w J^T J and of w J^T r, by blocks.

    Of cameras `(n_frames, 6, 6)` and `(n_frames, 6)`; of q with them `(n_frames, 6)`, with itself, and its
    sum; of points `(n_points, 3, 3)` and `(n_points, 3)`; of the point and the camera of each observation
    `(n, 3, 6)`; of q and a point `(n_points, 3)`.
    """
    edges, _, other, x, y, _ = by_point
    n_frames, n_points = scales.size, edges.size - 1
    cameras, camera_vector = np.zeros((n_frames, CAMERA, CAMERA)), np.zeros((n_frames, CAMERA))
    border, corner, corner_vector = np.zeros((n_frames, CAMERA)), 0.0, 0.0
    points, point_vector = np.zeros((n_points, 3, 3)), np.zeros((n_points, 3))
    mixed, mixed_border = np.zeros((x.size, 3, CAMERA)), np.zeros((n_points, 3))
    by_camera, by_place, by_focal = np.zeros((2, CAMERA)), np.zeros((2, 3)), np.zeros(2)
    residual = np.zeros(2)
    for i in range(n_points):
        for k in range(edges[i], edges[i + 1]):
            t = other[k]
            d = _jacobian(
                rotations[t],
                scales[t],
                shifts[t],
                curvature,
                shape[i],
                by_camera,
                by_place,
                by_focal,
                residual,
            )
            if d < nearest:
                continue
            residual[0] = x[k] - residual[0]
            residual[1] = y[k] - residual[1]
            w = weight[k]
            for c in range(2):
                r = w * residual[c]
                e = w * by_focal[c]
                corner += e * by_focal[c]
                corner_vector += r * by_focal[c]
                for m in range(CAMERA):
                    j = w * by_camera[c, m]
                    camera_vector[t, m] += r * by_camera[c, m]
                    border[t, m] += e * by_camera[c, m]
                    for n in range(CAMERA):
                        cameras[t, m, n] += j * by_camera[c, n]
                for m in range(3):
                    j = w * by_place[c, m]
                    for n in range(CAMERA):
                        mixed[k, m, n] += j * by_camera[c, n]
                    point_vector[i, m] += r * by_place[c, m]
                    mixed_border[i, m] += e * by_place[c, m]
                    for n in range(3):
                        points[i, m, n] += j * by_place[c, n]
    return cameras, camera_vector, border, corner, corner_vector, points, point_vector, mixed, mixed_border


@compiled
def eliminated(by_point, inverses, mixed, mixed_border, point_vector, matrix, vector):
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


@compiled
def put_in(by_point, inverses, mixed, mixed_border, point_vector, step):
    """Return steps `(n_points, 3)` of the points for a step `(6 n_frames + 1,)` of cameras and q."""
    edges, _, other, _, _, _ = by_point
    out = np.empty(point_vector.shape)
    last = step.size - 1
    for i in range(edges.size - 1):
        g0 = point_vector[i, 0] - step[last] * mixed_border[i, 0]
        g1 = point_vector[i, 1] - step[last] * mixed_border[i, 1]
        g2 = point_vector[i, 2] - step[last] * mixed_border[i, 2]
        for k in range(edges[i], edges[i + 1]):
            row = CAMERA * other[k]
            for m in range(CAMERA):
                g0 -= step[row + m] * mixed[k, 0, m]
                g1 -= step[row + m] * mixed[k, 1, m]
                g2 -= step[row + m] * mixed[k, 2, m]
        inverse = inverses[i]
        for n in range(3):
            out[i, n] = inverse[n, 0] * g0 + inverse[n, 1] * g1 + inverse[n, 2] * g2
    return out


@inlined
def _turned(rotation, place):
    x, y, z = place[0], place[1], place[2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@inlined
def _jacobian(rotation, scale, shift, curvature, place, by_camera, by_place, by_focal, seen):
    """Write where a point is seen `(2,)` and its derivatives by camera, place and q; return its depth."""
    px, py, pz = _turned(rotation, place)
    d = 1.0 + curvature * scale * pz
    x, y = (scale * px + shift[0]) / d, (scale * py + shift[1]) / d
    seen[0], seen[1] = x, y
    by_turned = scale / d  # of x by p_x; by p_z it is -x q times that
    bend_x, bend_y = x * curvature * by_turned, y * curvature * by_turned
    by_camera[0, 0] = -bend_x * py
    by_camera[0, 1] = by_turned * pz + bend_x * px
    by_camera[0, 2] = -by_turned * py
    by_camera[1, 0] = -by_turned * pz - bend_y * py
    by_camera[1, 1] = bend_y * px
    by_camera[1, 2] = by_turned * px
    by_camera[0, 3] = by_turned * px - bend_x * pz
    by_camera[1, 3] = by_turned * py - bend_y * pz
    by_camera[0, 4] = by_camera[1, 5] = 1.0 / d
    by_camera[0, 5] = by_camera[1, 4] = 0.0
    for n in range(3):
        by_place[0, n] = by_turned * rotation[0, n] - bend_x * rotation[2, n]
        by_place[1, n] = by_turned * rotation[1, n] - bend_y * rotation[2, n]
    by_focal[0] = -x * by_turned * pz
    by_focal[1] = -y * by_turned * pz
    return d


ROUNDS = 12  # reweighted linear solutions of each start
OPEN = 1e-9  # share of a point's information below which a direction of it is rounding; there the point stays


@compiled
def triangulate(by_point, rotations, scales, shifts, curvature, shape, variance, freedom, nearest, behind):
    """Move each point to where Student's noise makes its observations likeliest, if that is anywhere better.

    From where it is, from all its observations alike, and from its first and its last one alone: an outlier
    spoils one of the starts. Equations are linear in the point once its depths are divided out.
    """
    edges, _, other, x, y, weight = by_point
    most = 1
    for i in range(edges.size - 1):
        most = max(most, edges[i + 1] - edges[i])
    counts = np.empty(most)
    tried, information, vector = np.empty(3), np.empty((3, 3)), np.empty(3)
    row = np.empty(3)
    for i in range(edges.size - 1):
        low, high = edges[i], edges[i + 1]
        if high == low:
            continue
        best = _cost(
            by_point, low, high, rotations, scales, shifts, curvature, shape[i], variance, freedom, nearest,
            behind, counts,
        )  # fmt: skip
        for start in range(3):
            tried[:] = shape[i]
            if start > 0:
                for k in range(low, high):
                    ends = k == low or k == high - 1
                    counts[k - low] = weight[k] if start == 1 or ends else 0.0
            for _ in range(ROUNDS):
                information[:] = 0.0
                vector[:] = 0.0
                for k in range(low, high):
                    t = other[k]
                    for c in range(2):
                        place = x[k] if c == 0 else y[k]
                        for n in range(3):
                            row[n] = scales[t] * (rotations[t, c, n] - place * curvature * rotations[t, 2, n])
                        aim = place - shifts[t, c]
                        for m in range(3):
                            vector[m] += counts[k - low] * row[m] * aim
                            for n in range(3):
                                information[m, n] += counts[k - low] * row[m] * row[n]
                _solve(information, vector, tried)
                cost = _cost(
                    by_point, low, high, rotations, scales, shifts, curvature, tried, variance, freedom,
                    nearest, behind, counts,
                )  # fmt: skip
                if cost < best:
                    best = cost
                    shape[i] = tried


@inlined
def _cost(
    by_point, low, high, rotations, scales, shifts, curvature, place, variance, freedom, nearest, behind,
    counts
):  # fmt: skip
    """Minus the log likelihood of a point's observations; and what each counts in the next solution."""
    _, _, other, x, y, weight = by_point
    cost = 0.0
    for k in range(low, high):
        t = other[k]
        px, py, pz = _turned(rotations[t], place)
        d = 1.0 + curvature * scales[t] * pz
        square = behind
        if d >= nearest:
            dx = x[k] - (scales[t] * px + shifts[t, 0]) / d
            dy = y[k] - (scales[t] * py + shifts[t, 1]) / d
            square = min(dx * dx + dy * dy, behind)
        ratio = weight[k] * square / (freedom * variance)
        cost += np.log(1.0 + ratio)
        safe = max(d, nearest)
        counts[k - low] = weight[k] / ((1.0 + ratio) * safe * safe)
    return cost


@inlined
def _solve(matrix, vector, out):
    """Write the solution of a symmetric system of 3; where rounding decides, `out` hardly changes."""
    ridge = OPEN * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]) + 1e-30
    a00, a11, a22 = matrix[0, 0] + ridge, matrix[1, 1] + ridge, matrix[2, 2] + ridge
    a01, a02, a12 = matrix[0, 1], matrix[0, 2], matrix[1, 2]
    b0, b1, b2 = vector[0] + ridge * out[0], vector[1] + ridge * out[1], vector[2] + ridge * out[2]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    out[0] = (c00 * b0 + c01 * b1 + c02 * b2) / determinant
    out[1] = (c01 * b0 + c11 * b1 + c12 * b2) / determinant
    out[2] = (c02 * b0 + c12 * b1 + c22 * b2) / determinant


@compiled
def prediction_covariances(
    rotations, scales, shifts, curvature, shape, of_cameras, of_points, of_points_and_cameras
):
    """Return covariances `(n_frames, n_points, 2, 2)` of all points in all frames, to first order.

    From those of each frame's camera and q `(n_frames, 7, 7)`, points, and both `(n_points, 3, 6 n_frames +
    1)`.
    """
    n_frames, n_points = scales.size, shape.shape[0]
    out = np.empty((n_frames, n_points, 2, 2))
    last = CAMERA
    by_camera, by_place, by_focal = np.zeros((2, CAMERA)), np.zeros((2, 3)), np.zeros(2)
    rows, seen = np.zeros((2, CAMERA + 1)), np.zeros(2)
    for t in range(n_frames):
        for i in range(n_points):
            _jacobian(
                rotations[t], scales[t], shifts[t], curvature, shape[i], by_camera, by_place, by_focal, seen
            )
            for c in range(2):
                rows[c, :last] = by_camera[c]
                rows[c, last] = by_focal[c]
            for c in range(2):
                for e in range(c + 1):
                    total = 0.0
                    for m in range(last + 1):
                        for n in range(last + 1):
                            total += rows[c, m] * of_cameras[t, m, n] * rows[e, n]
                    for m in range(3):
                        for n in range(3):
                            total += by_place[c, m] * of_points[i, m, n] * by_place[e, n]
                        for n in range(last + 1):
                            column = CAMERA * t + n if n < last else CAMERA * n_frames
                            both = of_points_and_cameras[i, m, column]
                            total += both * (by_place[c, m] * rows[e, n] + by_place[e, m] * rows[c, n])
                    out[t, i, c, e] = out[t, i, e, c] = total
    return out

"""Loops of variable projection: points eliminated from the normal equations of cameras and shape."""

import numpy as np

from .....models.numerics.compiled import compiled, inlined

ROUNDING = 1e-13
"""Share of a point's information below which a direction of it is rounding."""


@compiled
def eliminate_points(by_point, cameras):
    """Best points for given cameras, the inverses of their information, and the weighted squared error left.

    `(n_points, 3)` and `(n_points, 3, 3)`. Directions that only rounding determines stay at 0.
    """
    edges, _, other, x, y, weight = by_point
    n_points = edges.size - 1
    shape, inverses = np.empty((n_points, 3)), np.empty((n_points, 3, 3))
    error = 0.0
    for i in range(n_points):
        a00 = a01 = a02 = a11 = a12 = a22 = b0 = b1 = b2 = 0.0
        for k in range(edges[i], edges[i + 1]):
            m, w = cameras[other[k]], weight[k]
            for c in range(2):
                r0, r1, r2 = m[c, 0], m[c, 1], m[c, 2]
                d = w * ((x[k] if c == 0 else y[k]) - m[c, 3])
                a00 += w * r0 * r0
                a01 += w * r0 * r1
                a02 += w * r0 * r2
                a11 += w * r1 * r1
                a12 += w * r1 * r2
                a22 += w * r2 * r2
                b0 += d * r0
                b1 += d * r1
                b2 += d * r2
        least = ROUNDING * (a00 + a11 + a22) + 1e-300
        d0 = 1.0 / np.sqrt(a00) if a00 > least else 0.0
        l10, l20 = a01 * d0, a02 * d0
        p11 = a11 - l10 * l10
        d1 = 1.0 / np.sqrt(p11) if p11 > least else 0.0
        l21 = (a12 - l10 * l20) * d1
        p22 = a22 - l20 * l20 - l21 * l21
        d2 = 1.0 / np.sqrt(p22) if p22 > least else 0.0
        g10, g21 = -l10 * d0 * d1, -l21 * d1 * d2
        g20 = -(l20 * d0 + l21 * g10) * d2
        z0, z1, z2 = d0 * b0, g10 * b0 + d1 * b1, g20 * b0 + g21 * b1 + d2 * b2
        s0, s1, s2 = d0 * z0 + g10 * z1 + g20 * z2, d1 * z1 + g21 * z2, d2 * z2
        shape[i, 0], shape[i, 1], shape[i, 2] = s0, s1, s2
        f = inverses[i]
        f[0, 0], f[1, 1], f[2, 2] = d0 * d0 + g10 * g10 + g20 * g20, d1 * d1 + g21 * g21, d2 * d2
        f[0, 1] = f[1, 0] = g10 * d1 + g20 * g21
        f[0, 2] = f[2, 0] = g20 * d2
        f[1, 2] = f[2, 1] = g21 * d2
        for k in range(edges[i], edges[i + 1]):
            m = cameras[other[k]]
            du = m[0, 0] * s0 + m[0, 1] * s1 + m[0, 2] * s2 + m[0, 3] - x[k]
            dv = m[1, 0] * s0 + m[1, 1] * s1 + m[1, 2] * s2 + m[1, 3] - y[k]
            error += weight[k] * (du * du + dv * dv)
    return shape, inverses, error


@compiled
def camera_gradient(by_point, cameras, shape):
    """Half the derivative of the squared error by cameras, `(n_frames, 2, 4)`."""
    edges, _, other, x, y, weight = by_point
    gradient = np.zeros(cameras.shape)
    for i in range(edges.size - 1):
        s0, s1, s2 = shape[i, 0], shape[i, 1], shape[i, 2]
        for k in range(edges[i], edges[i + 1]):
            t, w = other[k], weight[k]
            m = cameras[t]
            a = w * (m[0, 0] * s0 + m[0, 1] * s1 + m[0, 2] * s2 + m[0, 3] - x[k])
            b = w * (m[1, 0] * s0 + m[1, 1] * s1 + m[1, 2] * s2 + m[1, 3] - y[k])
            _add_outer(gradient[t], a, b, s0, s1, s2)
    return gradient


@inlined
def _add_outer(out, a, b, s0, s1, s2):
    """Add (a, b) (S, 1)^T to a camera's matrix."""
    out[0, 0] += a * s0
    out[0, 1] += a * s1
    out[0, 2] += a * s2
    out[0, 3] += a
    out[1, 0] += b * s0
    out[1, 1] += b * s1
    out[1, 2] += b * s2
    out[1, 3] += b


@compiled
def reduced_step(by_point, by_frame, system, accuracy, most):
    """Gauss-Newton step of the cameras `(n_frames, 2, 4)` with points eliminated, by conjugate gradients.

    The matrix is never formed: a product with it goes through both lists of observations once. It leaves out
    how the eliminated points' own directions turn (Kaufman), as all variable projection does that works well.

    Parameters
    ----------
    by_point, by_frame
        the observations in both orders.
    system
        the normal equations, a `System`.
    accuracy, most
        relative, and number of products at most.
    """
    cameras, shape, inverses, information, preconditioner, gradient, damping = system
    n_frames, n_points = cameras.shape[0], shape.shape[0]
    step, residual = np.zeros(gradient.shape), -gradient
    direction, product = np.zeros(gradient.shape), np.empty(gradient.shape)
    solved = np.empty(gradient.shape)
    of_frames, of_points = np.empty((n_frames, ENTRIES)), np.empty((n_points, ENTRIES))
    length = first_length = 1.0
    for turn in range(most):
        before = length
        length = 0.0
        for t in range(n_frames):
            for c in range(2):
                for j in range(4):
                    total = 0.0
                    for n in range(4):
                        total += preconditioner[t, j, n] * residual[t, c, n]
                    solved[t, c, j] = total
                    length += total * residual[t, c, j]
        if turn == 0:
            first_length = length
        if length <= accuracy * accuracy * first_length:
            break
        direction = solved + (length / before if turn else 0.0) * direction
        _turned_by(cameras, direction, of_frames)
        _weighted_sums(by_point, of_frames, of_points)
        _answers(inverses, shape, of_points)
        _weighted_sums(by_frame, of_points, of_frames)
        stride = 0.0
        for t in range(n_frames):
            for c in range(2):
                for j in range(4):
                    total = damping * direction[t, c, j]
                    for n in range(4):
                        total += information[t, j, n] * direction[t, c, n]
                    for k in range(3):
                        total -= cameras[t, c, k] * of_frames[t, 4 * k + j]
                    product[t, c, j] = total
                    stride += total * direction[t, c, j]
        stride = length / max(stride, 1e-300)
        step += stride * direction
        residual -= stride * product
    return step


ENTRIES = 12
"""Of a 3x4 matrix; sums over observations are of such, for which vector units serve."""


@inlined
def _turned_by(cameras, direction, of_frames):
    """Write R^T D for every frame."""
    for t in range(cameras.shape[0]):
        for k in range(3):
            for j in range(4):
                total = cameras[t, 0, k] * direction[t, 0, j] + cameras[t, 1, k] * direction[t, 1, j]
                of_frames[t, 4 * k + j] = total


@inlined
def _weighted_sums(listed, rows, out):
    """Write for each frame (point) the weighted sum of the rows of its points (frames)."""
    edges, _, other, _, _, weight = listed
    for k in range(out.shape[0]):
        total = out[k]
        for j in range(ENTRIES):
            total[j] = 0.0
        for n in range(edges[k], edges[k + 1]):
            row, w = rows[other[n]], weight[n]
            for j in range(ENTRIES):
                total[j] += w * row[j]


@inlined
def _answers(inverses, shape, of_points):
    """From the sums E of R^T D, write z (S, 1)^T for every point, z = inverse E (S, 1)."""
    for i in range(shape.shape[0]):
        e, f, s = of_points[i], inverses[i], shape[i]
        y0 = e[0] * s[0] + e[1] * s[1] + e[2] * s[2] + e[3]
        y1 = e[4] * s[0] + e[5] * s[1] + e[6] * s[2] + e[7]
        y2 = e[8] * s[0] + e[9] * s[1] + e[10] * s[2] + e[11]
        for k in range(3):
            z = f[k, 0] * y0 + f[k, 1] * y1 + f[k, 2] * y2
            for j in range(3):
                e[4 * k + j] = z * s[j]
            e[4 * k + 3] = z

"""Loops of the polish: points eliminated from the normal equations of cameras and shape."""

import numpy as np

from ..models.compiled import compiled, inlined

ROUNDING = 1e-13
"""Share of a point's information below which a direction of it is rounding."""


@compiled
def eliminate_points(edges, other, x, y, weight, cameras):
    """Best points for given cameras, factors of their covariances, and the weighted squared error left.

    `(n_points, 3)` and `(n_points, 3, 3)`: L^-T of the Cholesky factors L of their information. Directions that
    only rounding determines stay at 0.
    """
    n_points = edges.size - 1
    shape, factors = np.empty((n_points, 3)), np.zeros((n_points, 3, 3))
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
        f = factors[i]
        f[0, 0], f[0, 1], f[0, 2] = d0, g10, g20
        f[1, 1], f[1, 2] = d1, g21
        f[2, 2] = d2
        for k in range(edges[i], edges[i + 1]):
            m = cameras[other[k]]
            du = m[0, 0] * s0 + m[0, 1] * s1 + m[0, 2] * s2 + m[0, 3] - x[k]
            dv = m[1, 0] * s0 + m[1, 1] * s1 + m[1, 2] * s2 + m[1, 3] - y[k]
            error += weight[k] * (du * du + dv * dv)
    return shape, factors, error


@compiled
def camera_gradient(edges, other, x, y, weight, cameras, shape):
    """Half the derivative of the squared error by cameras, `(n_frames, 2, 4)`."""
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
def reduced_step(
    edges, other, weight, cameras, shape, factors, information, inverse, gradient, damping, accuracy, most
):
    """Gauss-Newton step of the cameras `(n_frames, 2, 4)` with points eliminated, by conjugate gradients.

    The matrix is never formed: a product with it goes through the list of observations once. It leaves out how
    the eliminated points' own directions turn (Kaufman), as all variable projection does that works well.

    Parameters
    ----------
    edges, other, weight
        observations by point.
    cameras, shape, factors
        `shape` and `factors` of `eliminate_points` for these cameras.
    information, inverse
        `(n_frames, 4, 4)` of the cameras at fixed points, and the inverse of it plus `damping`.
    gradient
        of `camera_gradient`.
    damping
        added to the diagonal.
    accuracy, most
        relative, and number of products at most.
    """
    step, residual = np.zeros(gradient.shape), -gradient
    direction, product = np.zeros(gradient.shape), np.empty(gradient.shape)
    solved = np.empty(gradient.shape)
    length = first_length = 1.0
    for turn in range(most):
        before = length
        length = 0.0
        for t in range(cameras.shape[0]):
            for c in range(2):
                for j in range(4):
                    total = 0.0
                    for n in range(4):
                        total += inverse[t, j, n] * residual[t, c, n]
                    solved[t, c, j] = total
                    length += total * residual[t, c, j]
        if turn == 0:
            first_length = length
        if length <= accuracy * accuracy * first_length:
            break
        direction = solved + (length / before if turn else 0.0) * direction
        _reduced_product(
            edges, other, weight, cameras, shape, factors, information, damping, direction, product
        )
        stride = length / max(np.sum(direction * product), 1e-300)
        step += stride * direction
        residual -= stride * product
    return step


@inlined
def _reduced_product(
    edges, other, weight, cameras, shape, factors, information, damping, direction, product
):
    """Write the reduced normal matrix times a direction."""
    for t in range(cameras.shape[0]):
        for c in range(2):
            for j in range(4):
                total = damping * direction[t, c, j]
                for n in range(4):
                    total += information[t, j, n] * direction[t, c, n]
                product[t, c, j] = total
    for i in range(edges.size - 1):
        s0, s1, s2 = shape[i, 0], shape[i, 1], shape[i, 2]
        y0 = y1 = y2 = 0.0
        for k in range(edges[i], edges[i + 1]):
            w, m, d = weight[k], cameras[other[k]], direction[other[k]]
            a = w * (d[0, 0] * s0 + d[0, 1] * s1 + d[0, 2] * s2 + d[0, 3])
            b = w * (d[1, 0] * s0 + d[1, 1] * s1 + d[1, 2] * s2 + d[1, 3])
            y0 += m[0, 0] * a + m[1, 0] * b
            y1 += m[0, 1] * a + m[1, 1] * b
            y2 += m[0, 2] * a + m[1, 2] * b
        f = factors[i]
        z0 = f[0, 0] * y0
        z1 = f[0, 1] * y0 + f[1, 1] * y1
        z2 = f[0, 2] * y0 + f[1, 2] * y1 + f[2, 2] * y2
        y0 = f[0, 0] * z0 + f[0, 1] * z1 + f[0, 2] * z2
        y1 = f[1, 1] * z1 + f[1, 2] * z2
        y2 = f[2, 2] * z2
        for k in range(edges[i], edges[i + 1]):
            w, m = weight[k], cameras[other[k]]
            a = -w * (m[0, 0] * y0 + m[0, 1] * y1 + m[0, 2] * y2)
            b = -w * (m[1, 0] * y0 + m[1, 1] * y1 + m[1, 2] * y2)
            _add_outer(product[other[k]], a, b, s0, s1, s2)

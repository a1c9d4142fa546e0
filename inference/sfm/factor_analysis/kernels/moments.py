"""Loops of factor analysis: moments over observations, cameras frame by frame, points one by one.

Observations come by frame or by point, as `Listed` of `observations` has them. A symmetric 4x4 matrix is ten
numbers: 00 01 02 03 11 12 13 22 23 33.
"""

import numpy as np

from .....models.numerics.compiled import compiled, inlined


@compiled
def frame_moments(listed, shape, shape_moments):
    """Information `(n_frames, 4, 4)` and vector `(n_frames, 4, 2)` that points give of each camera's rows.

    At noise variance 1. `shape` is `(n_points, 3)`, `shape_moments` `(n_points, 10)` E[s s^T], s = (S, 1).
    """
    edges, _, other, x, y, weight = listed
    n_frames = edges.size - 1
    information = np.empty((n_frames, 4, 4))
    vector = np.empty((n_frames, 4, 2))
    for t in range(n_frames):
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = a8 = a9 = 0.0
        b0 = b1 = b2 = b3 = c0 = c1 = c2 = c3 = 0.0
        for k in range(edges[t], edges[t + 1]):
            i, w = other[k], weight[k]
            phi, s = shape_moments[i], shape[i]
            a0 += w * phi[0]
            a1 += w * phi[1]
            a2 += w * phi[2]
            a3 += w * phi[3]
            a4 += w * phi[4]
            a5 += w * phi[5]
            a6 += w * phi[6]
            a7 += w * phi[7]
            a8 += w * phi[8]
            a9 += w
            wx, wy = w * x[k], w * y[k]
            b0 += wx * s[0]
            b1 += wx * s[1]
            b2 += wx * s[2]
            b3 += wx
            c0 += wy * s[0]
            c1 += wy * s[1]
            c2 += wy * s[2]
            c3 += wy
        _unpack((a0, a1, a2, a3, a4, a5, a6, a7, a8, a9), information[t])
        h = vector[t]
        h[0, 0], h[1, 0], h[2, 0], h[3, 0] = b0, b1, b2, b3
        h[0, 1], h[1, 1], h[2, 1], h[3, 1] = c0, c1, c2, c3
    return information, vector


@inlined
def _unpack(numbers, matrix):
    """Write ten numbers as a symmetric matrix."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9 = numbers
    matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[0, 3] = a0, a1, a2, a3
    matrix[1, 0], matrix[1, 1], matrix[1, 2], matrix[1, 3] = a1, a4, a5, a6
    matrix[2, 0], matrix[2, 1], matrix[2, 2], matrix[2, 3] = a2, a5, a7, a8
    matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3] = a3, a6, a8, a9


@compiled
def point_moments(listed, cameras, camera_moments):
    """Information `(n_points, 3, 3)`, vector `(n_points, 3)` and quadratic `(n_points,)` of each point.

    E[sum_t w |x_t - M_t (S, 1)|^2] = quadratic - 2 vector . S + S . information S. `cameras` is
    `(n_frames, 2, 4)`, `camera_moments` `(n_frames, 10)`: E[m m^T] summed over both rows m.
    """
    edges, _, other, x, y, weight = listed
    n_points = edges.size - 1
    information = np.empty((n_points, 3, 3))
    vector = np.empty((n_points, 3))
    quadratic = np.empty(n_points)
    for i in range(n_points):
        a0 = a1 = a2 = a4 = a5 = a7 = b0 = b1 = b2 = total = 0.0
        for k in range(edges[i], edges[i + 1]):
            t, w = other[k], weight[k]
            m, phi = cameras[t], camera_moments[t]
            u, v = x[k], y[k]
            a0 += w * phi[0]
            a1 += w * phi[1]
            a2 += w * phi[2]
            a4 += w * phi[4]
            a5 += w * phi[5]
            a7 += w * phi[7]
            b0 += w * (m[0, 0] * u + m[1, 0] * v - phi[3])
            b1 += w * (m[0, 1] * u + m[1, 1] * v - phi[6])
            b2 += w * (m[0, 2] * u + m[1, 2] * v - phi[8])
            total += w * (u * (u - 2.0 * m[0, 3]) + v * (v - 2.0 * m[1, 3]) + phi[9])
        matrix, h = information[i], vector[i]
        matrix[0, 0], matrix[0, 1], matrix[0, 2] = a0, a1, a2
        matrix[1, 0], matrix[1, 1], matrix[1, 2] = a1, a4, a5
        matrix[2, 0], matrix[2, 1], matrix[2, 2] = a2, a5, a7
        h[0], h[1], h[2] = b0, b1, b2
        quadratic[i] = total
    return information, vector, quadratic


@compiled
def squared_error(listed, cameras, shape):
    """Weighted squared error of each point `(n_points,)` at given cameras and shape."""
    edges, _, other, x, y, weight = listed
    error = np.zeros(edges.size - 1)
    for i in range(error.size):
        s0, s1, s2 = shape[i, 0], shape[i, 1], shape[i, 2]
        total = 0.0
        for k in range(edges[i], edges[i + 1]):
            m = cameras[other[k]]
            du = x[k] - (m[0, 0] * s0 + m[0, 1] * s1 + m[0, 2] * s2 + m[0, 3])
            dv = y[k] - (m[1, 0] * s0 + m[1, 1] * s1 + m[1, 2] * s2 + m[1, 3])
            total += weight[k] * (du * du + dv * dv)
        error[i] = total
    return error


@compiled
def invert_information(information, prior, scale):
    """Covariances `(n, d, d)` and log determinants `(n,)` of `scale * information + diag(prior)`."""
    n, d = information.shape[0], information.shape[1]
    covariance = np.empty((n, d, d))
    log_determinant = np.empty(n)
    factor = np.zeros((d, d))
    inverse = np.zeros((d, d))
    for i in range(n):
        log_determinant[i] = _invert(information[i], prior, scale, factor, inverse, covariance[i])
    return covariance, log_determinant


@compiled
def _invert(information, prior, scale, factor, inverse, covariance):
    """Invert by Cholesky; `factor` and `inverse` are work space, zero above the diagonal."""
    d = prior.size
    log_determinant = 0.0
    for j in range(d):
        for k in range(j + 1):
            total = scale * information[j, k]
            if k == j:
                total += prior[j]
            for n in range(k):
                total -= factor[j, n] * factor[k, n]
            if k == j:
                # rounding may eat up what little information there is in a direction
                total = max(total, 1e-14 * (scale * information[j, j] + prior[j]) + 1e-300)
                log_determinant += np.log(total)
                factor[j, j] = np.sqrt(total)
            else:
                factor[j, k] = total / factor[k, k]
    for j in range(d):
        inverse[j, j] = 1.0 / factor[j, j]
        for k in range(j):
            total = 0.0
            for n in range(k, j):
                total -= factor[j, n] * inverse[n, k]
            inverse[j, k] = total / factor[j, j]
    for j in range(d):
        for k in range(j + 1):
            total = 0.0
            for n in range(j, d):
                total += inverse[n, j] * inverse[n, k]
            covariance[j, k] = total
            covariance[k, j] = total
    return log_determinant


@compiled
def connected_frames(by_frame, by_point, first, second, shared, views):
    """Frames that hang together with two frames to begin with, bool `(n_frames,)`.

    Points are known once `views` frames that hang together show them, frames as soon as they show `shared`
    known points.
    """
    n_frames, n_points = by_frame.edges.size - 1, by_point.edges.size - 1
    joined = np.zeros(n_frames, np.bool_)
    seen_in, known_in = np.zeros(n_points, np.int64), np.zeros(n_frames, np.int64)
    waiting = np.empty(n_frames, np.int64)
    waiting[0], waiting[1] = first, second
    joined[first] = joined[second] = True
    done, end = 0, 2
    while done < end:
        t = waiting[done]
        done += 1
        for k in range(by_frame.edges[t], by_frame.edges[t + 1]):
            i = by_frame.other[k]
            seen_in[i] += 1
            if seen_in[i] == views:
                for n in range(by_point.edges[i], by_point.edges[i + 1]):
                    other = by_point.other[n]
                    known_in[other] += 1
                    if known_in[other] >= shared and not joined[other]:
                        joined[other] = True
                        waiting[end] = other
                        end += 1
    return joined


@compiled
def point_leverages(listed, cameras, inverses):
    """Share of each observation `(n_observations,)`, by frame, in its point: mean of both coordinates, 0..1.

    `inverses` `(n_points, 3, 3)` of the points' information at noise variance 1.
    """
    edges, _, other, _, _, weight = listed
    leverages = np.empty(weight.size)
    for t in range(edges.size - 1):
        m = cameras[t]
        # sum over rows of r P r^T = sum of P times these
        q00 = m[0, 0] * m[0, 0] + m[1, 0] * m[1, 0]
        q11 = m[0, 1] * m[0, 1] + m[1, 1] * m[1, 1]
        q22 = m[0, 2] * m[0, 2] + m[1, 2] * m[1, 2]
        q01 = 2.0 * (m[0, 0] * m[0, 1] + m[1, 0] * m[1, 1])
        q02 = 2.0 * (m[0, 0] * m[0, 2] + m[1, 0] * m[1, 2])
        q12 = 2.0 * (m[0, 1] * m[0, 2] + m[1, 1] * m[1, 2])
        for k in range(edges[t], edges[t + 1]):
            p = inverses[other[k]]
            total = p[0, 0] * q00 + p[1, 1] * q11 + p[2, 2] * q22
            total += p[0, 1] * q01 + p[0, 2] * q02 + p[1, 2] * q12
            leverages[k] = min(0.5 * weight[k] * total, 1.0)
    return leverages

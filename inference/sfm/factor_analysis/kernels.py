"""Loops of factor analysis: moments over observations, cameras frame by frame, points one by one.

Observations come by frame or by point, as in `observations.SparseObservations`. A symmetric 4x4 matrix is ten
numbers: 00 01 02 03 11 12 13 22 23 33.
"""

import numpy as np

from ....models.numerics.compiled import compiled, inlined


@compiled
def frame_moments(listed, shape, shape_moments):
    """Return information `(n_frames, 4, 4)` and vector `(n_frames, 4, 2)` of cameras, from points.

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
    """Return information `(n_points, 3, 3)`, vector `(n_points, 3)`, quadratic `(n_points,)` of points.

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
    """Return weighted squared error of each point `(n_points,)` at given cameras and shape."""
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
    """Return covariances `(n, d, d)` and log determinants `(n,)` of `scale * information + diag(prior)`."""
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
def point_leverages(listed, cameras, inverses):
    """Return the leverage of each observation `(n_observations,)` on its point, 0 to 1.

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


ROW = 4
STATE = 12
BACK = np.kron([[1.0, -1.0, 0.5], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]], np.eye(ROW))  # inverse of F in eq. (19)


def smooth_cameras(information, vector, precision, noise, start_mean, start_variance):
    """Return posterior of the cameras under eq. (19), and what it says of the motion's noise.

    `information` `(n_frames, 4, 4)` and `vector` `(n_frames, 4, 2)` are those of the camera rows at noise
    variance 1, `precision` is 1 / that of the observations, `noise` `(12,)` variances of eps_1, eps_2,
    eps_3. The start `(12, 2)`, `(12,)` is of the first frame with information; frames before are foreseen
    backwards. Returns cameras `(n_frames, 2, 4)` and covariance `(n_frames, 4, 4)`; the log integral of p(M)
    exp(sum of (vector . m - m . information m / 2) precision) dM; and `(12,)` squares and counts, both
    positive, whose difference is twice its derivative by `noise`.
    """
    n_frames = len(information)
    seen = np.flatnonzero(information[:, -1, -1] > 0)
    first = int(seen[0]) if len(seen) else n_frames - 1
    n = n_frames - first
    means, spreads = np.empty((n, STATE, 2)), np.empty((n, STATE, STATE))
    means[0], spreads[0] = start_mean, np.diag(start_variance)
    filtered = means, spreads, np.empty((n, ROW, STATE)), np.empty((n, ROW, ROW)), np.empty((n, ROW, 2))
    log_evidence = _filter(
        np.ascontiguousarray(information[first:]), vector[first:], precision, noise, *filtered
    )
    cameras, covariance = np.empty((n_frames, 2, ROW)), np.empty((n_frames, ROW, ROW))
    squares, counts, pull, stiffness = _smooth(*filtered, cameras[first:], covariance[first:])
    if first > 0:
        spread = spreads[0] - spreads[0] @ stiffness @ spreads[0]
        mean = means[0] + spreads[0] @ pull
        for t in range(first - 1, -1, -1):
            mean, spread = BACK @ mean, BACK @ (spread + np.diag(noise)) @ BACK.T
            cameras[t] = mean[:ROW].T
            covariance[t] = 0.5 * (spread + spread.T)[:ROW, :ROW]
    return cameras, covariance, log_evidence, squares, counts


@compiled
def _filter(information, vector, precision, noise, means, spreads, updates, gains, innovations):
    """Fill filtered states from those of the first frame before its update; return the log evidence.

    `updates` B and `gains` G take what later frames say back through an update, which changes the first four
    rows of pull p and stiffness S: B p + innovation; B S, and B S B^T + G.
    """
    scaled, table, left = np.empty((ROW, ROW)), np.empty((ROW, 2 * ROW)), np.empty((STATE, ROW))
    log_evidence = 0.0
    for t in range(information.shape[0]):
        mean, spread, update = means[t], spreads[t], updates[t]
        if t > 0:
            _advance(means[t - 1], mean)
            _advance(spreads[t - 1], spread)
            for j in range(STATE):
                for k in range(ROW):
                    spread[j, k] += spread[j, ROW + k] + 0.5 * spread[j, 2 * ROW + k]
                    spread[j, ROW + k] += spread[j, 2 * ROW + k]
                spread[j, j] += noise[j]
        for j in range(ROW):
            for k in range(ROW):
                scaled[j, k] = precision * information[t, j, k]
        log_evidence -= _invert_sum(scaled, spread, table)
        for j in range(ROW):
            for k in range(ROW):
                update[j, k] = table[j, ROW + k]
                total = 0.0
                for n in range(ROW):
                    total += table[j, ROW + n] * scaled[n, k]
                gains[t, j, k] = total
            for k in range(ROW, STATE):
                total = 0.0
                for n in range(ROW):
                    total -= gains[t, j, n] * spread[n, k]
                update[j, k] = total
        for c in range(2):
            for j in range(ROW):
                explained = 0.0
                for k in range(ROW):
                    explained += scaled[j, k] * mean[k, c]
                pull = precision * vector[t, j, c]
                log_evidence += mean[j, c] * (pull - 0.5 * explained)
                left[j, c] = pull - explained
            for j in range(ROW):
                total = 0.0
                for k in range(ROW):
                    total += update[j, k] * left[k, c]
                innovations[t, j, c] = total
            for j in range(STATE):
                total = 0.0
                for k in range(ROW):
                    total += spread[j, k] * innovations[t, k, c]
                mean[j, c] += total
                if j < ROW:
                    log_evidence += 0.5 * left[j, c] * total
        # the first four columns as a product: their difference from the prediction would cancel
        for j in range(ROW, STATE):
            for k in range(ROW, j + 1):
                total = spread[j, k]
                for n in range(ROW):
                    total += spread[j, n] * update[n, k]
                spread[j, k] = spread[k, j] = total
        for j in range(STATE):
            for k in range(ROW):
                total = 0.0
                for n in range(ROW):
                    total += spread[j, n] * update[n, k]
                left[j, k] = total
        for j in range(STATE):
            for k in range(min(j + 1, ROW)):
                value = 0.5 * (left[j, k] + left[k, j]) if j < ROW else left[j, k]
                spread[j, k] = spread[k, j] = value
    return log_evidence


@compiled
def _smooth(means, spreads, updates, gains, innovations, cameras, covariance):
    """Fill cameras and covariance, back from the last frame; return squares and counts.

    Also what later frames say of the first filtered state x, P: x + P pull, P - P stiffness P.
    """
    squares, counts = np.zeros(STATE), np.zeros(STATE)
    pull, stiffness = np.zeros((STATE, 2)), np.zeros((STATE, STATE))
    product, moved = np.empty((ROW, STATE)), np.empty((ROW, 2))
    for t in range(means.shape[0] - 1, -1, -1):
        spread, update = spreads[t], updates[t]
        for j in range(STATE):
            squares[j] += pull[j, 0] ** 2 + pull[j, 1] ** 2
            counts[j] += 2.0 * stiffness[j, j]
        _retreat(pull)
        _retreat(stiffness)
        for j in range(STATE):
            for k in range(ROW):
                stiffness[j, 2 * ROW + k] += stiffness[j, ROW + k] + 0.5 * stiffness[j, k]
                stiffness[j, ROW + k] += stiffness[j, k]
        _multiply(spread, stiffness, product)
        for j in range(ROW):
            for c in range(2):
                total = means[t, j, c]
                for n in range(STATE):
                    total += spread[j, n] * pull[n, c]
                cameras[t, c, j] = total
            for k in range(j + 1):
                total = spread[j, k]
                for n in range(STATE):
                    total -= product[j, n] * spread[n, k]
                covariance[t, j, k] = covariance[t, k, j] = total
        if t == 0:
            break
        _multiply(update, stiffness, product)
        for j in range(ROW):
            for c in range(2):
                total = innovations[t, j, c]
                for n in range(STATE):
                    total += update[j, n] * pull[n, c]
                moved[j, c] = total
            for k in range(ROW, STATE):
                stiffness[j, k] = stiffness[k, j] = product[j, k]
            for k in range(j + 1):
                total = 0.5 * (gains[t, j, k] + gains[t, k, j])
                for n in range(STATE):
                    total += product[j, n] * update[k, n]
                stiffness[j, k] = stiffness[k, j] = total
        for j in range(ROW):
            pull[j, 0], pull[j, 1] = moved[j, 0], moved[j, 1]
    return squares, counts, pull, stiffness


@compiled
def _advance(before, after):
    """Write F times a matrix of 12 rows, with F of eq. (19)."""
    for j in range(ROW):
        for c in range(after.shape[1]):
            after[j, c] = before[j, c] + before[ROW + j, c] + 0.5 * before[2 * ROW + j, c]
            after[ROW + j, c] = before[ROW + j, c] + before[2 * ROW + j, c]
            after[2 * ROW + j, c] = before[2 * ROW + j, c]


@compiled
def _retreat(rows):
    """F^T times a matrix of 12 rows, in place."""
    for j in range(ROW):
        for c in range(rows.shape[1]):
            rows[2 * ROW + j, c] += rows[ROW + j, c] + 0.5 * rows[j, c]
            rows[ROW + j, c] += rows[j, c]


@compiled
def _multiply(one, other, out):
    """Write the first four rows of `one @ other`, with `other` 12x12."""
    for j in range(ROW):
        for k in range(STATE):
            out[j, k] = 0.0
        for n in range(STATE):
            for k in range(STATE):
                out[j, k] += one[j, n] * other[n, k]


@compiled
def _invert_sum(scaled, spread, table):
    """Write W = (I + information P)^-1 as the last four columns, by elimination with pivots.

    Returns log |W^-1|.
    """
    for j in range(ROW):
        for k in range(ROW):
            total = 1.0 if j == k else 0.0
            table[j, ROW + k] = total
            for n in range(ROW):
                total += scaled[j, n] * spread[n, k]
            table[j, k] = total
    log_determinant = 0.0
    for j in range(ROW):
        best = j
        for k in range(j + 1, ROW):
            if abs(table[k, j]) > abs(table[best, j]):
                best = k
        if best != j:
            for n in range(2 * ROW):
                table[j, n], table[best, n] = table[best, n], table[j, n]
        pivot = table[j, j]
        log_determinant += np.log(abs(pivot))
        for n in range(2 * ROW):
            table[j, n] /= pivot
        for k in range(ROW):
            if k != j:
                factor = table[k, j]
                for n in range(2 * ROW):
                    table[k, n] -= factor * table[j, n]
    return log_determinant


ROUNDING = 1e-13  # share of a point's information below which a direction of it is rounding


@compiled
def eliminate_points(by_point, cameras):
    """Return the best points for given cameras, inverses of their information, and the squared error.

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
    """Return half the derivative of the squared error by cameras, `(n_frames, 2, 4)`."""
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
def reduced_step(
    by_point, by_frame, cameras, shape, inverses, information, preconditioner, gradient, damping, accuracy,
    most,
):  # fmt: skip
    """Return the Gauss-Newton step of cameras `(n_frames, 2, 4)`, points eliminated, by conjugate gradients.

    The matrix is never formed: a product with it goes through both lists of observations once. It leaves out
    how the eliminated points' own directions turn (Kaufman). `shape` and `inverses` are those that
    `eliminate_points` gives for the cameras, `information` `(n_frames, 4, 4)` is that of cameras at fixed
    points and `preconditioner` the inverse of it plus `damping`; `accuracy` is relative, and `most` the
    number of products.
    """
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
        _apply_inverses(inverses, shape, of_points)
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


ENTRIES = 12  # of a 3x4 matrix; sums over observations are of such, for which vector units serve


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
def _apply_inverses(inverses, shape, of_points):
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

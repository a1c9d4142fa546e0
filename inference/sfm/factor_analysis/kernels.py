"""Loops of factor analysis: small matrices, the smoother of coherent cameras, points that cover frames."""

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled

Array = NDArray[np.float64]


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


ROW = 4
STATE = 12
BACK = np.kron([[1.0, -1.0, 0.5], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]], np.eye(ROW))  # inverse of F in eq. (19)


def smooth_cameras(
    information: Array,
    vector: Array,
    precision: float,
    noise: Array,
    start_mean: Array,
    start_variance: Array,
) -> tuple[Array, Array, float, Array, Array]:
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


@compiled
def cover(seen, order, enough):
    """Return which points to take, tried in `order`, while one of their frames shows fewer than `enough`."""
    taken, counts = np.zeros(seen.shape[1], np.bool_), np.zeros(seen.shape[0], np.int64)
    for point in order:
        for t in range(seen.shape[0]):
            taken[point] |= seen[t, point] and counts[t] < enough
        for t in range(seen.shape[0]):
            counts[t] += taken[point] and seen[t, point]
    return taken

"""Smoother of camera rows under second-order motion, RSMCM eq. (19), where a frame's points are information.

A state is `(m, m', m'')`, four numbers each; u and v have the same covariances, so they are the two columns
of every mean. Observations come in information form and need not determine a frame; nothing is ever
inverted but 4x4 matrices of the form I + (positive), so that neither a frame without points nor motion
almost without noise does harm (disturbance smoother; a textbook RTS smoother inverts every prediction).
"""

import numpy as np

from .....models.numerics.compiled import compiled, inlined

ROW = 4
STATE = 12


@compiled
def smooth_cameras(information, vector, precision, noise, start_mean, start_variance):
    """Posterior of the cameras under eq. (19), and what it says of the motion's noise.

    Parameters
    ----------
    information, vector
        `(n_frames, 4, 4)` and `(n_frames, 4, 2)`, of the camera rows at noise variance 1.
    precision
        1 / noise variance of the observations.
    noise
        `(12,)` variances of eps_1, eps_2, eps_3.
    start_mean, start_variance
        `(12, 2)` and `(12,)` of the state in the first frame with information. Frames before that are
        foreseen backwards from there, as if nothing were known of the very first one.

    Returns
    -------
    cameras, covariance
        `(n_frames, 2, 4)` and `(n_frames, 4, 4)`.
    log_evidence
        log integral of p(M) exp(sum of (vector . m - m . information m / 2) precision) dM.
    squares, counts
        `(12,)`: twice the derivative of the log evidence by `noise` is `squares - counts`, both positive.
    """
    n_frames = information.shape[0]
    first = 0
    while first < n_frames - 1 and information[first, ROW - 1, ROW - 1] <= 0.0:
        first += 1
    mean, spread = start_mean.copy(), np.diag(start_variance)
    filtered, log_evidence = _filtered(information, vector, precision, noise, first, mean, spread)
    cameras, covariance = np.empty((n_frames, 2, ROW)), np.empty((n_frames, ROW, ROW))
    squares, counts = _smoothed(filtered, first, mean, spread, cameras, covariance)
    for t in range(first - 1, -1, -1):
        for j in range(STATE):
            spread[j, j] += noise[j]
        _undo(mean)
        _undo(spread)
        _undo(spread.T)
        _read(mean, spread, cameras[t], covariance[t])
    return cameras, covariance, log_evidence, squares, counts


@inlined
def _filtered(information, vector, precision, noise, first, mean, spread):
    """The way forward, from the state `mean`, `spread` (changed in place) of frame `first`.

    Returns, for every frame, what the way back needs (filtered means and covariances; of the predictions
    P H^T, the gain on it, (I + information H P H^T)^-1 and the innovation), and the log evidence.
    """
    n_frames = information.shape[0]
    means, spreads = np.empty((n_frames, STATE, 2)), np.empty((n_frames, STATE, STATE))
    ahead, gains = np.empty((n_frames, STATE, ROW)), np.empty((n_frames, ROW, ROW))
    shrinks = np.empty((n_frames, ROW, ROW))
    innovations = np.empty((n_frames, ROW, 2))
    scaled, left = np.empty((ROW, ROW)), np.empty((STATE, ROW))
    log_evidence = 0.0
    for t in range(first, n_frames):
        if t > first:
            _advance(mean)
            _advance(spread)
            _advance(spread.T)
            for j in range(STATE):
                spread[j, j] += noise[j]
        for j in range(ROW):
            for k in range(ROW):
                scaled[j, k] = precision * information[t, j, k]
        ahead[t] = spread[:, :ROW]
        shrink = shrinks[t]
        log_evidence -= _shrinkage(scaled, spread, shrink)
        log_evidence += _innovate(scaled, vector[t], precision, mean, spread, shrink, innovations[t])
        _multiply(shrink, scaled, gains[t])
        _multiply(ahead[t], gains[t], left)
        for j in range(STATE):
            for c in range(2):
                for n in range(ROW):
                    mean[j, c] += ahead[t, j, n] * innovations[t, n, c]
        # the first four columns as a product: their difference from the prediction would cancel
        for j in range(ROW, STATE):
            for k in range(ROW, j + 1):
                total = spread[j, k]
                for n in range(ROW):
                    total -= left[j, n] * ahead[t, k, n]
                spread[j, k] = spread[k, j] = total
        _multiply(ahead[t], shrink, left)
        for j in range(STATE):
            for k in range(min(j + 1, ROW)):
                value = 0.5 * (left[j, k] + left[k, j]) if j < ROW else left[j, k]
                spread[j, k] = spread[k, j] = value
        means[t] = mean
        spreads[t] = spread
    return (means, spreads, ahead, gains, shrinks, innovations), log_evidence


@inlined
def _smoothed(filtered, first, mean, spread, cameras, covariance):
    """The way back to frame `first`, whose state is written to `mean`, `spread`; and every frame's camera.

    Returns squares and counts of `smooth_cameras`.
    """
    means, spreads, ahead, gains, shrinks, innovations = filtered
    product = np.empty((STATE, STATE))
    squares, counts = np.zeros(STATE), np.zeros(STATE)
    # what later frames say of a prediction: x + P pull, P - P stiffness P
    pull, stiffness = np.zeros((STATE, 2)), np.zeros((STATE, STATE))
    for t in range(means.shape[0] - 1, first - 1, -1):
        for j in range(STATE):
            squares[j] += pull[j, 0] ** 2 + pull[j, 1] ** 2
            counts[j] += 2.0 * stiffness[j, j]
        _retreat(pull)
        _retreat(stiffness)
        _retreat(stiffness.T)
        _multiply(stiffness, spreads[t], product)
        rows = STATE if t == first else ROW
        for j in range(rows):
            for c in range(2):
                total = means[t, j, c]
                for n in range(STATE):
                    total += spreads[t, j, n] * pull[n, c]
                mean[j, c] = total
            for k in range(j + 1):
                total = spreads[t, j, k]
                for n in range(STATE):
                    total -= spreads[t, j, n] * product[n, k]
                spread[j, k] = spread[k, j] = total
        _read(mean, spread, cameras[t], covariance[t])
        _through_update(pull, ahead[t], gains[t], shrinks[t])
        _through_update(stiffness, ahead[t], gains[t], shrinks[t])
        _through_update(stiffness.T, ahead[t], gains[t], shrinks[t])
        for j in range(ROW):
            for c in range(2):
                pull[j, c] += innovations[t, j, c]
            for k in range(ROW):
                stiffness[j, k] += gains[t, j, k]
    return squares, counts


@inlined
def _read(mean, spread, camera, covariance):
    """Write the camera that is part of a state, and its covariance."""
    for j in range(ROW):
        for c in range(2):
            camera[c, j] = mean[j, c]
        for k in range(ROW):
            covariance[j, k] = spread[j, k]


@inlined
def _undo(rows):
    """F^-1 times a matrix of 12 rows, in place."""
    for j in range(ROW):
        for c in range(rows.shape[1]):
            rows[ROW + j, c] -= rows[2 * ROW + j, c]
            rows[j, c] -= rows[ROW + j, c] + 0.5 * rows[2 * ROW + j, c]


@inlined
def _advance(rows):
    """F times a matrix of 12 rows, in place, with F of eq. (19)."""
    for j in range(ROW):
        for c in range(rows.shape[1]):
            rows[j, c] += rows[ROW + j, c] + 0.5 * rows[2 * ROW + j, c]
            rows[ROW + j, c] += rows[2 * ROW + j, c]


@inlined
def _retreat(rows):
    """F^T times a matrix of 12 rows, in place."""
    for j in range(ROW):
        for c in range(rows.shape[1]):
            rows[2 * ROW + j, c] += rows[ROW + j, c] + 0.5 * rows[j, c]
            rows[ROW + j, c] += rows[j, c]


@inlined
def _through_update(rows, ahead, gain, shrink):
    """(I - H^T G H P) times a matrix of 12 rows, in place; `ahead` is P H^T.

    Of the first four columns the difference is `shrink` = (I + information H P H^T)^-1, which would drown in
    rounding.
    """
    for c in range(rows.shape[1]):
        v0 = v1 = v2 = v3 = 0.0
        for n in range(ROW, STATE):
            v0 += ahead[n, 0] * rows[n, c]
            v1 += ahead[n, 1] * rows[n, c]
            v2 += ahead[n, 2] * rows[n, c]
            v3 += ahead[n, 3] * rows[n, c]
        w0, w1, w2, w3 = rows[0, c], rows[1, c], rows[2, c], rows[3, c]
        for j in range(ROW):
            kept = shrink[j, 0] * w0 + shrink[j, 1] * w1 + shrink[j, 2] * w2 + shrink[j, 3] * w3
            rows[j, c] = kept - (gain[j, 0] * v0 + gain[j, 1] * v1 + gain[j, 2] * v2 + gain[j, 3] * v3)


@inlined
def _multiply(one, other, out):
    """Write `one @ other` to `out`: small matrices, for which a call of BLAS costs more than the work."""
    for j in range(one.shape[0]):
        for k in range(other.shape[1]):
            total = 0.0
            for n in range(other.shape[0]):
                total += one[j, n] * other[n, k]
            out[j, k] = total


@inlined
def _innovate(scaled, vector, precision, mean, spread, shrink, innovation):
    """Write u, with mean + P H^T u the filtered mean; return the exponent of the log evidence."""
    exponent = 0.0
    for c in range(2):
        residual = np.empty(ROW)
        for j in range(ROW):
            explained = 0.0
            for k in range(ROW):
                explained += scaled[j, k] * mean[k, c]
            residual[j] = precision * vector[j, c]
            exponent += mean[j, c] * (residual[j] - 0.5 * explained)
            residual[j] -= explained
        d0, d1, d2, d3 = residual[0], residual[1], residual[2], residual[3]
        for j in range(ROW):
            innovation[j, c] = shrink[j, 0] * d0 + shrink[j, 1] * d1 + shrink[j, 2] * d2 + shrink[j, 3] * d3
        for j in range(ROW):
            for k in range(ROW):
                exponent += 0.5 * residual[j] * spread[j, k] * innovation[k, c]
    return exponent


@inlined
def _shrinkage(scaled, spread, shrink):
    """Write W = (I + information P)^-1 (4, 4), by elimination with pivots; return log |W^-1|."""
    table = np.zeros((ROW, 2 * ROW))
    for j in range(ROW):
        for k in range(ROW):
            total = 1.0 if j == k else 0.0
            for n in range(ROW):
                total += scaled[j, n] * spread[n, k]
            table[j, k] = total
        table[j, ROW + j] = 1.0
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
    for j in range(ROW):
        for k in range(ROW):
            shrink[j, k] = table[j, ROW + k]
    return log_determinant

"""Loops over small Gaussians, from information to moments and back, and over mixtures of them."""

import math

import numpy as np

from ..numerics.compiled import compiled, inlined


@inlined
def _cholesky(matrix, scales, least, root):
    """Lower root of a matrix scaled to a unit diagonal; whether all its pivots are more than `least`."""
    size = scales.size
    for i in range(size):
        if not matrix[i, i] > 0:
            return False
        scales[i] = math.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j] / (scales[i] * scales[j])
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = value / root[j, j]
            elif value > least:
                root[i, i] = math.sqrt(value)
            else:
                return False
    return True


@inlined
def _inverse(root, scales, lower, out):
    """Inverse of the matrix of which `_cholesky` gave the root; `lower` is for the root's."""
    size = scales.size
    for j in range(size):
        for i in range(j, size):
            value = 1.0 if i == j else 0.0
            for k in range(j, i):
                value -= root[i, k] * lower[k, j]
            lower[i, j] = value / root[i, i]
    for i in range(size):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, size):
                value += lower[k, i] * lower[k, j]
            out[i, j] = out[j, i] = value / (scales[i] * scales[j])


@compiled
def invert(matrices, vectors, least, inverses, products, log_determinants, regular):
    """Inverses of symmetric `(n, d, d)` matrices, and these times vectors `(n, d)`.

    `regular` `(n,)` tells which matrices are positive definite: scaled to a unit diagonal, all pivots of
    their roots are more than `least`. Of the others, what is written is zero.
    """
    size = matrices.shape[1]
    scales, root, lower = np.empty(size), np.zeros((size, size)), np.zeros((size, size))
    for n in range(matrices.shape[0]):
        inverse, product = inverses[n], products[n]
        log_determinant = 0.0
        regular[n] = _cholesky(matrices[n], scales, least, root)
        if regular[n]:
            _inverse(root, scales, lower, inverse)
            for i in range(size):
                log_determinant += math.log(root[i, i] * scales[i])
        else:
            inverse[:] = 0.0
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += inverse[i, j] * vectors[n, j]
            product[i] = value
        log_determinants[n] = 2 * log_determinant


_LOG_TWO_PI = np.log(2 * np.pi)

_BLOCK = 64
"""Points that are looked at together."""


@inlined
def _falling(x):
    """exp(x) for float64 x <= 0, error below 1e-13 (libm's is no vector code)."""
    # to the 256th part, where a short series is enough, and back by squaring
    small = max(x, -80.0) * (1 / 256)
    power = 1 / 24 + small * (1 / 120 + small / 720)
    power = 1.0 + small * (1.0 + small * (0.5 + small * (1 / 6 + small * power)))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


@compiled
def sums_of_densities(points, heights, means, precisions, peaks, sums):
    """Sums over components of exp(height) times an unnormalised Gaussian, by their largest term.

    Parameters
    ----------
    points
        `(n, n_parts, 2)`.
    heights
        `(n_parts, m)` finite: logs of the components' values in their middles.
    means, precisions
        `(n_parts, 2, m)`; `(n_parts, 3, m)`: xx, xy and yy of half the inverse covariances, 0 of flat ones.
    peaks, sums
        `(n, n_parts)` written: log of the largest term, sum of all by it.
    """
    n_parts, m = heights.shape
    logs = np.empty(m)
    for part in range(n_parts):
        height = heights[part]
        mx, my = means[part, 0], means[part, 1]
        xx, xy, yy = precisions[part, 0], precisions[part, 1], precisions[part, 2]
        for k in range(len(points)):
            px, py = points[k, part, 0], points[k, part, 1]
            best = -1e300
            for j in range(m):
                x, y = px - mx[j], py - my[j]
                value = height[j] - (xx[j] * x + 2.0 * xy[j] * y) * x - yy[j] * y * y
                logs[j] = value
                best = max(best, value)
            total = 0.0
            for j in range(m):
                total += _falling(logs[j] - best)
            peaks[k, part], sums[k, part] = best, total


@compiled
def sums_over_hypotheses(points, log_weights, heights, means, precisions, logs):
    """Log of a sum over hypotheses of the products of `sums_of_densities` of all parts.

    Points are taken in blocks, so that loops over them are vector code and all stays in the nearest cache.

    Parameters
    ----------
    points
        `(n, n_parts, 2)`.
    log_weights
        `(h,)` finite, of the hypotheses.
    heights, means, precisions
        as of `sums_of_densities`, for the `n_parts` mixtures of each hypothesis, one after the other.
    logs
        `(n,)` written.
    """
    n_parts, m = points.shape[1], heights.shape[1]
    places = np.zeros((n_parts, 2, _BLOCK))
    values = np.empty((m, _BLOCK))
    peak, product, high, total = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    best, sums = np.empty(_BLOCK), np.empty(_BLOCK)
    for first in range(0, len(points), _BLOCK):
        count = min(_BLOCK, len(points) - first)
        for k in range(count):
            for part in range(n_parts):
                places[part, 0, k], places[part, 1, k] = (
                    points[first + k, part, 0],
                    points[first + k, part, 1],
                )
        best[:], sums[:] = -1e300, 0.0
        for h in range(len(log_weights)):
            peak[:], product[:] = log_weights[h], 1.0
            for part in range(n_parts):
                row = h * n_parts + part
                px, py = places[part, 0], places[part, 1]
                high[:], total[:] = -1e300, 0.0
                for j in range(m):
                    height, mx, my = heights[row, j], means[row, 0, j], means[row, 1, j]
                    xx, xy, yy = precisions[row, 0, j], precisions[row, 1, j], precisions[row, 2, j]
                    value = values[j]
                    for k in range(_BLOCK):
                        x, y = px[k] - mx, py[k] - my
                        value[k] = height - (xx * x + 2.0 * xy * y) * x - yy * y * y
                        high[k] = max(high[k], value[k])
                for j in range(m):
                    value = values[j]
                    for k in range(_BLOCK):
                        total[k] += _falling(value[k] - high[k])
                for k in range(_BLOCK):
                    peak[k] += high[k]
                    product[k] *= total[k]
            for k in range(_BLOCK):
                higher = max(best[k], peak[k])
                sums[k] = sums[k] * _falling(best[k] - higher) + product[k] * _falling(peak[k] - higher)
                best[k] = higher
        for k in range(count):
            logs[first + k] = best[k] + np.log(sums[k])


@compiled
def products(a_means, a_covariances, a_flat, b_means, b_covariances, b_flat, means, covariances, overlaps):
    """Products of each component of one mixture with each of another one.

    Parameters
    ----------
    a_means, a_covariances, a_flat
        `(n_parts, n, 2)`, `(n_parts, n, 2, 2)`, `(n_parts, n)`; likewise of the other one, with m components.
    means, covariances
        `(n_parts, n * m, 2)`, `(n_parts, n * m, 2, 2)` written; those of the other factor if one is flat, of
        the first if both are.
    overlaps
        `(n_parts, n * m)` written: log of the integral of the product, 0 where a factor is flat.
    """
    n_parts, n = a_flat.shape
    m = b_flat.shape[1]
    for part in range(n_parts):
        for i in range(n):
            ax, ay = a_means[part, i, 0], a_means[part, i, 1]
            axx, ayy = a_covariances[part, i, 0, 0], a_covariances[part, i, 1, 1]
            axy = a_covariances[part, i, 0, 1]
            for j in range(m):
                bx, by = b_means[part, j, 0], b_means[part, j, 1]
                bxx, byy = b_covariances[part, j, 0, 0], b_covariances[part, j, 1, 1]
                bxy = b_covariances[part, j, 0, 1]
                overlap = 0.0
                if b_flat[part, j]:
                    x, y, xx, xy, yy = ax, ay, axx, axy, ayy
                elif a_flat[part, i]:
                    x, y, xx, xy, yy = bx, by, bxx, bxy, byy
                else:
                    cxx, cxy, cyy = axx + bxx, axy + bxy, ayy + byy
                    determinant = cxx * cyy - cxy * cxy
                    ixx, ixy, iyy = cyy / determinant, -cxy / determinant, cxx / determinant
                    dx, dy = bx - ax, by - ay
                    rx, ry = ixx * dx + ixy * dy, ixy * dx + iyy * dy
                    x, y = ax + axx * rx + axy * ry, ay + axy * rx + ayy * ry
                    # A (A + B)^-1 B as a sum of positive definite matrices, which rounding leaves so
                    of_a = (bxx * byy - bxy * bxy) / determinant
                    of_b = (axx * ayy - axy * axy) / determinant
                    xx, xy, yy = of_a * axx + of_b * bxx, of_a * axy + of_b * bxy, of_a * ayy + of_b * byy
                    overlap = -_LOG_TWO_PI - 0.5 * np.log(determinant) - 0.5 * (rx * dx + ry * dy)
                place = i * m + j
                means[part, place, 0], means[part, place, 1] = x, y
                covariances[part, place, 0, 0], covariances[part, place, 0, 1] = xx, xy
                covariances[part, place, 1, 0], covariances[part, place, 1, 1] = xy, yy
                overlaps[part, place] = overlap

"""Points from the cameras that see them, one by one, with outliers among what is seen."""

import numpy as np

from .....models.numerics.compiled import compiled, inlined
from .bundle_adjustment import _turned

ROUNDS = 12
"""Reweighted linear solutions of each start."""
OPEN = 1e-9
"""Share of a point's information below which a direction of it is rounding; there the point stays."""


@compiled
def triangulate(by_point, cameras, shape, noise):
    """Move each point to where Student's noise makes its observations likeliest, if that is anywhere better.

    From where it is, from all its observations alike, and from its first and its last one alone: an outlier
    spoils one of the starts. Equations are linear in the point once its depths are divided out.

    Parameters
    ----------
    cameras
        rotations, scales, shifts and curvature of `PerspectiveCameras`.
    shape
        `(n_points, 3)`, changed in place.
    noise
        variance and degrees of freedom; the least depth before a camera, and the squared distance that stands
        for less than that.
    """
    rotations, scales, shifts, curvature = cameras
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
        best = _cost(by_point, low, high, cameras, shape[i], noise, counts)
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
                cost = _cost(by_point, low, high, cameras, tried, noise, counts)
                if cost < best:
                    best = cost
                    shape[i] = tried


@inlined
def _cost(by_point, low, high, cameras, place, noise, counts):
    """Minus the log likelihood of a point's observations; and what each counts in the next solution."""
    _, _, other, x, y, weight = by_point
    rotations, scales, shifts, curvature = cameras
    variance, freedom, nearest, behind = noise
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

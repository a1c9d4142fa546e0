"""Loops that move small patches by fractions of a pixel until they fit a grey picture."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, inlined

UNKNOWNS = 8
"""Offset, gain, rotation, scale and two stretches of a patch, and two by which it moves."""

REGISTERS = 8
"""Numbers of the vector registers that a sum fills at once: with zeros behind, none are left over."""

STEPS = 8
"""Gauss-Newton steps at most."""

SMALL = 0.005
"""px: a step after which there is no other."""

FLAT = 1e-3
"""Squared grey values: the variance of what has no texture at all."""

LONGEST = 0.5
"""px of one coordinate in one step: gradients say nothing of what lies farther away."""


class Expected(NamedTuple):
    """What is known of the places of n patches.

    Parameters
    ----------
    mean
        `(n, 2)` px.
    precision
        `(n, 2, 2)` 1/px^2; zeros where nothing is.
    """

    mean: NDArray[np.float64]
    precision: NDArray[np.float64]


class Light(NamedTuple):
    """How patches change from picture to picture, and the noise; see `align_all`."""

    precisions: NDArray[np.float64]
    smoothed: float
    rounding: float


@inlined
def _cubic(f, k):
    """Weight of the k-th of four neighbours at the fraction f between the middle two (Catmull and Rom)."""
    return (
        0.5 * f * (f * (2.0 - f) - 1.0)
        if k == 0
        else 0.5 * (f * f * (3.0 * f - 5.0) + 2.0)
        if k == 1
        else 0.5 * f * (f * (4.0 - 3.0 * f) + 1.0)
        if k == 2
        else 0.5 * f * f * (f - 1.0)
    )


@compiled
def sample_about(grey, x, y, along, out):
    """Grey values on a grid of `out`'s size with its middle at (x, y); beyond the edge they are the edge's.

    `along` is room for as many columns as `out` has, and three more rows.
    """
    height, width = grey.shape
    side = out.shape[0]
    left, top = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - left, y - top
    left, top = left - side // 2 - 1, top - side // 2 - 1
    w0, w1, w2, w3 = _cubic(fx, 0), _cubic(fx, 1), _cubic(fx, 2), _cubic(fx, 3)
    for i in range(side + 3):
        row = grey[min(max(top + i, 0), height - 1)]
        for j in range(side):
            a, b = min(max(left + j, 0), width - 1), min(max(left + j + 1, 0), width - 1)
            c, d = min(max(left + j + 2, 0), width - 1), min(max(left + j + 3, 0), width - 1)
            along[i, j] = w0 * row[a] + w1 * row[b] + w2 * row[c] + w3 * row[d]
    w0, w1, w2, w3 = _cubic(fy, 0), _cubic(fy, 1), _cubic(fy, 2), _cubic(fy, 3)
    for i in range(side):
        for j in range(side):
            out[i, j] = w0 * along[i, j] + w1 * along[i + 1, j] + w2 * along[i + 2, j] + w3 * along[i + 3, j]


@compiled
def sample_all(grey, positions, patches):
    """Patches `(n, side, side)` about positions `(n, 2)`."""
    side = patches.shape[1]
    along, out = np.empty((side + 3, side)), np.empty((side, side))
    for n in range(patches.shape[0]):
        sample_about(grey, positions[n, 0], positions[n, 1], along, out)
        patches[n] = out


@compiled
def _eliminate(a, b, first, last):
    """Make zeros below the diagonal of a x = b in the columns from `first` to before `last`.

    `a` is symmetric, and only its upper triangle is read and written. What is then left at the lower right is
    the system of the other unknowns alone.
    """
    for k in range(first, last):
        inverse = 1.0 / a[k, k]
        for i in range(k + 1, b.size):
            share = a[k, i] * inverse
            for j in range(i, b.size):
                a[i, j] -= share * a[k, j]
            b[i] -= share * b[k]


@compiled
def _dot(one, other):
    total = 0.0
    for i in range(one.size):
        total += one[i] * other[i]
    return total


@compiled
def _normal_equations(patch, mean, wide, change, normal, right):
    """Sums over a patch of products of what changes its pixels, and with what they are off by.

    Rows of `change`, `(UNKNOWNS + 1, pixels or more)`: offset, gain, rotation, scale, stretch along the axes
    and along the diagonals, then columns and rows by which it moves, and what is off. Of `normal` the upper
    triangle is written. Returned: the sums of squares of what is off and of the patch, of its product with
    the picture, and of the picture and its square.
    """
    side = patch.shape[0]
    half = side // 2
    own = cross = level = total = 0.0
    n = 0
    for i in range(side):
        y = i - half
        for j in range(side):
            x = j - half
            value, centred = wide[i + 1, j + 1], patch[i, j] - mean
            gx, gy = 0.5 * (wide[i + 1, j + 2] - wide[i + 1, j]), 0.5 * (wide[i + 2, j + 1] - wide[i, j + 1])
            change[0, n], change[1, n] = 1.0, centred
            change[2, n], change[3, n] = x * gy - y * gx, x * gx + y * gy
            change[4, n], change[5, n] = x * gx - y * gy, x * gy + y * gx
            change[6, n], change[7, n] = gx, gy
            change[8, n] = value - patch[i, j]
            own += centred * centred
            cross += centred * value
            level += value
            total += value * value
            n += 1
    for k in range(UNKNOWNS):
        for m in range(k, UNKNOWNS):
            normal[k, m] = _dot(change[k], change[m])
        right[k] = _dot(change[k], change[UNKNOWNS])
    return _dot(change[UNKNOWNS], change[UNKNOWNS]), own, cross, level, total


@compiled
def align_all(grey, patches, positions, expected, light, farthest, information, residual, ncc):
    """Move `positions` `(n, 2)` to where the picture is like `patches` `(n, side, side)`.

    Picture = patch + offset + gain (patch - its mean) + its change by a small linear map + noise; offset,
    gain and map have inverse variances `light.precisions`, `(6,)`, in units of the noise's, whose variance is
    `light.smoothed` times that of what is left, plus `light.rounding`. Positions have the prior `expected`.
    Written: `information` `(n, 2, 2)` for noise of variance 1, of the picture alone, with offset, gain and
    map integrated out; the variance of what is left and the normalised correlation, -1 where the way leads
    farther than `farthest` px or picture or patch are flat.
    """
    side = patches.shape[1]
    count = side * side
    precisions = light.precisions
    moves = precisions.size
    along, wide = np.empty((side + 5, side + 2)), np.empty((side + 2, side + 2))
    change = np.zeros((UNKNOWNS + 1, -(-count // REGISTERS) * REGISTERS))
    normal, right = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    for n in range(patches.shape[0]):
        patch, prior = patches[n], expected.precision[n]
        mean = 0.0
        for i in range(side):
            for j in range(side):
                mean += patch[i, j]
        mean /= count
        x, y = positions[n, 0], positions[n, 1]
        near = True
        for step in range(STEPS + 1):
            sample_about(grey, x, y, along, wide)
            left, own, cross, level, total = _normal_equations(patch, mean, wide, change, normal, right)
            for k in range(moves):
                normal[k, k] += precisions[k]
            least = 1e-6 * (normal[moves, moves] + normal[moves + 1, moves + 1]) + 1e-12
            normal[moves, moves] += least
            normal[moves + 1, moves + 1] += least
            _eliminate(normal, right, 0, moves)
            for k in range(moves):
                left -= right[k] * right[k] / normal[k, k]
            xx, xy, yy = normal[moves, moves], normal[moves, moves + 1], normal[moves + 1, moves + 1]
            noise = light.smoothed * max(left, 0.0) / (count - 4) + light.rounding
            off_x, off_y = x - expected.mean[n, 0], y - expected.mean[n, 1]
            a, b, c = xx + noise * prior[0, 0], xy + noise * prior[0, 1], yy + noise * prior[1, 1]
            u = right[moves] + noise * (prior[0, 0] * off_x + prior[0, 1] * off_y)
            v = right[moves + 1] + noise * (prior[0, 1] * off_x + prior[1, 1] * off_y)
            inverse = 1.0 / (a * c - b * b)
            dx, dy = inverse * (c * u - b * v), inverse * (a * v - b * u)
            if step == STEPS or (abs(dx) < SMALL and abs(dy) < SMALL):
                break
            x -= min(max(dx, -LONGEST), LONGEST)
            y -= min(max(dy, -LONGEST), LONGEST)
            near = abs(x - positions[n, 0]) <= farthest and abs(y - positions[n, 1]) <= farthest
            if not near:
                break
        spread = total - level * level / count
        textured = spread > FLAT * count and own > FLAT * count
        ncc[n] = cross / np.sqrt(spread * own) if near and textured else -1.0
        residual[n] = max(left, 0.0) / (count - 4)
        information[n, 0, 0], information[n, 1, 1] = xx, yy
        information[n, 0, 1] = information[n, 1, 0] = xy
        positions[n, 0], positions[n, 1] = x, y

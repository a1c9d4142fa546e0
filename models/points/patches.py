"""Square patches of a grey picture: appearance of points, alignment to sub-pixel accuracy, corners.

A peak of the normalised correlation of 5x5 pixels has an error of a fifth of a pixel, since brightness and
contrast are free, and at a corner their change is much like a motion. `align_patches` allows small changes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.compiled import compiled, inlined

_f4 = np.float32

UNKNOWNS = 8  # offset, gain, rotation, scale and two stretches of a patch, and two by which it moves

ROWS = UNKNOWNS + 1
"""Of a system of equations: the unknowns', and the right side, below which sums of squares remain."""

PIECE = 25
"""Pixels of a patch over which sums are written out; larger patches are several, filled up with zeros."""

LANES = 64  # patches that are worked on side by side: in all loops over numbers they are the last axis
STEPS = 8  # Gauss-Newton steps at most

SMALL = 0.1
"""px: a step after which there is no other, which would be about a tenth of it: much less than noise does."""

FLAT = 0.02  # squared grey values: the variance of what has no texture at all
LONGEST = 0.5  # px of one coordinate in one step: gradients are valid no farther


class PlacePrior(NamedTuple):
    """Gaussian prior of the positions of n patches.

    `mean` is `(n, 2)` px, `precision` `(n, 2, 2)` 1/px^2, zero without a prior.
    """

    mean: NDArray[np.float64]
    precision: NDArray[np.float64]


class LightModel(NamedTuple):
    """Prior of changes of patches from picture to picture, and the noise; see `align_in_place`."""

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
def sample_all(grey, positions, which, patches):
    """Grey values about those positions `(n, 2)` whose numbers are in `which`, into `patches`."""
    side = patches.shape[1]
    sampler = _sampler(side)
    for first in range(0, which.size, LANES):
        lanes = min(LANES, which.size - first)
        for k in range(LANES):
            n = which[first + min(k, lanes - 1)]
            sampler.x[k], sampler.y[k] = positions[n, 0], positions[n, 1]
        _sample(grey, side, sampler)
        for k in range(lanes):
            n = which[first + k]
            for i in range(side):
                for j in range(side):
                    patches[n, i, j] = sampler.seen[i * side + j, k]


class Sampler(NamedTuple):
    """Positions `(LANES,)`, grey values `seen` there, `(side * side, LANES)`, and scratch memory."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    pixels: NDArray[np.uint8]
    along: NDArray[np.float32]
    weights: NDArray[np.float32]
    seen: NDArray[np.float32]


@compiled
def _sampler(side):
    line = side + 3
    return Sampler(
        np.empty(LANES),
        np.empty(LANES),
        np.empty((line * line, LANES), np.uint8),
        np.empty((line * side, LANES), _f4),
        np.empty((8, LANES), _f4),
        np.empty((side * side, LANES), _f4),
    )


@compiled
def _sample(grey, side, sampler):
    """Sample squares of `side` px about the positions of a sampler."""
    height, width = grey.shape
    pixels, along, weights, line = sampler.pixels, sampler.along, sampler.weights, side + 3
    for k in range(LANES):
        x, y = sampler.x[k], sampler.y[k]
        left, top = int(np.floor(x)), int(np.floor(y))
        for m in range(4):
            weights[m, k], weights[4 + m, k] = _cubic(x - left, m), _cubic(y - top, m)
        left, top = left - side // 2 - 1, top - side // 2 - 1
        if left >= 0 and top >= 0 and left + line <= width and top + line <= height:
            for i in range(line):
                for j in range(line):
                    pixels[i * line + j, k] = grey[top + i, left + j]
        else:
            for i in range(line):
                row = grey[min(max(top + i, 0), height - 1)]
                for j in range(line):
                    pixels[i * line + j, k] = row[min(max(left + j, 0), width - 1)]
    p, q, r, s = weights[0], weights[1], weights[2], weights[3]
    for n in range(line * side):
        m = n // side * line + n % side
        out, a, b, c, d = along[n], pixels[m], pixels[m + 1], pixels[m + 2], pixels[m + 3]
        for k in range(LANES):
            out[k] = p[k] * _f4(a[k]) + q[k] * _f4(b[k]) + r[k] * _f4(c[k]) + s[k] * _f4(d[k])
    p, q, r, s = weights[4], weights[5], weights[6], weights[7]
    for n in range(side * side):
        out, e, f, g, h = sampler.seen[n], along[n], along[n + side], along[n + 2 * side], along[n + 3 * side]
        for k in range(LANES):
            out[k] = p[k] * e[k] + q[k] * f[k] + r[k] * g[k] + s[k] * h[k]


@compiled
def _changes(seen, patch, mean, side, change):
    """Write the derivatives of a patch's pixels `(ROWS, side * side, LANES)`, and the residuals.

    By offset (ones, written before), gain, rotation, scale, stretch along the axes and along the diagonals,
    then motion along columns and rows; last the residuals. `seen` has one more pixel on all sides.
    """
    half, line = side // 2, side + 2
    for n in range(side * side):
        x, y = _f4(n % side - half), _f4(n // side - half)
        m = (n // side + 1) * line + n % side + 1
        gx, gy = change[6, n], change[7, n]
        _mean_less(seen[m + 1], seen[m - 1], _f4(0.5), gx)
        _mean_less(seen[m + line], seen[m - line], _f4(0.5), gy)
        _mean_less(patch[n], mean, _f4(1), change[1, n])
        _mean_less(seen[m], patch[n], _f4(1), change[8, n])
        _turned(gy, gx, x, -y, change[2, n])
        _turned(gx, gy, x, y, change[3, n])
        _turned(gx, gy, x, -y, change[4, n])
        _turned(gy, gx, x, y, change[5, n])


@compiled
def _mean_less(one, other, scale, out):
    for k in range(LANES):
        out[k] = scale * (one[k] - other[k])


@compiled
def _turned(one, other, x, y, out):
    for k in range(LANES):
        out[k] = x * one[k] + y * other[k]


@compiled
def _products(change, part, products):
    """Write sums over patches of products of these rows: upper triangles `(ROWS, ROWS, LANES)`."""
    for piece in range(change.shape[1]):
        for k in range(ROWS):
            for m in range(k, ROWS):
                one, other, out = change[k, piece], change[m, piece], products[k, m]
                for lane in range(LANES):
                    total = _f4(0)
                    for n in range(PIECE):
                        total += one[n, lane] * other[n, lane]
                    part[lane] = total
                for lane in range(LANES):
                    out[lane] = part[lane] if piece == 0 else out[lane] + part[lane]


@compiled
def _eliminate(normal, first, last):
    """Eliminate unknowns `first` to before `last` of symmetric systems `(ROWS, ROWS, LANES)`.

    Only upper triangles are read and written. The lower right is then the Schur complement: the system of the
    other unknowns, and their sums of squares.
    """
    share = np.empty(LANES)
    for k in range(first, last):
        for i in range(k + 1, ROWS):
            one, other = normal[k, i], normal[k, k]
            for lane in range(LANES):
                share[lane] = one[lane] / other[lane]
            for j in range(i, ROWS):
                here, above = normal[i, j], normal[k, j]
                for lane in range(LANES):
                    here[lane] -= share[lane] * above[lane]


@compiled
def align_in_place(grey, patches, which, positions, expected, light, search_radius, covariance, ncc):
    """Align those `positions` `(m, 2)` whose numbers are in `which` with a patch.

    Of `patches` `(n, side, side)` each has as many positions, one after the other. Picture = patch + offset +
    gain (patch - its mean) + its change by a small linear map + noise; offset, gain and map have inverse
    variances `light.precisions`, `(6,)`, in units of the noise's, whose variance is `light.smoothed` times
    that of the residuals, plus `light.rounding`. Patches have the prior `expected`.

    Written: `covariance` `(m, 2, 2)` px^2 by the picture alone, with offset, gain and map integrated out; and
    the normalised correlation, -1 where the way leads farther than `search_radius` px or picture or patch are
    flat.
    """
    side, each = patches.shape[1], positions.shape[0] // max(patches.shape[0], 1)
    sampler = _sampler(side + 2)
    patch, mean, part = np.empty((side * side, LANES), _f4), np.empty(LANES, _f4), np.empty(LANES, _f4)
    change = np.zeros((ROWS, -(-side * side // PIECE), PIECE, LANES), _f4)
    lines = change.reshape(ROWS, -1, LANES)
    lines[0, : side * side] = 1
    products, normal = np.empty((ROWS, ROWS, LANES), _f4), np.empty((ROWS, ROWS, LANES))
    start, todo = positions.copy(), which.copy()
    moving = todo.size
    for _ in range(STEPS):
        first = still = 0
        while first < moving:
            lanes = min(LANES, moving - first)
            _take(todo[first : first + lanes], patches, each, positions, patch, mean, sampler)
            _sample(grey, side + 2, sampler)
            _changes(sampler.seen, patch, mean, side, lines)
            _products(change, part, products)
            _without_light(products, light, normal)
            for lane in range(lanes):
                n = todo[first + lane]
                k, x, y = n // each, positions[n, 0], positions[n, 1]
                off_x, off_y = x - expected.mean[k, 0], y - expected.mean[k, 1]
                a, b, c = (
                    expected.precision[k, 0, 0],
                    expected.precision[k, 0, 1],
                    expected.precision[k, 1, 1],
                )
                dx, dy, xx, xy, yy = _step(normal, lane, side, (off_x, off_y, a, b, c), light)
                x -= min(max(dx, -LONGEST), LONGEST)
                y -= min(max(dy, -LONGEST), LONGEST)
                positions[n, 0], positions[n, 1] = x, y
                covariance[n, 0, 0], covariance[n, 1, 1] = xx, yy
                covariance[n, 0, 1] = covariance[n, 1, 0] = xy
                near = abs(x - start[n, 0]) <= search_radius and abs(y - start[n, 1]) <= search_radius
                ncc[n] = _correlation(products, lane, side) if near else -1.0
                if near and max(abs(dx), abs(dy)) >= SMALL:
                    todo[still] = n
                    still += 1
            first += lanes
        moving = still


@compiled
def _take(which, patches, each, positions, patch, mean, sampler):
    """Copy patches, their means, and positions to lanes; the last one to unused lanes."""
    side = patches.shape[1]
    for lane in range(LANES):
        n = which[min(lane, which.size - 1)]
        sampler.x[lane], sampler.y[lane] = positions[n, 0], positions[n, 1]
        total = _f4(0)
        for i in range(side):
            for j in range(side):
                patch[i * side + j, lane] = patches[n // each, i, j]
                total += patches[n // each, i, j]
        mean[lane] = total / _f4(side * side)


@compiled
def _without_light(products, light, normal):
    """Write the equations of the motion, with offset, gain and linear map eliminated."""
    moves = UNKNOWNS - 2
    for k in range(ROWS):
        for m in range(k, ROWS):
            one, out = products[k, m], normal[k, m]
            for lane in range(LANES):
                out[lane] = one[lane]
    for k in range(moves):
        precision, out = light.precisions[k], normal[k, k]
        for lane in range(LANES):
            out[lane] += precision
    one, other = normal[moves, moves], normal[moves + 1, moves + 1]
    for lane in range(LANES):
        least = 1e-6 * (one[lane] + other[lane]) + 1e-12
        one[lane] += least
        other[lane] += least
    _eliminate(normal, 0, moves)


@compiled
def _step(normal, lane, side, prior, light):
    """Return the step along both axes, and the covariance of the position by the picture."""
    k, m, end = UNKNOWNS - 2, UNKNOWNS - 1, UNKNOWNS
    off_x, off_y, px, pxy, py = prior
    xx, xy, yy = normal[k, k, lane], normal[k, m, lane], normal[m, m, lane]
    noise = light.smoothed * max(normal[end, end, lane], 0.0) / (side * side - 4) + light.rounding
    a, b, c = xx + noise * px, xy + noise * pxy, yy + noise * py
    u = normal[k, end, lane] + noise * (px * off_x + pxy * off_y)
    v = normal[m, end, lane] + noise * (pxy * off_x + py * off_y)
    inverse = 1.0 / (a * c - b * b)
    scale = noise / max(xx * yy - xy * xy, 1e-9 * (xx + yy) ** 2)  # rounding may take what an edge has left
    return inverse * (c * u - b * v), inverse * (a * v - b * u), scale * yy, -scale * xy, scale * xx


@compiled
def _correlation(products, lane, side):
    """Return the correlation of patch and picture, from sums of products; -1 if one is flat."""
    count = side * side
    off, bright = UNKNOWNS, products[0, UNKNOWNS, lane]
    own, cross = products[1, 1, lane], products[1, off, lane]
    spread = products[off, off, lane] + 2.0 * cross + own - bright * bright / count
    if spread <= FLAT * count or own <= FLAT * count:
        return -1.0
    return (cross + own) / np.sqrt(spread * own)


Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class Patches:
    """Appearance of points: `identities` `(n,)` int64, increasing; `pixels` `(n, side, side)` grey values."""

    identities: NDArray[np.int64]
    pixels: Pixels

    def __len__(self) -> int:
        return len(self.identities)


def ncc(one: Pixels, other: Pixels) -> Array:
    """Return the normalised correlation of patches `(n, side, side)`, `(n,)`; 0 if one is uniform."""
    a, b = _centred(one), _centred(other)
    lengths = np.sqrt(np.square(a).sum(axis=(1, 2)) * np.square(b).sum(axis=(1, 2)))
    correlation: Array = (a * b).sum(axis=(1, 2)) / np.where(lengths > 0, lengths, 1.0)
    return correlation


def match_light(patches: Pixels, others: Pixels) -> Pixels:
    """Return patches `(n, side, side)` with the brightness and contrast of `others`."""
    a, b = _centred(patches), _centred(others)
    squares = np.square(a).sum(axis=(1, 2), keepdims=True)
    gain = (a * b).sum(axis=(1, 2), keepdims=True) / np.where(squares > 0, squares, 1.0)
    level = others.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    lit: Pixels = (level + np.maximum(gain, 0.0) * a).astype(np.float32)
    return lit


def _centred(patches: Pixels) -> Array:
    centred: Array = np.subtract(patches, patches.mean(axis=(1, 2), keepdims=True, dtype=np.float64))
    return centred


PIXEL_NOISE = 2.0  # grey values, standard deviation of the noise of a pixel

LIGHTER, STRONGER, WARPED = 3.0, 0.07, 0.05
"""Standard deviations of the change of a patch between two pictures: brightness in grey values, contrast as a
share, and rotation in rad, scale and stretch as shares. Without the last ones a patch that turns away slides
along its edges."""

SMOOTHED = 1.5  # variance of residuals over that with one of the pictures interpolated
ROUNDING = 0.5  # squared grey values: rounding error of residuals

LIGHT_MODEL = LightModel(
    (PIXEL_NOISE / np.array([LIGHTER, STRONGER, *[WARPED] * 4])) ** 2, SMOOTHED, ROUNDING
)
"""These values as the compiled loops take them."""


class Aligned(NamedTuple):
    """Aligned patches."""

    position: Array  # (n, 2) px
    covariance: Array  # (n, 2, 2) px^2: of the position, for noise as large as the residuals
    ncc: Array  # (n,) normalised correlation there, -1 if no near position fits


def align_patches(
    grey: NDArray[np.uint8],
    patches: NDArray[np.float32],
    start: Array,
    search_radius: float,
    expected: PlacePrior | None = None,
) -> Aligned:
    """Align patches `(n, side, side)` with a picture by Gauss-Newton steps (Lucas and Kanade).

    They start at `start` `(n, 2)` px, within a pixel of the true position, and move by at most
    `search_radius` px along either axis. The prior `expected` holds patches that would slide along an edge;
    the covariances do not include it.
    """
    position = np.array(start, np.float64)
    expected = expected or PlacePrior(position.copy(), np.zeros((len(position), 2, 2)))
    covariance, ncc = np.empty((len(position), 2, 2)), np.empty(len(position))
    which = np.arange(len(position))
    align_in_place(grey, patches, which, position, expected, LIGHT_MODEL, search_radius, covariance, ncc)
    return Aligned(position, covariance, ncc)


def sample_patches(grey: NDArray[np.uint8], positions: Array, side: int) -> NDArray[np.float32]:
    """Return grey values `(n, side, side)` about `positions` `(n, 2)` px, by cubic interpolation."""
    patches = np.empty((len(positions), side, side), np.float32)
    places = np.ascontiguousarray(positions, np.float64)
    sample_all(grey, places, np.arange(len(places)), patches)
    return patches


QUALITY = 0.01  # least smaller eigenvalue of the gradients' moments, as a share of the best corner's
CLEAR = 0.25  # px: largest standard deviation of a corner's position under usual pixel noise
NOISE = 4.0  # usual pixel noise over the residual of a patch compared with itself: a safe guess
BORDER = 6  # px: no corner is nearer to the picture's edge


def find_corners(grey: NDArray[np.uint8], most: int, away_from: Array, spacing: float, side: int) -> Array:
    """Return at most `most` corners `(m, 2)` px of a picture, the best first.

    They are at least `spacing` px from each other and from `away_from` `(n, 2)`, and patches of `side` px
    determine their positions to `CLEAR`.
    """
    mask = np.zeros(grey.shape, np.uint8)
    mask[BORDER:-BORDER, BORDER:-BORDER] = 255
    for x, y in np.rint(away_from).astype(int).tolist():
        cv2.circle(mask, (x, y), int(spacing), 0, -1)
    found = cv2.goodFeaturesToTrack(grey, most, QUALITY, spacing, mask=mask, blockSize=side)
    if found is None:
        return np.zeros((0, 2))
    corners = found.reshape(-1, 2).astype(np.float64)
    itself = align_patches(grey, sample_patches(grey, corners, side), corners, 1.0)
    deviation = NOISE * np.sqrt(np.linalg.eigvalsh(itself.covariance)[:, 1])
    clear: Array = corners[deviation < CLEAR]
    return clear

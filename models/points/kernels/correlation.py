"""Normalised correlation of many small patches, each in a window of its own."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled

Numbers = NDArray[np.float64]

_f4 = np.float32

USUAL = 5
"""px, side of patches for which loops are written out."""


class Windows(NamedTuple):
    """Where n patches are searched for.

    Parameters
    ----------
    mean
        `(n, 2)` px.
    covariance
        `(n, 2, 2)` px^2 about it.
    prior
        whether that says more than how large windows are.
    reach, farthest
        standard deviations, and px along either axis, beyond which nothing is searched.
    """

    mean: Numbers
    covariance: Numbers
    prior: bool
    reach: float
    farthest: float


class Candidates(NamedTuple):
    """The two likeliest places of each of n patches, the likelier first.

    Parameters
    ----------
    position
        `(n, 2, 2)` px: patch, place, x and y, by parabolas through the correlation about the best pixel.
    ncc
        `(n, 2)` normalised correlation at that pixel; -1 where there is no such place.
    weight
        `(n, 2)` log of likelihood and prior, up to a constant; -inf where there is no such place.
    """

    position: Numbers
    ncc: Numbers
    weight: Numbers


@compiled
def _weighted_rows(image, a, b, c, d, e, out):
    """Add to `out` weighted sums of five pixels of `image` in a row."""
    for i in range(out.size):
        out[i] += a * image[i] + b * image[i + 1] + c * image[i + 2] + d * image[i + 3] + e * image[i + 4]


@compiled
def _box_sums(image, width, side, rows, out):
    """Sums of `image` over squares, each at its upper left pixel; `rows` is room for those of its lines."""
    count = out.size
    if side == USUAL:
        for i in range(rows.size):
            rows[i] = image[i] + image[i + 1] + image[i + 2] + image[i + 3] + image[i + 4]
        a, b, c = rows[:count], rows[width : width + count], rows[2 * width : 2 * width + count]
        d, e = rows[3 * width : 3 * width + count], rows[4 * width : 4 * width + count]
        for i in range(count):
            out[i] = a[i] + b[i] + c[i] + d[i] + e[i]
        return
    rows[:], out[:] = 0, 0
    for x in range(side):
        shifted = image[x : x + rows.size]
        for i in range(rows.size):
            rows[i] += shifted[i]
    for y in range(side):
        below = rows[y * width : y * width + count]
        for i in range(count):
            out[i] += below[i]


@compiled
def correlate(image, left, top, columns, rows, template, side, lines, score):
    """Correlation of a template of mean 0 and length 1 with all patches of a window.

    The window holds `rows` x `columns` patches, the first of which begins at (top, left). `lines` is room for
    five pictures of the window and `side` px more, `score` for the result, both as long as they may have to
    be. The result has the window's width: what is at a line's end means nothing.
    """
    width = columns + side - 1
    height = rows + side - 1
    size = width * height
    whole = 0
    for y in range(height):
        row = image[top + y, left : left + width]
        for x in range(width):
            whole += np.int32(row[x])
    mean = _f4(whole) / _f4(size)  # the squares of small numbers are summed exactly enough
    pixels, squares = lines[0, : size + side], lines[1, : size + side]
    for y in range(height):
        row, here = image[top + y, left : left + width], pixels[y * width : (y + 1) * width]
        for x in range(width):
            here[x] = _f4(row[x]) - mean
    for i in range(size, size + side):
        pixels[i] = _f4(0)
    for i in range(size + side):
        squares[i] = pixels[i] * pixels[i]
    count = (rows - 1) * width + columns
    scores, sums, total, energy = score[:count], lines[2], lines[3, :count], lines[4, :count]
    for i in range(count):
        scores[i] = _f4(0)
    for y in range(side):
        weights, below = template[y * side : (y + 1) * side], pixels[y * width : y * width + count + side]
        if side == USUAL:
            _weighted_rows(below, weights[0], weights[1], weights[2], weights[3], weights[4], scores)
        else:
            for x in range(side):
                weight, shifted = weights[x], below[x : x + count]
                for i in range(count):
                    scores[i] += weight * shifted[i]
    sums = sums[: count + (side - 1) * width]
    _box_sums(pixels, width, side, sums, total)
    _box_sums(squares, width, side, sums, energy)
    share = _f4(1 / (side * side))
    least = _f4(0.25 * side * side)
    for i in range(count):
        scores[i] *= _f4(1) / np.sqrt(max(energy[i] - share * total[i] * total[i], least))


@compiled
def best_places(image, windows, patches, sharpness, floor, least, candidates):
    """Fill in the two likeliest places of each patch `(n, side, side)`.

    A place's weight is `sharpness` times -log(1 - correlation^2 + floor), plus the log prior. Only places are
    taken of a correlation of `least` or more, and that no neighbour is more like the patch than.
    """
    mean, covariance, prior, reach, farthest = windows
    places, nccs, weights = candidates
    height, width = image.shape
    side = patches.shape[1]
    half = side // 2
    radii = np.empty(mean.shape[0], np.int64)
    most = 0
    for k in range(radii.size):
        deviation = np.sqrt(max(covariance[k, 0, 0], covariance[k, 1, 1]))
        radii[k] = np.int64(min(np.ceil(reach * deviation + 0.5), farthest))
        most = max(most, 2 * radii[k] + 3 + side)
    lines = np.empty((5, most * most + side), _f4)
    score = np.empty(most * most, _f4)
    template = np.empty(side * side, _f4)
    for k in range(radii.size):
        radius = radii[k]
        x0, y0 = int(np.rint(mean[k, 0])), int(np.rint(mean[k, 1]))
        # one more on all sides, to see where correlation falls off
        left = max(x0 - radius - 1 - half, 0)
        top = max(y0 - radius - 1 - half, 0)
        columns = min(x0 + radius + 1 + half, width - 1) - left + 2 - side
        rows = min(y0 + radius + 1 + half, height - 1) - top + 2 - side
        if columns < 3 or rows < 3:
            continue
        _normalise(patches[k], template)
        correlate(image, left, top, columns, rows, template, side, lines, score)
        line = columns + side - 1
        best = second = -1e30
        xx = xy = yy = 0.0
        if prior:
            a, b, c = covariance[k, 0, 0], covariance[k, 0, 1], covariance[k, 1, 1]
            scale = 1 / (a * c - b * b)
            xx, xy, yy = scale * c, -2 * scale * b, scale * a
        peaks = lines[0]
        _keep_peaks(score, line, (rows - 1) * line + columns, lines[1], peaks)
        for y in range(1, rows - 1):
            here = peaks[y * line : y * line + columns]
            if _largest(here[1 : columns - 1]) < least:
                continue
            dy = top + half + y - mean[k, 1]
            for x in range(1, columns - 1):
                if here[x] < least:
                    continue
                dx = left + half + x - mean[k, 0]
                square = xx * dx * dx + xy * dx * dy + yy * dy * dy
                i = y * line + x
                if square > reach * reach:
                    continue
                right, more_x = _parabola(score[i - 1], score[i], score[i + 1])
                down, more_y = _parabola(score[i - line], score[i], score[i + line])
                peak = min(here[x] + more_x + more_y, _f4(1))
                weight = -sharpness * np.log(1.0 - peak * peak + floor) - 0.5 * square
                if weight > best:
                    second = best
                    places[k, 1], nccs[k, 1], weights[k, 1] = places[k, 0], nccs[k, 0], weights[k, 0]
                    place = 0
                elif weight > second:
                    place = 1
                else:
                    continue
                if place:
                    second = weight
                else:
                    best = weight
                places[k, place, 0], places[k, place, 1] = left + half + x + right, top + half + y + down
                nccs[k, place], weights[k, place] = here[x], weight


@compiled
def _normalise(patch, template):
    """A patch with mean 0 and length 1, row after row."""
    side = patch.shape[0]
    total = squares = _f4(0)
    for y in range(side):
        for x in range(side):
            total += patch[y, x]
    mean = total / _f4(side * side)
    for y in range(side):
        for x in range(side):
            template[y * side + x] = patch[y, x] - mean
            squares += template[y * side + x] * template[y * side + x]
    scale = _f4(1) / max(np.sqrt(squares), _f4(1e-6))
    for i in range(template.size):
        template[i] *= scale


@compiled
def _largest(values):
    most = values[0]
    for i in range(1, values.size):
        most = max(most, values[i])
    return most


@compiled
def _parabola(before, here, after):
    """Where a parabola through three values has its peak, from the middle one, and how much higher it is."""
    bent = before - _f4(2) * here + after
    if bent >= _f4(-1e-6):
        return _f4(0), _f4(0)
    off = _f4(0.5) * (before - after) / bent
    return off, _f4(-0.25) * (before - after) * off


@compiled
def _keep_peaks(score, line, count, room, peaks):
    """Of places that have eight neighbours the score, or -1 where one of them has a larger one."""
    across = room[:count]
    for i in range(1, count - 1):
        across[i] = max(score[i], max(score[i - 1], score[i + 1]))
    above, here, below = across[: count - 2 * line], across[line : count - line], across[2 * line :]
    middle, out = score[line : count - line], peaks[line : count - line]
    for i in range(1, out.size - 1):
        most = max(here[i], max(above[i], below[i]))
        out[i] = middle[i] if middle[i] >= most else _f4(-1)

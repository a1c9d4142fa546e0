"""Normalised correlation of many small patches, each in a window of its own."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, logarithm

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

_f4 = np.float32

_at = np.uint64  # a number that is no index from the end, which loops would have to ask of each

PIXELS, SCORE, SQUARES, ACROSS, TOTAL, ENERGY = range(6)
"""Rows of the room for a window."""

USUAL = 5
"""px, side of patches for which loops are written out."""

REGISTER = 16
"""Numbers of a vector register: of multiples of it none are left over, which would go one by one."""

SHARPNESS, NCC_NOISE = 3.5, 0.02
"""How -log(1 - correlation^2) grows into a log likelihood, and the noise that limits it."""

LEAST_NCC = 0.5
"""Normalised correlation from which on anything counts as like a patch."""

LEAST_WEIGHT = -1e30
"""Log weight of where a patch cannot be."""


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
        `(n, 2)` log of likelihood and prior, up to a constant; `LEAST_WEIGHT` where there is no such place.
    """

    position: Numbers
    ncc: Numbers
    weight: Numbers


@compiled
def best_places(image, windows, patches, which, found):
    """Fill in the two likeliest places of those patches of `(n, side, side)` whose numbers are in `which`.

    A place's weight is `SHARPNESS` times -log(1 - correlation^2 + `NCC_NOISE`), plus the log prior. Only
    places are taken of a correlation of `LEAST_NCC` or more, and that no neighbour is more like the patch
    than; where there are none, what is `found` stays as it is.
    """
    mean, covariance, prior, reach, farthest = windows
    height, width = image.shape
    side = patches.shape[1]
    half = side // 2
    radii = np.empty(which.size, np.int64)
    most = 0
    for m in range(which.size):
        k = which[m]
        deviation = np.sqrt(max(covariance[k, 0, 0], covariance[k, 1, 1]))
        radii[m] = np.int64(min(np.ceil(reach * deviation + 0.5), farthest))
        most = max(most, radii[m])
    line = 2 * most + 2 + side + REGISTER
    rooms = np.zeros((6, line * line), _f4)
    flags = np.zeros(-(-line * line // 8) * 8, np.uint8)
    eight = flags.view(np.uint64)
    template, places, weights = np.empty(side * side, _f4), np.empty((2, 3)), np.empty(2)
    for m in range(which.size):
        k, radius = which[m], radii[m]
        x0, y0 = int(np.rint(mean[k, 0])), int(np.rint(mean[k, 1]))
        # one more on all sides, to see where correlation falls off
        left, top = max(x0 - radius - 1 - half, 0), max(y0 - radius - 1 - half, 0)
        columns = min(x0 + radius + 1 + half, width - 1) - left + 2 - side
        rows = min(y0 + radius + 1 + half, height - 1) - top + 2 - side
        if columns < 3 or rows < 3:
            continue
        line = columns + side - 1
        count = -(-rows * line // REGISTER) * REGISTER
        _normalise(patches, k, template)
        _lift(image, left, top, rows + side - 1, line, rooms)
        correlate(rooms, line, count, template, side)
        _flag_peaks(rooms, line, count, flags)
        a, b, c = covariance[k, 0, 0], covariance[k, 0, 1], covariance[k, 1, 1]
        scale = (1.0 if prior else 0.0) / (a * c - b * b)
        known = scale * c, -2 * scale * b, scale * a, reach * reach
        offset = left + half - mean[k, 0], top + half - mean[k, 1]
        _keep_two(rooms[SCORE], line, rows, columns, offset, known, flags, eight, places, weights)
        for place in range(2):
            if weights[place] > LEAST_WEIGHT:
                found.position[k, place, 0] = mean[k, 0] + places[place, 0]
                found.position[k, place, 1] = mean[k, 1] + places[place, 1]
                found.ncc[k, place], found.weight[k, place] = places[place, 2], weights[place]


@compiled
def _lift(image, left, top, rows, line, rooms):
    """A window's pixels, less one of them: squares of small numbers are summed exactly enough.

    A line that is filled up to whole registers runs into the next one, which then comes over it.
    """
    level = _f4(image[top + rows // 2, left + line // 2])
    filled = min(-(-line // REGISTER) * REGISTER, image.shape[1] - left)
    for y in range(rows):
        for x in range(filled):
            rooms[PIXELS, _at(y * line + x)] = _f4(image[_at(top + y), _at(left + x)]) - level


@compiled
def correlate(rooms, line, count, template, side):
    """Correlation of a template of mean 0 and length 1 with all patches of a window.

    `rooms`, `(6, enough)`, has the window's `PIXELS`, `line` in a line, and gets the `SCORE` of the first
    `count` places; what is at a line's end means nothing. The others are room for sums.
    """
    for i in range(count + side * line):
        pixel = rooms[PIXELS, _at(i)]
        rooms[SQUARES, _at(i)] = pixel * pixel
    if side == USUAL:
        for i in range(count):
            upper = _five(rooms, i, template, 0) + _five(rooms, i + line, template, 5)
            lower = _five(rooms, i + 3 * line, template, 15) + _five(rooms, i + 4 * line, template, 20)
            rooms[SCORE, _at(i)] = upper + _five(rooms, i + 2 * line, template, 10) + lower
    else:
        rooms[SCORE, :count] = 0
        for y in range(side):
            for x in range(side):
                weight = template[y * side + x]
                for i in range(count):
                    rooms[SCORE, _at(i)] += weight * rooms[PIXELS, _at(i + y * line + x)]
    _box_sums(rooms, PIXELS, line, side, count, TOTAL)
    _box_sums(rooms, SQUARES, line, side, count, ENERGY)
    share, least = _f4(1 / (side * side)), _f4(0.25 * side * side)
    for i in range(count):
        total = rooms[TOTAL, _at(i)]
        rooms[SCORE, _at(i)] /= np.sqrt(max(rooms[ENERGY, _at(i)] - share * total * total, least))


@compiled
def _five(rooms, i, weights, k):
    a, b, c = rooms[PIXELS, _at(i)], rooms[PIXELS, _at(i + 1)], rooms[PIXELS, _at(i + 2)]
    d, e = rooms[PIXELS, _at(i + 3)], rooms[PIXELS, _at(i + 4)]
    return weights[k] * a + weights[k + 1] * b + weights[k + 2] * c + weights[k + 3] * d + weights[k + 4] * e


@compiled
def _box_sums(rooms, what, line, side, count, out):
    """Sums over squares, each at its upper left pixel."""
    size = count + (side - 1) * line
    if side == USUAL:
        for i in range(size):
            left = rooms[what, _at(i)] + rooms[what, _at(i + 1)] + rooms[what, _at(i + 2)]
            rooms[ACROSS, _at(i)] = left + rooms[what, _at(i + 3)] + rooms[what, _at(i + 4)]
        for i in range(count):
            upper = rooms[ACROSS, _at(i)] + rooms[ACROSS, _at(i + line)] + rooms[ACROSS, _at(i + 2 * line)]
            rooms[out, _at(i)] = upper + rooms[ACROSS, _at(i + 3 * line)] + rooms[ACROSS, _at(i + 4 * line)]
        return
    rooms[ACROSS, :size], rooms[out, :count] = 0, 0
    for x in range(side):
        for i in range(size):
            rooms[ACROSS, _at(i)] += rooms[what, _at(i + x)]
    for y in range(side):
        for i in range(count):
            rooms[out, _at(i)] += rooms[ACROSS, _at(i + y * line)]


@compiled
def _flag_peaks(rooms, line, count, flags):
    """Whether a place is like the patch, and none of its eight neighbours more so; not at the edge."""
    for i in range(count):
        here, after, further = rooms[SCORE, _at(i)], rooms[SCORE, _at(i + 1)], rooms[SCORE, _at(i + 2)]
        rooms[ACROSS, _at(i)] = max(after, max(here, further))
    # of three in a row the middle one is where the peak may be
    for i in range(count):
        above, here, below = (
            rooms[ACROSS, _at(i)],
            rooms[ACROSS, _at(i + line)],
            rooms[ACROSS, _at(i + 2 * line)],
        )
        middle = rooms[SCORE, _at(i + line + 1)]
        flags[_at(i + line + 1)] = middle >= max(here, max(above, below)) and middle >= LEAST_NCC


@compiled
def _keep_two(score, line, rows, columns, offset, prior, flags, eight, places, weights):
    """Fill in the two likeliest of the flagged peaks: x, y and correlation `(2, 3)`, and weights `(2,)`.

    `offset` is where the first place is from where the patch should be, `prior` the precision of that, xx,
    twice xy and yy, and the square beyond which nothing is searched; `eight` the flags, eight in a number.
    """
    left, top = offset
    xx, xy, yy, most = prior
    weights[0] = weights[1] = LEAST_WEIGHT
    for word in range(line // 8, (rows - 1) * line // 8 + 1):
        if eight[word] == 0:
            continue
        for i in range(8 * word, 8 * word + 8):
            y = i // line
            x = i - y * line
            if flags[i] == 0 or not (0 < x < columns - 1 and 0 < y < rows - 1):
                continue
            dx, dy = left + x, top + y
            square = xx * dx * dx + xy * dx * dy + yy * dy * dy
            if square > most:
                continue
            right, more_x = _parabola(score[i - 1], score[i], score[i + 1])
            down, more_y = _parabola(score[i - line], score[i], score[i + line])
            peak = min(score[i] + more_x + more_y, _f4(1))
            weight = -SHARPNESS * logarithm(_f4(1 + NCC_NOISE) - peak * peak) - 0.5 * square
            if weight <= weights[1]:
                continue
            place = 1
            if weight > weights[0]:
                place = 0
                weights[1] = weights[0]
                for m in range(3):
                    places[1, m] = places[0, m]
            weights[place] = weight
            places[place, 0], places[place, 1], places[place, 2] = dx + right, dy + down, score[i]


@compiled
def _normalise(patches, k, template):
    """The k-th patch with mean 0 and length 1, row after row."""
    side = patches.shape[1]
    total = squares = _f4(0)
    for y in range(side):
        for x in range(side):
            total += patches[k, y, x]
    mean = total / _f4(side * side)
    for y in range(side):
        for x in range(side):
            template[y * side + x] = patches[k, y, x] - mean
            squares += template[y * side + x] * template[y * side + x]
    scale = _f4(1) / max(np.sqrt(squares), _f4(1e-6))
    for i in range(template.size):
        template[i] *= scale


@compiled
def _parabola(before, here, after):
    """Where a parabola through three values has its peak, from the middle one, and how much higher it is."""
    bent = before - _f4(2) * here + after
    if bent >= _f4(-1e-6):
        return _f4(0), _f4(0)
    off = _f4(0.5) * (before - after) / bent
    return off, _f4(-0.25) * (before - after) * off

"""Normalised correlation of many small patches, each in a window of its own."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled

Numbers = NDArray[np.float64]

_f4 = np.float32


class Windows(NamedTuple):
    """Where n patches are searched for.

    Parameters
    ----------
    mean
        `(n, 2)` px.
    precision
        `(n, 2, 2)` 1/px^2 of the prior about it; zeros for none.
    radius
        `(n,)` int64 px from the mean, along either axis.
    """

    mean: Numbers
    precision: Numbers
    radius: NDArray[np.int64]


class Candidates(NamedTuple):
    """The two likeliest places of each of n patches, the likelier first.

    Parameters
    ----------
    position
        `(n, 2, 2)` whole px: patch, place, column and row.
    ncc
        `(n, 2)` normalised correlation; -1 where there is no such place.
    area
        `(n,)` px^2 that were searched.
    """

    position: Numbers
    ncc: Numbers
    area: Numbers


@compiled
def correlate(image, left, top, columns, rows, template, side, lines, score):
    """Correlation of a template of mean 0 and length 1 with all patches of a window.

    The window holds `rows` x `columns` patches, the first of which begins at (top, left). `lines` is room for
    three pictures of the window, `score` for the result, both as long as they may have to be.
    """
    width = columns + side - 1
    height = rows + side - 1
    pixels, total, energy = lines[0], lines[1], lines[2]
    mean = _f4(0)
    for y in range(height):
        row = image[top + y, left : left + width]
        here = pixels[y * width : (y + 1) * width]
        for x in range(width):
            here[x] = _f4(row[x])
            mean += here[x]
    mean /= _f4(width * height)
    for i in range(width * height):  # the squares of small numbers are summed exactly enough
        pixels[i] -= mean
    count = (rows - 1) * width + columns
    for i in range(count):
        score[i] = _f4(0)
        total[i] = _f4(0)
        energy[i] = _f4(0)
    for y in range(side):
        for x in range(side):
            weight = template[y * side + x]
            shifted = pixels[y * width + x : y * width + x + count]
            for i in range(count):
                value = shifted[i]
                score[i] += weight * value
                total[i] += value
                energy[i] += value * value
    share = _f4(1 / (side * side))
    least = _f4(0.25 * side * side)
    for i in range(count):
        score[i] *= _f4(1) / np.sqrt(max(energy[i] - share * total[i] * total[i], least))


@compiled
def best_places(image, windows, templates, side, reach, sharpness, floor, candidates):
    """Fill in the two likeliest places of each patch, and how many were searched.

    A place's weight is `sharpness` times -log(1 - correlation^2 + floor), plus the log prior. Searched is
    what is within `reach` standard deviations of the mean, and in the window. Only places are taken that no
    neighbour is more like the patch than.
    """
    mean, precision, radius = windows
    places, nccs, areas = candidates
    height, width = image.shape
    half = side // 2
    most = 0
    for k in range(radius.size):
        most = max(most, 2 * radius[k] + 3 + side)
    lines = np.empty((3, most * most), _f4)
    score = np.empty(most * most, _f4)
    for k in range(radius.size):
        x0, y0 = int(np.rint(mean[k, 0])), int(np.rint(mean[k, 1]))
        # one more on all sides, to see where correlation falls off
        left = max(x0 - radius[k] - 1 - half, 0)
        top = max(y0 - radius[k] - 1 - half, 0)
        columns = min(x0 + radius[k] + 1 + half, width - 1) - left + 2 - side
        rows = min(y0 + radius[k] + 1 + half, height - 1) - top + 2 - side
        if columns < 3 or rows < 3:
            continue
        correlate(image, left, top, columns, rows, templates[k], side, lines, score)
        line = columns + side - 1
        best = second = -1e30
        for y in range(1, rows - 1):
            dy = top + half + y - mean[k, 1]
            for x in range(1, columns - 1):
                dx = left + half + x - mean[k, 0]
                square = precision[k, 0, 0] * dx * dx + precision[k, 1, 1] * dy * dy
                square += 2 * precision[k, 0, 1] * dx * dy
                if square > reach * reach:
                    continue
                areas[k] += 1
                i = y * line + x
                here = score[i]
                if here <= _f4(0):
                    continue
                around = max(max(score[i - 1], score[i + 1]), max(score[i - line], score[i + line]))
                above = max(score[i - line - 1], score[i - line + 1])
                below = max(score[i + line - 1], score[i + line + 1])
                if here < max(around, max(above, below)):
                    continue
                weight = -sharpness * np.log(1.0 - min(here * here, 1.0) + floor) - 0.5 * square
                if weight > best:
                    second, best = best, weight
                    places[k, 1] = places[k, 0]
                    nccs[k, 1] = nccs[k, 0]
                    places[k, 0, 0], places[k, 0, 1] = left + half + x, top + half + y
                    nccs[k, 0] = here
                elif weight > second:
                    second = weight
                    places[k, 1, 0], places[k, 1, 1] = left + half + x, top + half + y
                    nccs[k, 1] = here

"""Whether the outline of a mask is an edge of the image, or of the background's picture.

Of a blob two things may be true: something real stands there, or it is a ghost (see
`chains.objects.ghosts`, which has the formulas).
"""

import numpy as np

from ....models.numerics.compiled import compiled, put

_f4 = np.float32

REACH = 2
"""px to either side of an outline, which is as exact as that."""

LEAST_OUTLINE = 8
"""px of an outline, from which on it tells something."""

_TOGETHER = 8  # ratios of contrasts that are multiplied before their logarithm is taken


@compiled
def _mark_outline(mask, row, first, end, flags):
    """Mark the pixels of a row that are likelier than not the object's, beside one that is not."""
    here, above, below = mask[row, first:end], mask[row - 1, first:end], mask[row + 1, first:end]
    before, after, marked = mask[row, first - 1 : end - 1], mask[row, first + 1 : end + 1], flags[first:end]
    for x in range(here.size):
        least = min(min(above[x], below[x]), min(before[x], after[x]))
        marked[x] = np.uint8((here[x] > _f4(0.5)) & (least <= _f4(0.5)))


@compiled
def outline_contrasts(planes, top, left, other, free, mask, within, reach, out):
    """Contrasts about a mask's outline, across it and right outside, in two pictures.

    They compare colours `reach` px inside of every step of the outline (right inside, where the mask is
    thinner) and as far outside, and the latter with one twice as far again. Steps whose three places are not
    all free are left out. The first picture `(channels, height, width)` is cut out where the mask is, which
    lies at `(top, left)` of the `other` one; `within` are the top, left, bottom and right of the mask's part
    that may be likely.

    Returns
    -------
    count
        of the columns of `out` `(4, n)` that were filled, grey levels: across and outside in the first
        picture, and in the other.
    """
    channels, rows, columns = planes.shape
    count = 0
    first, end = max(within[1], reach), min(within[3], columns - reach)
    flags = np.zeros(columns, np.uint8)
    for y in range(max(within[0], reach), min(within[2], rows - reach)):
        _mark_outline(mask, y, first, end, flags)
        for x in range(first, end):
            if not flags[x]:
                continue
            for direction in range(4):
                down = (1, -1, 0, 0)[direction]
                right = (0, 0, 1, -1)[direction]
                if mask[y + down, x + right] > _f4(0.5):
                    continue
                y1, x1 = y - reach * down, x - reach * right
                if mask[y1, x1] <= _f4(0.5):
                    y1, x1 = y, x
                y2, x2 = y + reach * down, x + reach * right
                y3, x3 = y + 3 * reach * down, x + 3 * reach * right
                if not (0 <= y3 < rows and 0 <= x3 < columns):
                    y3, x3 = y2 + 2 * reach * right, x2 + 2 * reach * down
                if not (0 <= y3 < rows and 0 <= x3 < columns):
                    continue
                if min(free[y1, x1], free[y2, x2], free[y3, x3]) < _f4(0.5):
                    continue
                if count == out.shape[1]:
                    return count
                across = outside = other_across = other_outside = _f4(0)
                for channel in range(channels):
                    middle = planes[channel, y2, x2]
                    across += (planes[channel, y1, x1] - middle) ** 2
                    outside += (planes[channel, y3, x3] - middle) ** 2
                    middle = _f4(other.values[channel, top + y2, left + x2])
                    other_across += (_f4(other.values[channel, top + y1, left + x1]) - middle) ** 2
                    other_outside += (_f4(other.values[channel, top + y3, left + x3]) - middle) ** 2
                out[0, count], out[1, count] = np.sqrt(across), np.sqrt(outside)
                out[2, count] = other.step * np.sqrt(other_across)
                out[3, count] = other.step * np.sqrt(other_outside)
                count += 1
    return count


@compiled
def _median(values, order):
    """The median of some numbers, as they are partly sorted in `order`, which is overwritten."""
    put(values, order)
    low, high, middle = 0, values.size - 1, values.size // 2
    while low < high:
        pivot = order[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while order[i] < pivot:
                i += 1
            while order[j] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if values.size % 2:
        return float(order[middle])
    below = order[0]
    for i in range(middle):
        below = max(below, order[i])
    return 0.5 * (float(order[middle]) + float(below))


@compiled
def _surprise(across, beside, order):
    """How much less likely contrasts across an outline are than those beside it, by the density of these."""
    scale = _median(beside, order) + 1
    total, ratio = 0.0, 1.0
    for k in range(across.size):
        ratio *= (scale + across[k]) / (scale + beside[k])
        if k % _TOGETHER == _TOGETHER - 1:
            total += np.log(ratio)
            ratio = 1.0
    return 2 * (total + np.log(ratio))


@compiled
def outline_evidence(planes, top, left, picture, free, mask, within, scratch):
    """Log ratio of ghost and real, nats, summed over an outline as if its pixels were independent.

    Parameters
    ----------
    planes
        `(channels, height, width)` of the image, cut out where the mask is.
    top, left
        px, where that is in the background's picture.
    picture
        `StoredPlanes` of the whole background.
    free
        `(height, width)`, what nothing in front covers, 0 outside of the picture.
    mask
        `(height, width)`.
    within
        top, left, bottom and right of its part that may be likely.
    scratch
        memory for `5 * 4 * mask.size` numbers, of which the longest outline needs all.
    """
    most = scratch.size // 5
    out, order = scratch[: 4 * most].reshape(4, most), scratch[4 * most : 5 * most]
    count = outline_contrasts(planes, top, left, picture, free, mask, within, REACH, out)
    if count < LEAST_OUTLINE:
        return 0.0
    seen = _surprise(out[0, :count], out[1, :count], order[:count])
    return _surprise(out[2, :count], out[3, :count], order[:count]) - seen

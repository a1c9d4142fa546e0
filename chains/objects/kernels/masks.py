"""Loops over soft masks: how large they are, where they are narrow, and cutting them back."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled
from ....models.pixels.kernels.layers import Pools
from .records import RECORD, mask_of

_f4 = np.float32

LIKELY = 0.45
"""Probability of cover from which on a pixel counts as part of an object's box."""

COVERED, CRUMB = 0.3, 0.1
"""Probability of cover from which on pixels make a spot, and share of the largest that crumbs have not."""

FAINT = 0.25
"""Probability of cover from which on a mask's patch must leave room around a pixel."""


class MaskShape(NamedTuple):
    """What is known of a mask at a glance; rows and columns count within its patch, ends are exclusive.

    `mass` is its sum. The box holds the pixels that it likely covers (at least two in a row or column), the
    faint box all that it may cover; without any, they are empty (ends at 0). The waist is the column where it
    is narrowest between two upright parts, `waist_depth` its height there as a share of theirs (1: there is
    none).
    """

    mass: float
    top: int
    left: int
    bottom: int
    right: int
    faint_top: int
    faint_left: int
    faint_bottom: int
    faint_right: int
    waist: int
    waist_depth: float


@compiled
def measure(blob, mask, scratch):
    """Write a mask's shape (see `MaskShape`) into a blob's record; `scratch` has room for five rows of it."""
    rows, columns = mask.shape
    sums = scratch[: 5 * columns].reshape(5, columns)
    sums[:] = _f4(0)
    per_column, likely, faint, smooth, highest = sums[0], sums[1], sums[2], sums[3], sums[4]
    top, bottom, faint_top, faint_bottom = rows, 0, rows, 0
    for y in range(rows):
        row = mask[y]
        in_row = faint_in_row = _f4(0)
        for x in range(columns):
            value = row[x]
            per_column[x] += value
            is_likely = _f4(1) if value > _f4(LIKELY) else _f4(0)
            is_faint = _f4(1) if value > _f4(FAINT) else _f4(0)
            likely[x] += is_likely
            faint[x] += is_faint
            in_row += is_likely
            faint_in_row += is_faint
        if in_row > 1:
            top, bottom = min(top, y), y + 1
        if faint_in_row > 0:
            faint_top, faint_bottom = min(faint_top, y), y + 1
    left, right, faint_left, faint_right = columns, 0, columns, 0
    for x in range(columns):
        if likely[x] > 1:
            left, right = min(left, x), x + 1
        if faint[x] > 0:
            faint_left, faint_right = min(faint_left, x), x + 1
    for x in range(columns):
        before, after = per_column[max(x - 1, 0)], per_column[min(x + 1, columns - 1)]
        smooth[x] = (before + per_column[x] + after) * _f4(1 / 3)
    most = _f4(0)
    for x in range(columns - 1, -1, -1):
        most = max(most, smooth[x])
        highest[x] = most
    waist, depth, most = 0, _f4(1), _f4(0)
    for x in range(columns):
        most = max(most, smooth[x])
        beside = min(most, highest[x])
        if beside > _f4(0.25) * rows and smooth[x] < depth * beside:
            waist, depth = x, smooth[x] / beside
    mass = 0.0
    for x in range(columns):
        mass += per_column[x]
    blob.mass, blob.waist, blob.waist_depth = mass, waist, depth
    blob.top, blob.left, blob.bottom, blob.right = top, left, bottom, right
    blob.faint_top, blob.faint_left = faint_top, faint_left
    blob.faint_bottom, blob.faint_right = faint_bottom, faint_right


@compiled
def measure_all(blobs, pools, scratch):
    """Measure the masks of blobs (see `measure`)."""
    for k in range(blobs.size):
        measure(blobs[k], mask_of(blobs[k], pools), scratch)


def shape_of(mask: NDArray[np.float32]) -> MaskShape:
    """Measure a mask `(height, width)` float32."""
    record, nothing = np.zeros(1, RECORD), np.zeros(0, np.float32)
    record["rows"], record["columns"] = mask.shape
    flat = np.ascontiguousarray(mask).reshape(-1)
    measure_all(record, Pools(flat, nothing), np.empty(5 * mask.shape[1], np.float32))
    return MaskShape(*(record[name].item() for name in MaskShape._fields))


@compiled
def without_crumbs(mask, memory):
    """Take spots away, in place, that are apart from a mask's main part and less than a tenth of its largest.

    `memory` int64 has room for three numbers a pixel. Gives whether there were any.
    """
    rows, columns = mask.shape
    spots, waiting, areas = memory[: mask.size], memory[mask.size : 2 * mask.size], memory[2 * mask.size :]
    spots[:] = 0
    flat, found, largest = mask.reshape(-1), 0, 0
    for first in range(mask.size):
        if spots[first] or flat[first] <= _f4(COVERED):
            continue
        found += 1
        spots[first], waiting[0], count, area = found, first, 1, 0
        while count:
            count, area = count - 1, area + 1
            y = waiting[count] // columns
            x = waiting[count] - y * columns
            for j in range(max(y - 1, 0), min(y + 2, rows)):
                for i in range(max(x - 1, 0), min(x + 2, columns)):
                    k = j * columns + i
                    if spots[k] == 0 and flat[k] > _f4(COVERED):
                        spots[k], waiting[count], count = found, k, count + 1
        areas[found - 1], largest = area, max(largest, area)
    changed = False
    for k in range(mask.size):
        if spots[k] and areas[spots[k] - 1] < CRUMB * largest:
            flat[k], changed = _f4(0), True
    return changed


@compiled
def sweep(blobs, pools, due, memory, scratch):
    """Free the masks of those blobs that are `due` `(n,)` of crumbs, and measure them again.

    `memory` int64 has room for three numbers a pixel of the largest mask, `scratch` as for `measure`.
    """
    for k in range(blobs.size):
        if due[k] and without_crumbs(mask_of(blobs[k], pools), memory):
            measure(blobs[k], mask_of(blobs[k], pools), scratch)


@compiled
def fade_beyond(mask, height, width, kept, scratch):
    """Scale a mask by `kept`, in place, further from its median than half of `height`, `width` px and 2.

    `scratch` has room for a row and a column of it.
    """
    rows, columns = mask.shape
    per_row, per_column = scratch[:rows], scratch[rows : rows + columns]
    scratch[: rows + columns] = _f4(0)
    for y in range(rows):
        row = mask[y]
        in_row = _f4(0)
        for x in range(columns):
            in_row += row[x]
            per_column[x] += row[x]
        per_row[y] = in_row
    middle_y, middle_x = _median(per_row), _median(per_column)
    for y in range(rows):
        far_row = abs(y - middle_y) > 0.5 * height + 2
        for x in range(columns):
            if far_row or abs(x - middle_x) > 0.5 * width + 2:
                mask[y, x] *= kept


@compiled
def _median(masses):
    half = 0.5 * masses.sum()
    total = 0.0
    for k in range(masses.size):
        total += masses[k]
        if total >= half:
            return k
    return masses.size - 1

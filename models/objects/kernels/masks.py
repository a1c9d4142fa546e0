"""Loops over soft masks: how large they are, where they are narrow, and cutting them back."""

from typing import NamedTuple

import numpy as np

from ...numerics.compiled import compiled

_f4 = np.float32

LIKELY = 0.45
"""Probability of cover from which on a pixel counts as part of an object's box."""

FAINT = 0.25
"""Probability of cover from which on a mask's patch must leave room around a pixel."""


class MaskShape(NamedTuple):
    """What is known of a mask at a glance; rows and columns count within its patch, ends are exclusive.

    `mass` is its sum. The box holds the pixels that it likely covers (at least two in a row or column), the
    faint box all that it may cover; without any, they are empty (ends at 0). The waist is the column where it
    is narrowest between two upright parts, `waist_depth` its height there as a share of theirs (1: there is
    none), `mass_left` what lies left of it.
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
    mass_left: float


@compiled
def _shape(mask):
    rows, columns = mask.shape
    per_column = np.zeros(columns, np.float32)
    likely, faint = np.zeros(columns, np.int32), np.zeros(columns, np.int32)
    top, bottom, faint_top, faint_bottom = rows, 0, rows, 0
    for y in range(rows):
        row = mask[y]
        in_row = faint_in_row = np.int32(0)
        for x in range(columns):
            value = row[x]
            per_column[x] += value
            is_likely, is_faint = np.int32(value > _f4(LIKELY)), np.int32(value > _f4(FAINT))
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
    smooth = np.empty(columns, np.float32)
    for x in range(columns):
        before, after = per_column[max(x - 1, 0)], per_column[min(x + 1, columns - 1)]
        smooth[x] = (before + per_column[x] + after) * _f4(1 / 3)
    highest = np.empty(columns, np.float32)
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
    mass = mass_left = 0.0
    for x in range(columns):
        mass += per_column[x]
        if x < waist:
            mass_left += per_column[x]
    return (
        mass,
        top,
        left,
        bottom,
        right,
        faint_top,
        faint_left,
        faint_bottom,
        faint_right,
        waist,
        depth,
        mass_left,
    )


def shape_of(mask: np.ndarray[tuple[int, int], np.dtype[np.float32]]) -> MaskShape:
    """Measure a mask `(height, width)` float32."""
    return MaskShape(*_shape(mask))


@compiled
def fade_beyond(mask, height, width, kept):
    """Scale a mask by `kept`, in place, further from its median than half of `height`, `width` px and 2."""
    rows, columns = mask.shape
    per_row, per_column = np.zeros(rows, np.float32), np.zeros(columns, np.float32)
    for y in range(rows):
        row = mask[y]
        for x in range(columns):
            per_row[y] += row[x]
            per_column[x] += row[x]
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


@compiled
def clear_blocks(counts, top, left, mask, scale):
    """Set blocks of `scale` px to 0 that a mask placed at `(top, left)` touches, and those beside them."""
    block_rows, block_columns = counts.shape
    rows, columns = mask.shape
    for block_y in range(max(top // scale, 0), min((top + rows - 1) // scale + 1, block_rows)):
        for block_x in range(max(left // scale, 0), min((left + columns - 1) // scale + 1, block_columns)):
            touched = False
            for y in range(max(block_y * scale - top, 0), min((block_y + 1) * scale - top, rows)):
                for x in range(max(block_x * scale - left, 0), min((block_x + 1) * scale - left, columns)):
                    touched = touched or mask[y, x] > _f4(0.2)
            if touched:
                counts[max(block_y - 1, 0) : block_y + 2, max(block_x - 1, 0) : block_x + 2] = 0

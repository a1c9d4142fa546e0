"""Foreground that no blob accounts for, block by block of the picture."""

import numpy as np

from ....models.numerics.compiled import compiled
from ....models.pixels.kernels.gaussian import foreground_spans
from .records import corner_of, mask_of

_f4 = np.float32


@compiled
def count_foreground(log_odds, width, scale, counts, memory):
    """Number of foreground pixels (negative log odds) in every block of `scale` x `scale` px.

    `memory` is room for a number for every 64 pixels, one more, and one for every column.
    """
    counts[:] = 0
    columns, spans = memory[:width], memory[width:]
    for x in range(width):
        columns[x] = x // scale
    for k in range(foreground_spans(log_odds, spans)):
        i, end = spans[k], min(spans[k] + 64, log_odds.size)
        while i < end:
            y = i // width
            x = i - y * width
            row, last = counts[y // scale], min(end, i - x + width)
            for j in range(i, last):
                row[columns[x + j - i]] += np.int32(log_odds[j] < 0)
            i = last


@compiled
def clear_blocks(counts, top, left, mask, scale, most):
    """Set blocks of `scale` px to 0 that a mask placed at `(top, left)` touches, and those beside them.

    `most` has room for a row of the mask.
    """
    block_rows, block_columns = counts.shape
    rows, columns = mask.shape
    first, end = max(left // scale, 0), min((left + columns - 1) // scale + 1, block_columns)
    for block_y in range(max(top // scale, 0), min((top + rows - 1) // scale + 1, block_rows)):
        highest = most[:columns]
        highest[:] = _f4(0)
        for y in range(max(block_y * scale - top, 0), min((block_y + 1) * scale - top, rows)):
            for x in range(columns):
                highest[x] = max(highest[x], mask[y, x])
        for block_x in range(first, end):
            touched = False
            for x in range(max(block_x * scale - left, 0), min((block_x + 1) * scale - left, columns)):
                touched |= highest[x] > _f4(0.2)
            if touched:
                for y in range(max(block_y - 1, 0), min(block_y + 2, block_rows)):
                    for x in range(max(block_x - 1, 0), min(block_x + 2, block_columns)):
                        counts[y, x] = 0


@compiled
def _take_spot(counts, row, column, least, waiting):
    """Follow a spot of blocks, which are set to 0: its first and end row and column, and how many pixels.

    Blocks touch along sides and at corners, and have `least` pixels each. `waiting` has room for all blocks.
    """
    rows, columns = counts.shape
    top, left, bottom, right, area = row, column, row + 1, column + 1, counts[row, column]
    counts[row, column] = 0
    waiting[0], count = row * columns + column, 1
    while count:
        count -= 1
        y = waiting[count] // columns
        x = waiting[count] - y * columns
        top, left, bottom, right = min(top, y), min(left, x), max(bottom, y + 1), max(right, x + 1)
        for j in range(max(y - 1, 0), min(y + 2, rows)):
            for i in range(max(x - 1, 0), min(x + 2, columns)):
                if counts[j, i] >= least:
                    area += counts[j, i]
                    counts[j, i] = 0
                    waiting[count], count = j * columns + i, count + 1
    return top, left, bottom, right, area


@compiled
def find_spots(log_odds, size, scale, blobs, pools, smallest, thinnest, counts, memory, found):
    """Spots of blocks a quarter of which or more is foreground, and none of a blob's or beside it.

    Parameters
    ----------
    log_odds
        `(n_pixels,)` int8, of background, of a picture of this `size`.
    scale
        px, side of a block.
    blobs, pools
        records, and pixels.
    smallest, thinnest
        least area, px, and least share of the squared length.
    counts
        `(block_rows, block_columns)` int32, to be filled.
    memory
        int64, room for one number for every 64 pixels, for every column, and for every block.
    found
        `(n, 5)` int64, to be filled: top, left, bottom, right, area px.

    Returns
    -------
    count
        of the rows of `found` that were filled.
    """
    count_foreground(log_odds, size[1], scale, counts, memory)
    widest = 0
    for k in range(blobs.size):
        widest = max(widest, blobs[k].columns)
    most = np.empty(widest, np.float32)
    for k in range(blobs.size):
        top, left = corner_of(blobs[k])
        clear_blocks(counts, top, left, mask_of(blobs[k], pools), scale, most)
    least, count = -(-scale * scale // 4), 0
    for row in range(counts.shape[0]):
        in_row = counts[row]
        highest = np.int32(0)
        for column in range(in_row.size):
            highest = max(highest, in_row[column])
        for column in range(in_row.size if highest >= least else 0):
            if in_row[column] < least or count == len(found):
                continue
            top, left, bottom, right, area = _take_spot(counts, row, column, least, memory)
            length = scale * max(bottom - top, right - left)
            if area >= max(smallest, thinnest * length * length):
                found[count, 0], found[count, 1], found[count, 2] = scale * top, scale * left, scale * bottom
                found[count, 3], found[count, 4] = scale * right, area
                count += 1
    return count

"""Boxes cut out of the picture: what they show, and what of them is free.

A patch is a small array; `(top, left)` places it in the picture, over whose edges it may reach.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled
from ....models.pixels.kernels.gaussian import ODDS_STEPS
from .records import colours_of, corner_of, mask_of

_f4 = np.float32

UNKNOWN_COLOUR = -1e4
"""In an appearance: no colour is known of this pixel."""


class Patch(NamedTuple):
    """A box cut out of the picture, all float32.

    `(channels, height, width)` planes, and `(height, width)` each: log odds of background in nats, and what
    nothing else covers (0 outside the picture).
    """

    planes: NDArray[np.float32]
    log_odds: NDArray[np.float32]
    free: NDArray[np.float32]


@compiled
def patch_in(scratch, channels, rows, columns):
    """A patch whose memory is the beginning of `scratch` `(n,)`; also what of that is left."""
    size = rows * columns
    planes = scratch[: channels * size].reshape(channels, rows, columns)
    odds = scratch[channels * size : (channels + 1) * size].reshape(rows, columns)
    free = scratch[(channels + 1) * size : (channels + 2) * size].reshape(rows, columns)
    return Patch(planes, odds, free), scratch[(channels + 2) * size :]


@compiled
def gather(image, log_odds, top, left, patch):
    """Cut a box out of a picture `(height, width, channels)` and int8 log odds `(height, width)`."""
    planes, odds, free = patch
    height, width, channels = image.shape
    rows, columns = free.shape
    first, end = min(max(0, -left), columns), max(min(columns, width - left), 0)
    first_row, end_row = min(max(0, -top), rows), max(min(rows, height - top), 0)
    if first >= end:
        end_row = first_row
    for row in range(rows):
        if row < first_row or row >= end_row or end - first < columns:
            free[row] = _f4(0)
            odds[row] = _f4(0)
            planes[:, row] = _f4(0)
    pixels, steps = image.reshape(-1), log_odds.reshape(-1)
    # Rows inside the picture only. Compiled code looks first whether all that the loop reads is apart from
    # what it writes, and goes another way, with other last digits, if it is not. With rows beyond the picture
    # that would depend on what lies behind it in memory.
    for row in range(first_row, end_row):
        free[row, first:end] = _f4(1)
        start, count = np.uint64((top + row) * width + left + first), np.uint64(end - first)
        out = odds[row, first:end]
        for x in range(count):
            out[x] = _f4(steps[start + x]) * _f4(1 / ODDS_STEPS)
        luma = planes[0, row, first:end]
        if channels == 3:
            red, blue = planes[1, row, first:end], planes[2, row, first:end]
            for x in range(count):
                k = np.uint64(3) * (start + x)
                b, g, r = _f4(pixels[k]), _f4(pixels[k + np.uint64(1)]), _f4(pixels[k + np.uint64(2)])
                grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                luma[x] = grey
                red[x] = _f4(1.426) * (r - grey)
                blue[x] = _f4(1.128) * (b - grey)
        else:
            for x in range(count):
                luma[x] = _f4(pixels[start + x])


@compiled
def cover(free, top, left, mask):
    """Take away from `free` what a mask placed at `(top, left)` in it covers."""
    rows, columns = free.shape
    first, end = max(0, -left), min(mask.shape[1], columns - left)
    for row in range(max(0, -top), min(mask.shape[0], rows - top)):
        for x in range(first, end):
            free[top + row, left + x] *= _f4(1) - mask[row, x]


@compiled
def cover_by(free, top, left, blobs, pools):
    """Take away from `free`, placed at `(top, left)` in the picture, what blobs cover."""
    rows, columns = free.shape
    for k in range(blobs.size):
        y, x = corner_of(blobs[k])
        down, right = y - top, x - left
        if -blobs[k].rows < down < rows and -blobs[k].columns < right < columns:
            cover(free, down, right, mask_of(blobs[k], pools))


@compiled
def colour_newborn(blob, pools, image):
    """Give a blob the colours that the picture shows where it likely is."""
    height, width, channels = image.shape
    top, left = corner_of(blob)
    blob.coloured = 1
    mask, colours = mask_of(blob, pools), colours_of(blob, pools, channels)
    pixels = image.reshape(-1)
    for row in range(blob.rows):
        for x in range(blob.columns):
            inside = 0 <= top + row < height and 0 <= left + x < width
            likely = mask[row, x] > _f4(0.2)
            k = channels * ((top + row) * width + left + x)
            if inside and likely and channels == 3:
                b, g, r = _f4(pixels[k]), _f4(pixels[k + 1]), _f4(pixels[k + 2])
                grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                colours[0, row, x] = grey
                colours[1, row, x] = _f4(1.426) * (r - grey)
                colours[2, row, x] = _f4(1.128) * (b - grey)
            else:
                shown = _f4(pixels[k]) if inside else _f4(0)
                colours[:, row, x] = shown if likely else _f4(UNKNOWN_COLOUR)

"""Masks of single objects, which a run's foreground and their boxes give, and their compact form in COCO."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FIRST = ord("0")
"""Of the characters of a compressed mask."""

BITS, GOES_ON, NEGATIVE = 5, 0x20, 0x10
"""Bits of a number in a character; the one that says that more follow; the sign of the last ones."""


def object_masks(foreground: NDArray[np.uint8], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """What of the foreground lies in each box.

    A run stores one mask for all of its objects: where boxes overlap, a pixel is taken for both.

    Parameters
    ----------
    foreground
        `(height, width)`, 0 or 255.
    boxes
        `(n, 4)` px: x, y, width, height.

    Returns
    -------
    NDArray[np.bool_]
        `(n, height, width)`: pixels whose middle is in the box.
    """
    masks = np.zeros((len(boxes), *foreground.shape), bool)
    for mask, (x, y, width, height) in zip(masks, boxes.tolist(), strict=True):
        window = (_pixels(y, height, foreground.shape[0]), _pixels(x, width, foreground.shape[1]))
        mask[window] = foreground[window] > 0
    return masks


def _pixels(start: float, length: float, limit: int) -> slice:
    """Rows or columns of a picture whose middles lie between two edges."""
    first, end = (min(max(math.ceil(edge - 0.5), 0), limit) for edge in (start, start + length))
    return slice(first, end)


def compressed(mask: NDArray[np.bool_]) -> str:
    """A mask as COCO's compressed run lengths, `counts` of its `segmentation`.

    Runs of pixels that are 0 and 1 by turns, column after column, beginning with 0; from the fourth on, each
    is written as the difference from the one before the last, in characters of 5 bits (`rleToString` of the
    COCO API, by P. Dollár and T.-Y. Lin).

    Parameters
    ----------
    mask
        `(height, width)`.
    """
    pixels = mask.ravel(order="F")
    edges = np.flatnonzero(pixels[1:] != pixels[:-1]) + 1
    begins = [0] if len(pixels) and pixels[0] else []
    ends = [0, *begins, *edges.tolist(), len(pixels)]
    return _characters([end - start for start, end in pairwise(ends)])


def _characters(runs: Sequence[int]) -> str:
    text = []
    for place, run in enumerate(runs):
        value = run - runs[place - 2] if place > 2 else run
        while True:
            low, value = value & ((1 << BITS) - 1), value >> BITS
            done = value == (-1 if low & NEGATIVE else 0)
            text.append(chr(FIRST + (low if done else low | GOES_ON)))
            if done:
                break
    return "".join(text)

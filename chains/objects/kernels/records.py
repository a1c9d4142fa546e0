"""Blobs as records of one table: what loops know of each, and where its pixels are.

Masks of all blobs lie one after the other in one flat array, and so do their colours: of a blob with a patch
of `rows` x `columns` px they begin at `start`, and at `channels * start`, plane by plane.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled

_PLACES = (
    "top", "left", "bottom", "right", "faint_top", "faint_left", "faint_bottom", "faint_right", "waist",
)  # fmt: skip

RECORD = np.dtype(
    [
        ("identity", np.int64),
        ("position", np.float64, (2,)),
        ("velocity", np.float64, (2,)),
        ("covariance", np.float64, (2, 2)),
        *((name, np.float64) for name in ("spread", "seen", "unseen", "still", "confidence", "view")),
        *((name, np.float64) for name in ("past_views", "fragment_time")),
        ("whole", np.int64),
        ("origin", np.float64, (4,)),
        ("parting", np.float64),
        ("size", np.float64, (2,)),
        ("existence", np.float64),
        ("noticed", np.float64),
        ("detected", np.int64),
        ("box_mean", np.float64, (4,)),
        ("box_variance", np.float64, (4,)),
        ("unfound", np.float64),
        ("coloured", np.int64),
        ("start", np.int64),
        ("rows", np.int64),
        ("columns", np.int64),
        ("mass", np.float64),
        *((name, np.int64) for name in _PLACES),
        ("waist_depth", np.float64),
    ]
)
"""All that is known of a blob but its pixels, in words of 8 bytes; `Blob` says what it means.

`detected` and `coloured` are 0 or 1. From `mass` on it is measured of the mask (see `MaskShape`).
"""

FRESH = 0.5
"""s for which a blob was seen, below which it may still be a part of another."""

MARGIN = 6
"""px of empty border in a blob's patch, into which its mask can grow."""


class Picture(NamedTuple):
    """A frame: `(height, width, channels)` uint8, int8 log odds of background `(height, width)`, P(B=1)."""

    image: NDArray[np.uint8]
    log_odds: NDArray[np.int8]
    prior: np.float32


@compiled
def corner_of(blob):
    """Top and left px of a blob's patch, as it is rendered."""
    return int(np.floor(blob.position[0] + 0.5)), int(np.floor(blob.position[1] + 0.5))


@compiled
def mask_of(blob, pools):
    """The mask `(rows, columns)` of a blob."""
    return pools.masks[blob.start : blob.start + blob.rows * blob.columns].reshape(blob.rows, blob.columns)


@compiled
def colours_of(blob, pools, channels):
    """The colours `(channels, rows, columns)` of a blob; no channels of one whose colours nobody knows."""
    known = channels if blob.coloured else 0
    start, size = channels * blob.start, blob.rows * blob.columns
    return pools.colours[start : start + known * size].reshape(known, blob.rows, blob.columns)


@compiled
def box_of(blob):
    """x, y, width, height px of what the mask likely covers, or else of its patch."""
    y, x = blob.position[0], blob.position[1]
    if blob.bottom == 0 or blob.right == 0:
        return x, y, float(blob.columns), float(blob.rows)
    return x + blob.left, y + blob.top, float(blob.right - blob.left), float(blob.bottom - blob.top)


@compiled
def reported_box_of(blob):
    """x, y, width, height px: as detections have it, or else as the mask."""
    if not blob.detected:
        return box_of(blob)
    x, y, width, height = blob.box_mean
    return blob.position[1] + x - 0.5 * width, blob.position[0] + y - height, width, height


@compiled
def length_of(blob):
    """px, the longer side of the box."""
    _, _, width, height = reported_box_of(blob)
    return max(width, height)


@compiled
def fill_boxes(blobs, boxes, reported):
    """Boxes of all blobs, `(n, 4)` each: of their masks, and as they are reported."""
    for k in range(blobs.size):
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = box_of(blobs[k])
        reported[k, 0], reported[k, 1], reported[k, 2], reported[k, 3] = reported_box_of(blobs[k])


@compiled
def overlap(box, other):
    """Whether two boxes x, y, width, height have a place in common."""
    x, y, width, height = box
    left, top, columns, rows = other
    return x < left + columns and left < x + width and y < top + rows and top < y + height

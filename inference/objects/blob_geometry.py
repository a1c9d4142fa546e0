"""Patches, masks and boxes of blobs: cutting, joining, and which are parts of one object."""

from collections.abc import Sequence

import cv2
import numpy as np

from ...models.core.gaussian_message import GaussianMessage
from ...models.objects.kernels.blobs import UNKNOWN_COLOUR, cover
from ...models.objects.kernels.masks import shape_of
from .blobs import MARGIN, Blob, Box, Map, Pair, Track

THINNEST = 0.08
"""Area over squared length below which a spot is a line (a rope, an edge that shakes) and no object."""

FRESH = 0.5
"""s for which a blob was seen, below which it may still be a part of another."""


def cover_by(free: Map, top: int, left: int, blobs: Sequence[Blob]) -> None:
    """Take away from `free` `(height, width)`, placed at `(top, left)`, what blobs cover."""
    rows, columns = free.shape
    for blob in blobs:
        down, right = blob.corner[0] - top, blob.corner[1] - left
        if -blob.mask.shape[0] < down < rows and -blob.mask.shape[1] < right < columns:
            cover(free, down, right, blob.mask)


def is_hidden(blob: Blob, in_front: Sequence[Blob]) -> bool:
    """Whether others cover most of a blob."""
    free = np.ones(blob.mask.shape, np.float32)
    cover_by(free, *blob.corner, in_front)
    return float((free * blob.mask).sum()) < 0.5 * float(blob.mask.sum())


def box_densities(blobs: Sequence[Blob | Track]) -> GaussianMessage:
    """Where blobs stand and how large they look, as a message to `ObjectBoxes`."""
    x, y, width, height = np.array([blob.box for blob in blobs]).T
    deviations = np.stack([0.05 * width, 0.03 * height, 0.15 * width, 0.08 * height], axis=1) + 1
    return GaussianMessage.from_moments(
        [blob.identity for blob in blobs],
        np.stack([x + 0.5 * width, y + height, width, height], axis=1),
        deviations[:, :, None] ** 2 * np.eye(4),
    )


def overlap(box: Box, other: Box) -> bool:
    """Whether two boxes x, y, width, height have a place in common."""
    x, y, width, height = box
    left, top, columns, rows = other
    return x < left + columns and left < x + width and y < top + rows and top < y + height


def likely_size(mask: Map) -> Pair:
    """Height and width px of what a mask likely covers, at least 1."""
    shape = shape_of(mask)
    return np.array([max(shape.bottom - shape.top, 1.0), max(shape.right - shape.left, 1.0)])


def without_crumbs(mask: Map) -> Map:
    """The mask without spots that are apart from its main part and small."""
    found, labels, boxes, _ = cv2.connectedComponentsWithStats((mask > 0.3).astype(np.uint8), connectivity=8)
    if found <= 2:
        return mask
    areas = boxes[:, cv2.CC_STAT_AREA]
    crumb = areas < 0.1 * areas[1:].max()
    crumb[0] = False
    return np.where(crumb[labels], np.float32(0), mask)


def paste(out: Map, top: int, left: int, source: Map, source_top: int, source_left: int) -> None:
    """Copy the common part of two placed arrays `(..., height, width)`."""
    first_row, first_column = max(top, source_top), max(left, source_left)
    end_row = min(top + out.shape[-2], source_top + source.shape[-2])
    end_column = min(left + out.shape[-1], source_left + source.shape[-1])
    if first_row < end_row and first_column < end_column:
        out[..., first_row - top : end_row - top, first_column - left : end_column - left] = source[
            ...,
            first_row - source_top : end_row - source_top,
            first_column - source_left : end_column - source_left,
        ]


def fitted(blob: Blob) -> Blob:
    """The blob with a patch that leaves its mask room to grow, and not much more."""
    measured = blob.shape
    begin = np.array([measured.faint_top, measured.faint_left])
    end = np.array([measured.faint_bottom, measured.faint_right])
    room = [*begin, *(np.array(blob.mask.shape) - end)]
    if not end.all() or (min(room) >= MARGIN // 2 and max(room) <= 3 * MARGIN):
        return blob
    first, shape = begin - MARGIN, tuple(end - begin + 2 * MARGIN)
    mask = np.zeros(shape, np.float32)
    appearance = np.full((len(blob.appearance), *shape), UNKNOWN_COLOUR, np.float32)
    top, left = first.tolist()
    paste(mask, top, left, blob.mask, 0, 0)
    paste(appearance, top, left, blob.appearance, 0, 0)
    return blob.moved_patch(first).changed(mask=mask, appearance=appearance)

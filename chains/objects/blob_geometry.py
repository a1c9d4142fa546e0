"""Patches, masks and boxes of blobs: cutting, joining, and which are parts of one object."""

import numpy as np
from numpy.typing import ArrayLike

from ...models.core.gaussian_message import GaussianMessage
from .blobs import Map, Pair
from .kernels.masks import shape_of


def box_densities(identities: ArrayLike, boxes: ArrayLike) -> GaussianMessage:
    """Where objects stand and how large they look, `(n, 4)` px, as a message to `ObjectBoxes`."""
    x, y, width, height = np.asarray(boxes, np.float64).T
    deviations = np.stack([0.05 * width, 0.03 * height, 0.15 * width, 0.08 * height], axis=1) + 1
    return GaussianMessage.from_moments(
        np.asarray(identities, np.int64),
        np.stack([x + 0.5 * width, y + height, width, height], axis=1),
        deviations[:, :, None] ** 2 * np.eye(4),
    )


def likely_size(mask: Map) -> Pair:
    """Height and width px of what a mask likely covers, at least 1."""
    shape = shape_of(mask)
    return np.array([max(shape.bottom - shape.top, 1.0), max(shape.right - shape.left, 1.0)])


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

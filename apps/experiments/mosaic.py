"""Pictures in named rows under named columns, as one image: the form of the papers' figures."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

GAP = 4  # px
TEXT = 18  # px, height of a line
PAPER = 255
TALLEST = 4
"""Times as high as wide: the room for a picture."""


def fitting(shape: tuple[int, ...], width: int) -> tuple[int, int]:
    """Width and height, px, of a picture `(height, width[, 3])` at a width; less for a very tall one."""
    scale = min(width / shape[1], TALLEST * width / shape[0])
    return max(1, round(scale * shape[1])), max(1, round(scale * shape[0]))


def mosaic(rows: Sequence[tuple[str, Sequence[Image]]], columns: Sequence[str], width: int = 240) -> Image:
    """Lay out pictures; each row has its name above.

    Parameters
    ----------
    rows
        name and pictures `(height, width[, 3])` uint8, all of one size, as many as there are columns.
    columns
        names above the first row.
    width
        px to which each picture is scaled, where it is no more than four times as high as wide.

    Returns
    -------
    NDArray[np.uint8]
        `(height, width, 3)` BGR.
    """
    width, height = fitting(rows[0][1][0].shape, width)
    across, down = width + GAP, height + TEXT + GAP
    shape = (TEXT + len(rows) * down + GAP, len(columns) * across + GAP, 3)
    sheet: Image = np.full(shape, PAPER, np.uint8)
    for column, name in enumerate(columns):
        _write(sheet, name, GAP + column * across, TEXT - 5)
    for row, (name, images) in enumerate(rows):
        top = TEXT + row * down
        _write(sheet, name, GAP, top + TEXT - 5)
        for column, image in enumerate(images):
            left = GAP + column * across
            small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            if small.ndim == 2:
                small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
            sheet[top + TEXT : top + TEXT + height, left : left + width] = small
    return sheet


def _write(sheet: Image, text: str, x: int, y: int) -> None:
    cv2.putText(sheet, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)

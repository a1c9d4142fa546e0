"""Pictures: their grey levels, and drawing in them what feature nodes show of a belief."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def grey_of(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the grey picture `(height, width)` uint8, rows contiguous, of a grey or BGR one."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return np.ascontiguousarray(grey)


Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

FRACTION_BITS = 4  # OpenCV's fixed-point coordinates: sixteenths of a pixel
REGION_90 = 4.605  # squared standard deviations of a Gaussian in two dimensions that hold 90 % of it

INK = (40, 40, 40)
FARTHEST = 10_000  # px


def as_bgr(image: Picture) -> Picture:
    """Return a BGR copy `(height, width, 3)` of a picture that may be grey."""
    copy = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    return np.asarray(copy, np.uint8)


def draw_region(
    picture: Picture, mean: NDArray[np.float64], covariance: NDArray[np.float64], colour: Colour
) -> None:
    """Draw the ellipse that holds 90 % of a Gaussian, `(2,)` px and `(2, 2)` px^2, and its middle."""
    canvas: NDArray[Any] = picture
    variances, directions = np.linalg.eigh(np.nan_to_num(covariance))
    axes = np.clip(np.sqrt(REGION_90 * np.maximum(variances, 0)), 1, FARTHEST)
    turn = float(np.degrees(np.arctan2(directions[1, 1], directions[0, 1])))
    place = np.clip(np.nan_to_num(mean), -FARTHEST, FARTHEST)
    (x, y), (minor, major) = (
        np.rint(each * (1 << FRACTION_BITS)).astype(int).tolist() for each in (place, axes)
    )
    for ink, thickness in ((INK, 2), (colour, 1)):
        cv2.ellipse(canvas, (x, y), (major, minor), turn, 0, 360, ink, thickness, cv2.LINE_AA, FRACTION_BITS)
    cv2.circle(canvas, (x, y), 1 << FRACTION_BITS, colour, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)

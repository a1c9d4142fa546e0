"""The focal length that a picture's file states, as cameras write it there (EXIF)."""

import math
from pathlib import Path
from typing import Any

from PIL import Image

DETAILS = 0x8769
"""The EXIF directory with what the camera was set to."""
FOCAL_MM, FOCAL_35MM = 0x920A, 0xA405
PLANE_RESOLUTION, PLANE_UNIT = 0xA20E, 0xA210
MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
DIAGONAL_35MM = math.hypot(36, 24)
"""mm: the equivalent focal length compares the pictures' diagonals (CIPA DCG-001)."""


def focal_of_picture(path: Path) -> float | None:
    """Focal length in px of the picture in a file; `None` where nothing usable is stated.

    From the equivalent focal length for 35 mm film, or else from the focal length and the resolution of the
    sensor.
    """
    try:
        with Image.open(path) as picture:
            details: dict[int, Any] = dict(picture.getexif().get_ifd(DETAILS))
            diagonal = math.hypot(picture.width, picture.height)
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return None
    try:
        if float(details.get(FOCAL_35MM, 0)) > 0:
            return float(details[FOCAL_35MM]) * diagonal / DIAGONAL_35MM
        millimetres, resolution = float(details.get(FOCAL_MM, 0)), float(details.get(PLANE_RESOLUTION, 0))
        focal = millimetres * resolution / MM_OF_UNIT[int(details.get(PLANE_UNIT, 2))]
    except (ArithmeticError, KeyError, TypeError, ValueError):
        return None
    return focal if math.isfinite(focal) and focal > 0 else None

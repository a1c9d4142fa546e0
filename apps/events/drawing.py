"""Zones and lines drawn into a picture."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .zones import Zones

COLOUR = (0, 200, 255)
"""BGR, amber: no identity is that bright."""

EDGE = (20, 20, 20)


def draw_zones(picture: NDArray[Any], zones: Zones, scale: float = 1.0) -> None:
    """Draw borders, lines with an arrow from left to right, and all names.

    Parameters
    ----------
    picture
        `(height, width, 3)` uint8 BGR, drawn into.
    zones
        px of the film.
    scale
        px of the picture per px of the film.
    """
    thick = max(1, round(1.5 * picture.shape[0] / 480))
    for zone in zones.zones:
        points = _pixels(zone.polygon, scale)
        for ink, width in ((EDGE, 2 * thick + 1), (COLOUR, thick)):
            cv2.polylines(picture, [points], True, ink, width, cv2.LINE_AA)
    for line in zones.lines:
        ends = np.array([line.start, line.end])
        way = ends[1] - ends[0]
        to_right = 12 * thick / scale * np.array([-way[1], way[0]]) / np.hypot(*way)
        middle = ends.mean(axis=0)
        tail, tip = _pixels(np.array([middle, middle + to_right]), scale).tolist()
        for ink, width in ((EDGE, 2 * thick + 1), (COLOUR, thick)):
            cv2.polylines(picture, [_pixels(ends, scale)], False, ink, width, cv2.LINE_AA)
            cv2.arrowedLine(picture, tail, tip, ink, width, cv2.LINE_AA, tipLength=0.5)
    for zone in zones.zones:
        _write(picture, zone.name, _pixels(zone.polygon, scale).mean(axis=0), thick)
    for line in zones.lines:
        _write(picture, line.name, _pixels(np.array([line.start]), scale)[0], thick)


def _pixels(places: NDArray[np.float64], scale: float) -> NDArray[np.int32]:
    """Pixels, whose centres are at whole numbers, of places counted from their edges."""
    return np.rint(scale * places - 0.5).astype(np.int32)


def _write(picture: NDArray[Any], text: str, middle: Any, thick: int) -> None:
    """Write a name about a place, within the picture."""
    size = 0.42 * max(1.0, picture.shape[0] / 480)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, thick)
    x = min(max(round(middle[0] - width / 2), 2), max(2, picture.shape[1] - width - 2))
    y = min(max(round(middle[1] + height / 2), height + 2), picture.shape[0] - below)
    for ink, wide in ((EDGE, thick + 3), (COLOUR, thick)):
        cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, ink, wide, cv2.LINE_AA)

"""The room behind a signer: a wall with shelves, books, pictures, and wooden things of skin's colour."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ..random_fields import mottle
from .paint import Palette, colour

Array = NDArray[np.float64]
Canvas = NDArray[np.uint8]
Pixels = NDArray[np.float32]

SHIFT = 4  # fractional bits of the corners' coordinates


def paint_background(
    size: tuple[int, int], palette: Palette, clutter: float, generator: np.random.Generator
) -> Pixels:
    """What is behind the signer, `(height, width, 3)`; with `clutter` 0 a plain wall."""
    width, height = size
    unit = height / 360
    shape = (height, width)
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = np.clip(palette.wall, 0, 255)
    if clutter > 0:
        _wallpaper(canvas, palette, unit, generator)
        for _ in range(int(generator.poisson(2.5 * clutter))):
            _shelf(canvas, palette, unit, generator)
        for _ in range(int(generator.poisson(5 * clutter))):
            _board(canvas, palette, unit, generator)
        for _ in range(int(generator.poisson(3 * clutter))):
            _wooden(canvas, palette, unit, generator)
    across, down = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    slope = generator.normal(0, 0.08, 2)
    light = 1 + slope[0] * across + slope[1] * down + 0.025 * mottle(shape, 120 * unit, 1.2, generator)
    picture = np.asarray(cv2.GaussianBlur(canvas, (0, 0), 0.6 * unit), np.float32)
    return np.asarray(np.clip(light[..., None] * picture, 4, 250), np.float32)


def wood(palette: Palette, generator: np.random.Generator) -> Array:
    """A colour, BGR, that is near to skin's."""
    paint: Array = palette.skin * generator.normal(1, 0.06, 3) * generator.uniform(0.55, 1.05)
    return paint


def _fill(canvas: Canvas, corners: Array, paint: Array) -> None:
    """Paint a polygon with `corners` `(n, 2)` px."""
    fixed = np.rint(corners * 2**SHIFT).astype(np.int32)
    tone = tuple(float(value) for value in np.clip(paint, 0, 255))
    cv2.fillPoly(canvas, [fixed], tone, cv2.LINE_AA, SHIFT)


def _rectangle(left: float, top: float, wide: float, high: float, angle: float = 0.0) -> Array:
    corners = np.array([[0.0, 0.0], [wide, 0.0], [wide, high], [0.0, high]])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned: Array = np.array([left, top]) + corners @ turn.T
    return turned


def _wallpaper(canvas: Canvas, palette: Palette, unit: float, generator: np.random.Generator) -> None:
    kind = generator.choice(["plain", "stripes", "lozenges", "panels"])
    height, width = canvas.shape[:2]
    paint = palette.wall * generator.uniform(0.82, 1.15)
    step = generator.uniform(14, 45) * unit * (2.5 if kind == "panels" else 1)
    for left in np.arange(-step, width + step, step):
        if kind == "stripes":
            _fill(canvas, _rectangle(left, 0, 0.4 * step, height), paint)
        elif kind == "panels":
            _fill(canvas, _rectangle(left, 0, 2 * unit, height), 0.7 * palette.wall)
        elif kind == "lozenges":
            for top in np.arange(0, height + step, step):
                _fill(canvas, _rectangle(left, top, 0.3 * step, 0.3 * step, np.pi / 4), paint)


def _shelf(canvas: Canvas, palette: Palette, unit: float, generator: np.random.Generator) -> None:
    """A plank with books on it."""
    height, width = canvas.shape[:2]
    left, top = generator.uniform(-0.15, 0.8) * width, generator.uniform(0.12, 0.85) * height
    wide = generator.uniform(70, 220) * unit
    place = left
    while place < left + wide:
        thick, high = generator.uniform(5, 16) * unit, generator.uniform(22, 48) * unit
        if generator.random() < 0.8:
            lean = generator.normal(0, 0.1) * (generator.random() < 0.3)
            book = _rectangle(place, top - high, thick - unit, high, lean)
            _fill(canvas, book, colour(generator, (30, 220), 0.9))
            if generator.random() < 0.5:
                label = _rectangle(place, top - 0.8 * high, thick - unit, 0.15 * high, lean)
                _fill(canvas, label, colour(generator, (90, 240), 0.4))
        place += thick
    plank = wood(palette, generator) if generator.random() < 0.4 else colour(generator, (40, 220), 0.3)
    _fill(canvas, _rectangle(left, top, wide, generator.uniform(4, 8) * unit), plank)


def _board(canvas: Canvas, palette: Palette, unit: float, generator: np.random.Generator) -> None:
    """A picture, a window, a box, a cupboard: rectangles in one another."""
    height, width = canvas.shape[:2]
    wide, high = generator.uniform(18, 95, 2) * unit
    left, top = generator.uniform(-0.05, 1, 2) * (width, height)
    angle = generator.normal(0, 0.15) * (generator.random() < 0.3)
    frame = wood(palette, generator) if generator.random() < 0.25 else colour(generator, (30, 230), 0.6)
    _fill(canvas, _rectangle(left, top, wide, high, angle), frame)
    edge = generator.uniform(3, 7) * unit
    inner = _rectangle(0, 0, wide - 2 * edge, high - 2 * edge) + edge
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    _fill(canvas, inner @ turn.T + (left, top), colour(generator, (40, 220), 0.6))
    for _ in range(int(generator.integers(0, 5))):
        spot = generator.uniform(0.15, 0.7, 2) * (wide, high)
        part = _rectangle(*spot, *(generator.uniform(0.05, 0.3, 2) * (wide, high)))
        _fill(canvas, part @ turn.T + (left, top), colour(generator, (30, 230), 0.7))


def _wooden(canvas: Canvas, palette: Palette, unit: float, generator: np.random.Generator) -> None:
    """A vase, a bowl, a cork, a leg of a chair: round or long, in the colour of skin."""
    height, width = canvas.shape[:2]
    centre = generator.uniform(0.02, 0.98, 2) * (width, height)
    radii = generator.uniform(7, 22, 2) * unit
    if generator.random() < 0.35:
        radii *= (0.5, 2.5)
    sides = int(generator.choice([4, 7, 24]))
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False) + generator.uniform(0, np.pi)
    corners = centre + radii * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    paint = wood(palette, generator)
    _fill(canvas, corners, paint)
    _fill(canvas, centre + 0.6 * (corners - centre) + 0.1 * radii, 0.92 * paint)

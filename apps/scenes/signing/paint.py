"""Textures of a signer and of the room behind, from random numbers."""

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ..random_fields import inside, mottle

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

_inside = partial(inside, soft=0.015)

TONES = np.array(
    [[140, 168, 218], [118, 150, 208], [98, 134, 190], [70, 104, 158], [50, 74, 116]], np.float64
)
"""Skin of people under full light, BGR."""


class Palette:
    """Random colours of a scene, BGR grey levels."""

    def __init__(self, generator: np.random.Generator) -> None:
        mix = generator.uniform(0, len(TONES) - 1)
        low = min(int(mix), len(TONES) - 2)
        self.skin = TONES[low] + (mix - low) * (TONES[low + 1] - TONES[low]) + generator.normal(0, 4, 3)
        self.hair = np.array([30.0, 40.0, 55.0]) * generator.uniform(0.4, 1.8) + generator.uniform(0, 12, 3)
        self.hair_line = float(generator.uniform(-0.74, -0.6))
        self.hair_end = float(generator.uniform(0.0, 0.55))
        self.top = colour(generator, (30, 170))
        self.trousers = colour(generator, (30, 130))
        self.wall = colour(generator, (90, 200), 0.45)


def colour(generator: np.random.Generator, values: tuple[float, float], most: float = 0.75) -> Array:
    """Draw a colour unlike skin, BGR, of value in a range and saturation up to `most`."""
    hue = generator.uniform(35, 160)  # of OpenCV's 180; red and orange are skin's
    saturation = 255 * most * generator.uniform(0.05, 1) ** 1.5
    pixel = np.array([[[hue, saturation, generator.uniform(*values)]]]).round().astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0], np.float64)


def paint_cloth(side: int, base: Array, generator: np.random.Generator) -> Pixels:
    """Paint cloth of a colour `base`, `(side, 2 side, 3)`: plain, striped or chequered, with folds."""
    shape = (side, 2 * side)
    unit = side / 360
    down, across = np.mgrid[: shape[0], : shape[1]] / unit
    pattern = np.zeros(shape)
    kind = generator.choice(["plain", "across", "down", "both"], p=[0.4, 0.25, 0.15, 0.2])
    period, share = generator.uniform(9, 30), generator.uniform(0.25, 0.6)
    for name, place in (("across", down), ("down", across)):
        if kind in (name, "both"):
            pattern += np.abs(place / period % 1 - 0.5) < share / 2
    stripe = base * generator.uniform(0.45, 0.8) if base.mean() > 80 else base + generator.uniform(25, 90)
    # folds are longer than wide, and lie aslant
    folds = mottle((shape[0], shape[1] // 3), 40 * unit, 4 * unit, generator)
    folds = np.asarray(cv2.resize(folds, (shape[1], shape[0])), np.float32)
    threads = mottle(shape, 2.0, 0.8, generator)
    light = np.clip(1 + 0.11 * folds + 0.05 * threads, 0.4, 1.6)
    picture = base + (pattern / max(1.0, pattern.max()))[..., None] * (stripe - base)
    return np.asarray(light[..., None] * picture, np.float32)


def paint_skin(side: int, base: Array, generator: np.random.Generator) -> Pixels:
    """Paint skin of a colour `base`, `(side, side, 3)`."""
    blotches = 0.035 * mottle((side, side), 25.0, 1.0, generator)
    redness = 0.02 * mottle((side, side), 40.0, 6.0, generator)
    light = 1 + blotches[..., None] + redness[..., None] * np.array([-1.0, -1.0, 1.0])
    return np.asarray(light * base, np.float32)


def hairiness(palette: Palette, x: Array, y: Array, z: Array) -> Array:
    """Share of hair, 0 to 1, at places of the unit sphere of a head: y is down, z away from the face."""
    back = z + 0.15 - 0.25 * np.clip(-y, 0, 1)
    side = np.minimum(back, 1.5 * (palette.hair_end - y))
    top = 0.8 * (palette.hair_line + 0.25 * x**2 - y)
    hair: Array = inside(np.maximum(side, top), 0.05)
    return hair


def paint_head(density: float, palette: Palette, generator: np.random.Generator) -> Pixels:
    """Paint skin, hair and features of a face, by longitude and latitude, `density` texels a rad.

    Longitude 0 in the middle is the face, latitude grows downwards.
    """
    columns, rows = round(2 * np.pi * density) + 2, round(np.pi * density) + 2
    latitude = np.arange(rows)[:, None] / density - np.pi / 2
    longitude = np.arange(columns)[None, :] / density - np.pi
    x, z = np.cos(latitude) * np.sin(longitude), -np.cos(latitude) * np.cos(longitude)
    y = np.sin(latitude) * np.ones_like(longitude)
    shape = (rows, columns)
    blotches = mottle(shape, 0.4 * density, 0.02 * density, generator)
    strands = mottle((rows, 4 * columns), 0.3 * density, 0.02 * density, generator)[:, ::4]
    picture = np.asarray(palette.skin * (1 + 0.03 * blotches[..., None]))
    front = (z < 0.2).astype(np.float64)
    right = np.abs(x)

    def cover(amount: Array, paint: Array) -> None:
        picture[...] += (front * amount)[..., None] * (paint - picture)

    skin, dark = palette.skin, 0.25 * palette.skin + 8
    lips = skin * np.array([0.60, 0.54, 0.78])
    cover(0.35 * _spot(right - 0.42, y + 0.02, 0.22, 0.13), 0.55 * skin)  # eyes lie deep
    cover(0.20 * _spot(right - 0.55, y - 0.35, 0.22, 0.16), skin * np.array([0.85, 0.85, 1.05]))  # cheeks
    cover(0.30 * _spot(x, y - 0.86, 0.30, 0.08), 0.7 * skin)  # below the lower lip
    cover(0.45 * _spot(right - 0.17, y - 0.24, 0.05, 0.18), 0.68 * skin)  # beside the nose
    arch = -0.17 - 0.3 * (right - 0.2) * (0.68 - right)
    brow = _inside(0.045 - 0.05 * (right - 0.2) - np.abs(y - arch)) * _inside(0.24 - np.abs(right - 0.44))
    cover(0.8 * brow, palette.hair * (1 + 0.15 * strands[..., None]))
    opening = 1 - ((right - 0.42) / 0.19) ** 2
    eye = _inside(0.058 * opening - np.abs(y + 0.01)) * _inside(0.19 - np.abs(right - 0.42))
    cover(eye, np.array([205.0, 210.0, 215.0]))
    iris = np.hypot((right - 0.42) / 1.45, y + 0.012)
    cover(eye * _inside(0.06 - iris), np.array([60.0, 60.0, 55.0]))
    cover(eye * _inside(0.028 - iris), np.array([12.0, 12.0, 12.0]))
    lid = _inside(0.016 - np.abs(y + 0.01 + 0.058 * np.clip(opening, 0, 1))) * _inside(
        0.2 - np.abs(right - 0.42)
    )
    cover(0.85 * lid, dark)
    cover(0.8 * _spot(right - 0.085, y - 0.365, 0.05, 0.025), dark)  # nostrils
    bow = 0.08 * (1 - (x / 0.36) ** 2)
    cover(0.9 * _inside(bow - np.abs(y - 0.61)) * _inside(0.36 - right), lips)
    cover(0.85 * _inside(0.02 - np.abs(y - 0.605)) * _inside(0.34 - right), dark)
    if generator.random() < 0.25:  # glasses
        rim = np.abs(np.hypot((right - 0.42) / 1.5, y - 0.03) - 0.16)
        bridge = _inside(0.018 - np.abs(y)) * _inside(0.19 - right)
        temple = _inside(0.018 - np.abs(y)) * _inside(right - 0.66)
        cover(
            0.85 * np.maximum(_inside(0.018 - rim), np.maximum(bridge, temple)), np.array([45.0, 42.0, 40.0])
        )
    beard = 0.75 * _inside(y - 0.42 + 0.1 * right) * (generator.random() < 0.2)
    beard = beard * (1 - _inside(0.1 - np.abs(y - 0.61)) * _inside(0.3 - right))
    cover(beard, palette.hair * (1 + 0.2 * strands[..., None]))
    hair = hairiness(palette, x + 0.04 * strands, y + 0.03 * strands, z)
    picture += hair[..., None] * (palette.hair * (1 + 0.25 * strands[..., None]) - picture)
    return np.asarray(np.clip(picture, 4, 250), np.float32)


def _spot(x: Array, y: Array, wide: float, high: float) -> Array:
    """A smooth spot of height 1."""
    spot: Array = np.exp(-((x / wide) ** 2) - (y / high) ** 2)
    return spot


Canvas = NDArray[np.uint8]

SHIFT = 4  # fractional bits of the corners' coordinates


def paint_background(
    size: tuple[int, int], palette: Palette, clutter: float, generator: np.random.Generator
) -> Pixels:
    """Paint the room behind the signer, `(height, width, 3)`; with `clutter` 0 a plain wall."""
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
    """Draw a colour, BGR, near that of skin."""
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

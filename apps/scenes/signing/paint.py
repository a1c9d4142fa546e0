"""What a signer is made of: skin, hair, a face and cloth, colour pictures from random numbers."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ..random_fields import mottle

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

TONES = np.array(
    [[140, 168, 218], [118, 150, 208], [98, 134, 190], [70, 104, 158], [50, 74, 116]], np.float64
)
"""Skin of people under full light, BGR."""


class Palette:
    """Colours of a scene, BGR grey levels, by its random numbers."""

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
    """A random colour that is no skin's, BGR, of value in a range and saturation up to `most`."""
    hue = generator.uniform(35, 160)  # of OpenCV's 180; red and orange are skin's
    saturation = 255 * most * generator.uniform(0.05, 1) ** 1.5
    pixel = np.array([[[hue, saturation, generator.uniform(*values)]]]).round().astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0], np.float64)


def paint_cloth(side: int, base: Array, generator: np.random.Generator) -> Pixels:
    """Cloth of a colour `base`, `(side, 2 side, 3)`: plain, striped or chequered, with folds."""
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
    """Skin of a colour `base`, `(side, side, 3)`."""
    blotches = 0.035 * mottle((side, side), 25.0, 1.0, generator)
    redness = 0.02 * mottle((side, side), 40.0, 6.0, generator)
    light = 1 + blotches[..., None] + redness[..., None] * np.array([-1.0, -1.0, 1.0])
    return np.asarray(light * base, np.float32)


def hairiness(palette: Palette, x: Array, y: Array, z: Array) -> Array:
    """Share of hair, 0 to 1, at places of the unit sphere of a head: y is down, z away from the face."""
    back = z + 0.15 - 0.25 * np.clip(-y, 0, 1)
    side = np.minimum(back, 1.5 * (palette.hair_end - y))
    top = 0.8 * (palette.hair_line + 0.25 * x**2 - y)
    hair: Array = _inside(np.maximum(side, top), 0.05)
    return hair


def paint_head(density: float, palette: Palette, generator: np.random.Generator) -> Pixels:
    """Skin, hair and what a face has, by longitude and latitude, `density` texels a rad.

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


def _inside(distance: Array, soft: float = 0.015) -> Array:
    """1 where `distance` from an outline is positive, 0 outside, smooth over `soft`."""
    inside: Array = 0.5 * (1 + np.tanh(distance / soft))
    return inside


def _spot(x: Array, y: Array, wide: float, high: float) -> Array:
    """A smooth spot of height 1."""
    spot: Array = np.exp(-((x / wide) ** 2) - (y / high) ** 2)
    return spot

"""Grey pictures from random numbers: the skin of a face, unrolled, and the room behind it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.face.built_in_model import HALF_HEIGHT, HALF_WIDTH, RIM, front_view, on_shield
from .random_fields import mottle

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

SKIN = 140.0
"""Mean grey level of the skin under full light."""
WALL = 115.0
"""Mean grey level of the room."""
MARGIN = 1.03
"""Extent of a skin's picture, in extents of the surface."""


def skin_texels(plane: Array, density: float) -> Array:
    """Column and row in a skin's picture of points `(n, 2)` of `face_plane`, at `density` texels a unit."""
    corner = MARGIN * RIM * np.array([HALF_WIDTH, HALF_HEIGHT])
    texels: Array = (plane + corner) * density
    return texels


def paint_skin(density: float, contrast: float, generator: np.random.Generator) -> Pixels:
    """Albedo of a face as grey levels under full light, `density` texels a unit of `face_plane`.

    Blotches of all sizes, freckles, and what everybody has: brows, eyes, nostrils, lips and hair. `contrast`
    scales all differences from `SKIN`.
    """
    columns, rows = np.ceil(2 * skin_texels(np.zeros((1, 2)), density)[0]).astype(int) + 1
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) / density
    plane = grid - MARGIN * RIM * np.array([HALF_WIDTH, HALF_HEIGHT])
    x, y = np.moveaxis(front_view(plane), -1, 0)
    shape = (int(rows), int(columns))

    blotches = mottle(shape, 0.5 * density, 0.018 * density, generator)
    hairs = mottle(shape, 0.06 * density, 0.018 * density, generator)
    picture = (11.0 * blotches + _freckles(shape, density, generator)).astype(np.float64)
    right = np.abs(x)

    def cover(amount: Array, grey: Array | Pixels | float) -> None:
        picture[...] += amount * (grey - SKIN - picture)

    arch = -0.35 - 0.35 * (right - 0.10) * (0.42 - right)
    brow = _inside(0.042 - 0.06 * (right - 0.1) - np.abs(y - arch)) * _inside(0.2 - np.abs(right - 0.3))
    cover(0.85 * brow, 55 + 14 * hairs)
    opening = 1 - ((right - 0.285) / 0.135) ** 2
    lid = -0.14 + 0.005 - 0.065 * opening
    open_eye = _inside(opening * 0.055 - np.abs(y + 0.14)) * _inside(0.135 - np.abs(right - 0.285))
    cover(open_eye, 195.0)
    from_iris = np.hypot(right - 0.285, y + 0.142)
    cover(open_eye * _inside(0.058 - from_iris), 85 + 10 * hairs)
    cover(open_eye * _inside(0.026 - from_iris), 25.0)
    lashes = _inside(0.018 - np.abs(y - lid)) * _inside(0.145 - np.abs(right - 0.285))
    cover(0.8 * lashes, 45.0)
    cover(0.8 * _inside(0.035 - np.hypot((right - 0.06) / 1.3, y - 0.235)), 45.0)  # nostrils
    bow = 0.075 * (1 - (x / 0.26) ** 2) + 0.012 * np.cos(x / 0.045) * np.exp(-((x / 0.12) ** 2))
    cover(0.9 * _inside(bow - np.abs(y - 0.475)) * _inside(0.25 - right), 98 + 6 * hairs)
    cover(0.85 * _inside(0.014 - np.abs(y - 0.47 - 0.012 * np.cos(x / 0.05))) * _inside(0.25 - right), 45.0)
    hair_line = -0.80 + 0.35 * x**2 + 0.02 * hairs
    cover(0.9 * _inside(hair_line - y, 0.03), 62 + 16 * hairs)
    shield = on_shield(plane.reshape(-1, 2)).reshape(shape)
    picture[shield] = (3.0 * blotches + 40 * np.sign(np.sin(plane @ (50.0, 35.0))) - 30)[shield]
    return np.asarray(np.clip(SKIN + contrast * picture, 8, 245), np.float32)


def paint_room(size: tuple[int, int], contrast: float, generator: np.random.Generator) -> Pixels:
    """What is behind the face, `(height, width)`: a wall with boxes, some of them striped like books."""
    width, height = size
    unit = height / 240
    picture = 14.0 * mottle((height, width), 60 * unit, 1.2 * unit, generator)
    for _ in range(34):
        left, top = generator.uniform(-0.1, 1, 2) * size
        wide, high = generator.uniform(12, 70, 2) * unit
        box = (
            slice(max(0, int(top)), max(0, int(top + high))),
            slice(max(0, int(left)), max(0, int(left + wide))),
        )
        grey, share = generator.normal(0, 38), 0.75
        if generator.random() < 0.4:
            stripe = max(2, round(generator.uniform(3, 9) * unit))
            stripes = generator.normal(0, 32, width // stripe + 2).repeat(stripe)[:width]
            picture[box] += share * (grey + stripes[box[1]][None, :] - picture[box])
        else:
            picture[box] += share * (grey - picture[box])
    soft = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7 * unit), np.float32)
    return np.asarray(np.clip(WALL + contrast * soft, 8, 245), np.float32)


def _inside(distance: Array, soft: float = 0.012) -> Array:
    """1 where `distance` from an outline is positive, 0 outside, smooth over `soft`."""
    inside: Array = 0.5 * (1 + np.tanh(distance / soft))
    return inside


def _freckles(shape: tuple[int, int], density: float, generator: np.random.Generator) -> Pixels:
    """Dark spots of three sizes, `(rows, columns)`, 0 or below."""
    freckles = np.zeros(shape, np.float32)
    for size in np.array([0.014, 0.022, 0.034]) * density:
        points = np.zeros(shape, np.float32)
        rows, columns = generator.uniform(0.12, 0.88, (2, 40)) * np.array(shape)[:, None]
        points[rows.astype(int), columns.astype(int)] = -generator.uniform(15, 55, 40)
        # a single point of weight 2 pi size^2 becomes a spot of height 1
        freckles += 2 * np.pi * size**2 * np.asarray(cv2.GaussianBlur(points, (0, 0), size), np.float32)
    return freckles

"""Appearance of a signer and the room: colours, textures and the lamp, and surfaces drawn with them."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ..rendering_kernels import FARTHEST, draw_mesh
from .paint import Palette, paint_cloth, paint_head, paint_skin
from .room import paint_background
from .shape import Solid

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

SAMPLES = 2  # of a pixel, across and down
AMBIENT = 0.45  # share of the light that has no direction
BRIGHTEST = 1.12  # light on what faces the lamp
GLARE = np.array([236.0, 240.0, 242.0])  # BGR of blown-out skin


@dataclass(frozen=True, eq=False)
class Appearance:
    """Everything that a scene is painted with.

    Parameters
    ----------
    seed
        of colours and patterns.
    size
        `(width, height)` px.
    head_height
        px.
    clutter
        see `signer`.
    """

    seed: int
    size: tuple[int, int]
    head_height: float
    clutter: float

    @cached_property
    def palette(self) -> Palette:
        """The scene's colours."""
        return Palette(np.random.default_rng([self.seed, 2]))

    def draw(self, solids: Iterable[tuple[Solid, str]]) -> Pixels:
        """`(height, width, 3)` grey levels under full light: solids of materials in front of the room."""
        colours = self._room.copy()
        depths = np.full(colours.shape[:2], FARTHEST, np.float32)
        for solid, material in solids:
            density = self._head_density if material == "head" else 1.0
            # sample k of a pixel lies at (k - (SAMPLES - 1) / 2) / SAMPLES from its centre
            places = solid.places.copy()
            places[:, :2] = (places[:, :2] + 0.5) * SAMPLES - 0.5
            shade = np.maximum(0.15 + 0.85 * (solid.normals @ self._lamp), 0)
            light = AMBIENT + (BRIGHTEST - AMBIENT) * shade
            attributes = np.column_stack([density * solid.texels, light])
            facing = solid.normals[:, 2] < 0.2
            seen = solid.triangles[facing[solid.triangles].any(axis=1)]
            draw_mesh(colours, depths, places, attributes, seen, self._textures[material])
        return np.asarray(cv2.resize(colours, self.size, interpolation=cv2.INTER_AREA), np.float32)

    @cached_property
    def _room(self) -> Pixels:
        """The room in samples."""
        room = paint_background(self.size, self.palette, self.clutter, np.random.default_rng([self.seed, 5]))
        return np.ascontiguousarray(room.repeat(SAMPLES, axis=0).repeat(SAMPLES, axis=1))

    @cached_property
    def _textures(self) -> dict[str, Pixels]:
        """By material, a texel a px but for the head."""
        generator = np.random.default_rng([self.seed, 6])
        palette, side = self.palette, int(np.ceil(4 * self.head_height))
        top = paint_cloth(side, palette.top, generator)
        return {
            "head": paint_head(self._head_density, palette, generator),
            "skin": paint_skin(side, palette.skin, generator),
            "top": top,
            "trousers": paint_cloth(side, palette.trousers, generator),
            "glove": np.float32(0.6) * top,
            "glare": paint_skin(side, GLARE, generator),
        }

    @property
    def _head_density(self) -> float:
        """Texels a rad of the head's picture."""
        return 0.75 * self.head_height

    @cached_property
    def _lamp(self) -> Array:
        """`(3,)` unit vector towards the lamp."""
        generator = np.random.default_rng([self.seed, 8])
        azimuth, elevation = generator.uniform(-0.9, 0.9), generator.uniform(0.3, 0.9)
        across, towards = np.sin(azimuth), np.cos(azimuth)
        return np.array([across * np.cos(elevation), -np.sin(elevation), -towards * np.cos(elevation)])

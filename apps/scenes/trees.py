"""Trees that wave in the wind before a wall, and later a person who walks in front of them."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from .random_fields import Array, wander
from .street import Scene
from .street_actors import Layer
from .street_ground import Mask, Pixels, mottle

CROWNS = ((0.22, 0.3, 0.26, 0.3), (0.75, 0.26, 0.3, 0.27))
"""Middle and half axes of the crowns, shares of the picture's width and height."""


@dataclass(frozen=True, eq=False)
class Trees(Scene):
    """The scene; build it with `waving_trees`, which explains the parameters."""

    sway: float = 0.012

    @cached_property
    def _ground(self) -> Pixels:
        return paint_garden(self.size, np.random.default_rng([self.seed, 0]))

    @cached_property
    def leaves(self) -> Mask:
        """`(height, width)` bool: where there are leaves at rest."""
        width, height = self.size
        across, down = np.meshgrid(np.arange(width) / width, np.arange(height) / height)
        ragged = 0.2 * mottle(self.size, 0.05 * height, np.random.default_rng([self.seed, 6]))
        inside = [((across - x) / a) ** 2 + ((down - y) / b) ** 2 + ragged < 1 for x, y, a, b in CROWNS]
        return np.asarray(inside[0] | inside[1])

    @cached_property
    def _foliage(self) -> Pixels:
        """`(height, width, 4)`: leaves, light and dark, and how much they cover."""
        generator = np.random.default_rng([self.seed, 7])
        unit = self.size[1] / 240
        shade = np.tanh(1.2 * mottle(self.size, 7 * unit, generator))[..., None]
        leaves = np.array((48, 104, 84), np.float32) + np.array((36, 58, 52), np.float32) * shade
        cover = cv2.GaussianBlur(self.leaves.astype(np.float32), (0, 0), unit)
        return np.dstack([leaves, cover]).astype(np.float32)

    @cached_property
    def _wind(self) -> tuple[Array, Array]:
        """What moves the leaves: places `(12, 2, height, width)` and times `(12, n_frames)`."""
        generator = np.random.default_rng([self.seed, 5])
        times = np.arange(self.n_frames, dtype=np.float64) * self.dt
        fields = [mottle(self.size, 0.15 * self.size[1], generator) for _ in range(24)]
        soft = [cv2.GaussianBlur(field, (0, 0), 0.06 * self.size[1]) for field in fields]
        places = np.stack([field / field.std() for field in soft]).reshape(12, 2, *fields[0].shape)
        waves = np.stack([wander(times, (0.5, 3.0), generator) for _ in range(12)])
        gusts = 0.6 + 0.4 * wander(times, (4.0, 15.0), generator)
        return places, waves * np.abs(gusts) / np.sqrt(12)

    def _layers(self, index: int) -> tuple[Layer, Layer]:
        height = self.size[1]
        _, feet, walked, gait = self._visit(index)
        person = self._figure.posed(feet, 0.9 * height, walked, gait, index * self.dt)
        return Layer(np.zeros((1, 1, 4), np.float32), 0, 0), person

    def _composed(self, index: int) -> Pixels:
        width, height = self.size
        places, waves = self._wind
        shift = self.sway * width * np.tensordot(waves[:, index], places, axes=1).astype(np.float32)
        across, down = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
        moved = cv2.remap(
            self._foliage, across + shift[0], down + 0.5 * shift[1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT_101,
        )  # fmt: skip
        cover = moved[..., 3:]
        picture: Pixels = self._ground * (1 - cover) + moved[..., :3] * cover
        self._layers(index)[1].paint(picture)
        return picture


def waving_trees(
    n_frames: int = 600,
    seed: int = 0,
    size: tuple[int, int] = (320, 240),
    *,
    enter: int = 400,
    sway: float = 0.012,
    noise: float = 3.0,
) -> Trees:
    """Trees wave, in gusts; a person walks through the picture later, partly before their leaves.

    Parameters
    ----------
    n_frames, seed, size, enter, noise
        as of `sleeping_man`; the person does not stop.
    sway
        standard deviation of the leaves' displacement to the side in an ordinary wind, a share of the width.

    Raises
    ------
    ValueError
        as `sleeping_man`.
    """
    return Trees(n_frames, seed, size, 0, enter, n_frames, None, 0.0, noise, clouds=False, sway=sway)


def paint_garden(size: tuple[int, int], generator: np.random.Generator) -> Pixels:
    """`(height, width, 3)` float32: sky, a wall, a lawn."""
    width, height = size
    picture = np.empty((height, width, 3), np.float32)
    for top, bottom, colour, rough, grain in (
        (0.0, 0.45, (216, 204, 190), 3, 20),
        (0.45, 0.72, (120, 134, 150), 9, 5),
        (0.72, 1.0, (70, 116, 96), 12, 3),
    ):
        rows = slice(round(top * height), round(bottom * height))
        texture = rough * mottle((width, rows.stop - rows.start), grain * height / 240, generator)
        picture[rows] = np.array(colour, np.float32) + texture[..., None]
    return picture

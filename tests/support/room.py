"""A room: a man who stands still before shelves and a dark door, with a soft shadow and a reflection."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from rsmcm.apps.scenes.street import Layer, Pixels, Scene, mottle

SKIRTING = 0.80
"""Share of the height at which the floor begins."""

GLOSS = (0.62, 0.14, 0.92, 0.74)
"""Left, top, right, bottom of a shiny door, shares of the picture."""


@dataclass(frozen=True, eq=False)
class Room(Scene):
    """The room; build it with `standing_in_a_room`, which explains the parameters."""

    shadow: float = 0.35
    reflection: float = 0.4

    @property
    def _body(self) -> float:
        return 0.78 * self.size[1]

    @cached_property
    def _ground(self) -> Pixels:
        return paint_room(self.size, np.random.default_rng([self.seed, 0]))

    def _layers(self, index: int) -> tuple[Layer, Layer]:
        height = self.size[1]
        _, feet, walked, gait = self._visit(index)
        person = self._figure.posed(feet, 0.95 * height, walked, gait, index * self.dt)
        return Layer(np.zeros((1, 1, 4), np.float32), 0, 0), person

    def _composed(self, index: int) -> Pixels:
        picture = self._ground.copy()
        width, height = self.size
        _, person = self._layers(index)
        own = np.zeros((height, width, 4), np.float32)
        _laid(own, person)
        soft = 0.04 * height
        shade = _moved(own[..., 3], -0.1 * height, 0.03 * height)
        picture *= 1 - self.shadow * cv2.GaussianBlur(shade, (0, 0), soft)[..., None]
        mirrored = self.reflection * self._mirrored(own)
        picture *= 1 - mirrored[..., 3:]
        picture += mirrored[..., :3]
        person.paint(picture)
        return picture

    def _mirrored(self, own: Pixels) -> Pixels:
        """What floor and shiny door show of the person, `(height, width, 4)`, premultiplied."""
        height, width = own.shape[:2]
        feet = round(0.95 * height)
        out = np.zeros_like(own)
        below = own[2 * feet - height : feet][::-1]
        out[feet:] = below * np.linspace(1, 0.3, len(below), dtype=np.float32)[:, None, None]
        left, top, right, bottom = (
            round(share * length) for share, length in zip(GLOSS, (width, height) * 2, strict=True)
        )
        beside = _moved(own, 0.26 * width, -0.04 * height)
        out[top:bottom, left:right] = beside[top:bottom, left:right]
        return np.asarray(cv2.GaussianBlur(out, (0, 0), 0.008 * height), np.float32)


def standing_in_a_room(
    n_frames: int = 1400,
    seed: int = 0,
    size: tuple[int, int] = (320, 240),
    *,
    stand: int = 1100,
    enter: int = 40,
    shadow: float = 0.35,
    reflection: float = 0.4,
    light_drift: float = 0.03,
    noise: float = 3.0,
) -> Room:
    """A person walks into a room, stands almost still, and walks out; only the person is foreground.

    The shadow on the wall is soft and moves with the person; floor and a door beside show a reflection. The
    trousers have nearly the colour of the door behind them.

    Parameters
    ----------
    n_frames, seed, size, stand, enter, light_drift, noise
        as of `sleeping_man`.
    shadow
        share of the light that the shadow takes at most.
    reflection
        share of the person's colour in what floor and door show.

    Raises
    ------
    ValueError
        as `sleeping_man`.
    """
    return Room(
        n_frames, seed, size, stand=stand, enter=enter, car_leaves=n_frames, light_drift=light_drift,
        noise=noise, shadow=shadow, reflection=reflection,
    )  # fmt: skip


def paint_room(size: tuple[int, int], generator: np.random.Generator) -> Pixels:
    """`(height, width, 3)` float32: plaster, shelves with books, a dark door, a shiny one, boards."""
    width, height = size
    unit = height / 240
    picture = np.empty((height, width, 3), np.float32)

    def part(left: float, top: float, right: float, bottom: float) -> Pixels:
        rows = slice(round(top * height), round(bottom * height))
        return picture[rows, round(left * width) : round(right * width)]

    def fill(piece: Pixels, colour: tuple[int, int, int], rough: float, grain: float) -> None:
        texture = rough * mottle((piece.shape[1], piece.shape[0]), grain * unit, generator)
        piece[:] = np.array(colour, np.float32) + texture[..., None]

    fill(part(0, 0, 1, SKIRTING), (172, 180, 186), 5, 6)
    shelves = part(0.18, 0.12, 0.42, SKIRTING)
    fill(shelves, (58, 74, 96), 6, 4)
    board = round(26 * unit)
    for y in range(0, shelves.shape[0] - board, board):
        x = 2
        while x < shelves.shape[1] - 8 * unit:
            thick, tall = (round(unit * generator.uniform(*span)) for span in ((3, 7), (15, 22)))
            spine = shelves[y + board - tall : y + board - 2, x : x + thick]
            fill(spine, tuple(generator.integers(40, 190, 3).tolist()), 6, 2)
            x += thick + 1
    fill(part(0.42, 0.3, 0.58, SKIRTING), (96, 84, 80), 8, 5)  # as dark as the trousers
    left, top, right, bottom = GLOSS
    gloss = part(left, top, right, bottom)
    fill(gloss, (120, 138, 150), 3, 12)
    gloss[:2] = gloss[-2:] = gloss[:, :2] = gloss[:, -2:] = 70
    floor = part(0, SKIRTING, 1, 1)
    fill(floor, (92, 120, 146), 7, 3)
    for y in range(0, floor.shape[0], max(4, round(9 * unit))):
        floor[y : y + 1] -= 30
    lens = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.6 * max(unit, 0.5)), np.float32)
    return np.asarray(np.clip(lens, 12, 240), np.float32)


def _laid(out: Pixels, layer: Layer) -> None:
    """Put a layer's patch into an empty picture `(height, width, 4)`."""
    shift = np.array([[1, 0, layer.left], [0, 1, layer.top]], np.float32)
    cv2.warpAffine(layer.patch, shift, (out.shape[1], out.shape[0]), dst=out)


def _moved(picture: Pixels, right: float, down: float) -> Pixels:
    shift = np.array([[1, 0, right], [0, 1, down]], np.float32)
    return np.asarray(cv2.warpAffine(picture, shift, (picture.shape[1], picture.shape[0])), np.float32)

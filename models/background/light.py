"""The light of a frame: a smooth field over the picture, followed where the empty scene can be seen."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .kernels.gaussian import Light
from .kernels.light import interpolate, light_ratios

Planes = NDArray[np.float32]

FASTEST_LIGHT = 1.25
"""Log of the most that light changes in a second; a lamp that is switched takes a few frames."""

STEADY_LIGHT, LIGHT_TIME = 0.02, 0.2
"""Log of a change below which it may be noise, and s, the time constant with which it is followed then."""

LEAST_AGREEMENT = 0.3
"""Share of a block's samples that must change by one factor; else something stands there that is new."""

WINDOW_WEIGHT, OWN_WEIGHT = 1.0, 0.05
"""In blocks: what the next wider window counts in a window, and what all of them count in a block itself."""


@short_repr
@dataclass(frozen=True, eq=False)
class LightField:
    """How bright the scene is lit now, relative to the picture that is remembered, on a grid of blocks.

    Parameters
    ----------
    blocks
        `(block_rows, block_columns)` float32, 1 where the light is as it was.
    size
        `(height, width)` px of the picture.
    """

    blocks: Planes
    size: tuple[int, int]

    @cached_property
    def along_rows(self) -> Light:
        """The field interpolated along x at the blocks' centres, and where between them each row lies."""
        left, share = _neighbours(self.size[1], self.blocks.shape[1])
        rows: Planes = np.empty((self.blocks.shape[0] + 1, self.size[1]), np.float32)
        interpolate(self.blocks, left, share, rows)
        return Light(rows, _positions(self.size[0], self.blocks.shape[0]))


@lru_cache(maxsize=16)
def _positions(n_pixels: int, n_blocks: int) -> Planes:
    """Where between the centres of blocks the centres of pixels lie, `(n_pixels,)` float32."""
    position = (np.arange(n_pixels) + 0.5) * n_blocks / n_pixels - 0.5
    return np.clip(position, 0, n_blocks - 1).astype(np.float32)


@lru_cache(maxsize=16)
def _neighbours(n_pixels: int, n_blocks: int) -> tuple[NDArray[np.intp], Planes]:
    """The block left of every pixel, and the share of the one right of it."""
    position = _positions(n_pixels, n_blocks)
    left = np.minimum(position.astype(np.intp), n_blocks - 2)
    return left, (position - left).astype(np.float32)


def followed(
    before: LightField, image: NDArray[np.uint8], mean: Planes, covered: Planes, elapsed: float
) -> LightField:
    """Light of a frame: smooth, and moved only by what most of a neighbourhood agrees on.

    Objects change the ratio of seen to predicted brightness too. A block behind known ones speaks only if it
    shows the scene's texture nevertheless; else it takes the change of those around it, over windows as wide
    as it needs, and nothing from itself. A new object would have to fill most of three by three blocks with
    one and the same factor.

    Parameters
    ----------
    before
        of the frame before.
    image
        uint8 `(height, width[, 3])`.
    mean
        `(channels, n_pixels)` float32, the empty scene.
    covered
        `(block_rows, block_columns)` share of the block behind known objects.
    elapsed
        s since the frame before.
    """
    ratios, agreement, texture = (np.empty_like(before.blocks) for _ in range(3))
    flat = np.ascontiguousarray(image).reshape(-1)
    light_ratios(flat, mean, before.along_rows, ratios, agreement, texture)
    weight = np.where(agreement > LEAST_AGREEMENT, agreement, 0.0) * _seen(covered, texture)
    change = _filled(np.log(ratios), weight)
    smooth = _blurred(
        cv2.medianBlur(cv2.copyMakeBorder(change, 1, 1, 1, 1, cv2.BORDER_REFLECT_101), 3)[1:-1, 1:-1]
    )
    fastest = FASTEST_LIGHT * elapsed
    follow = np.where(np.abs(smooth) > STEADY_LIGHT, 1.0, -math.expm1(-elapsed / LIGHT_TIME))
    smooth = np.clip(smooth, -fastest, fastest)
    blocks: Planes = np.clip(before.blocks * np.exp(follow * smooth), 0.1, 10.0).astype(np.float32)
    return LightField(blocks, before.size)


def _seen(covered: Planes, texture: Planes) -> NDArray[np.float64]:
    """Probability that a block shows the empty scene: by what is known to be there, and by its texture."""
    clear = np.clip((1 - covered.astype(np.float64)) ** 4, 1e-3, 1 - 1e-3)
    odds: NDArray[np.float64] = np.log(clear) - np.log1p(-clear) + texture
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def _filled(change: NDArray[Any], weight: NDArray[Any]) -> Planes:
    """Normalised convolution over narrowing windows: where the weight is small, what is around counts."""
    weighed, counted = (array.astype(np.float32) for array in (change * weight, weight))
    filled: NDArray[Any] = np.full(change.shape, weighed.sum() / (counted.sum() + 1), np.float32)
    sides = [2 ** (k + 1) + 1 for k in range(math.ceil(math.log2(max(change.shape))))]
    for side in (*reversed(sides), 1):
        window = {"ksize": (side, side), "normalize": False, "borderType": cv2.BORDER_CONSTANT}
        around = WINDOW_WEIGHT if side > 1 else OWN_WEIGHT
        filled = (cv2.boxFilter(weighed, -1, **window) + around * filled) / (
            cv2.boxFilter(counted, -1, **window) + around
        )
    return np.asarray(filled, np.float32)


def _blurred(blocks: NDArray[Any]) -> Planes:
    return np.asarray(
        cv2.blur(blocks.astype(np.float32), (3, 3), borderType=cv2.BORDER_REFLECT_101), np.float32
    )


def light_grid(height: int, width: int) -> tuple[int, int]:
    """Blocks of light over a picture: 24 along its longer side, at least two each way."""
    block = max(height, width) / 24
    return max(round(height / block), 2), max(round(width / block), 2)


def share_of_blocks(covered: NDArray[np.uint8], grid: tuple[int, ...]) -> Planes:
    """Share of every block of light that is covered: `(height, width)` uint8, 255 where it is."""
    share = cv2.resize(covered[::4, ::4], grid[::-1], interpolation=cv2.INTER_AREA)
    return share.astype(np.float32) / np.float32(255)

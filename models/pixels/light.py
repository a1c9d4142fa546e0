"""The light of a frame: a smooth field over the picture, followed where the empty scene can be seen."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.threads import over_bands
from .kernels.gaussian import Light
from .kernels.light import Following, follow, interpolate, light_ratios, share_covered

Planes = NDArray[np.float32]

FASTEST_LIGHT = 1.25
"""Log of the most that light changes in a second; a lamp that is switched takes a few frames."""

STEADY_LIGHT, LIGHT_TIME = 0.02, 0.2
"""Log of a change below which it may be noise, and s, the time constant with which it is followed then."""

UNSEEN = 1e-5
"""Probability at most that a block all behind objects shows the empty scene, before its texture is looked at.

What it leaks must be small against `OWN_WEIGHT`, for an object may stay for as long as it likes."""

DARKEST, BRIGHTEST = 0.1, 10.0
"""Light relative to that of the remembered picture; beyond there is nothing to be seen."""

LEAST_AGREEMENT = 0.3
"""Share of a block's samples that must change by one factor; else something stands there that is new."""

SAME_LIGHT = 0.05
"""Log of a ratio within which a block agrees with the light that its neighbourhood has."""

HIDDEN_TIME = 1.0
"""s in which the light of a block that is not seen, or disagrees, becomes that of the blocks around it."""

SAMPLED = 4
"""px between those of which the covered share of a block is counted."""

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
        """The field along x at the blocks' centres, and where between them each row lies.

        There is one more block on every side, as the slope of the logarithm goes on.
        """
        left, share = _neighbours(self.size[1], self.blocks.shape[1])
        rows: Planes = np.empty((len(self.blocks) + 2, self.size[1]), np.float32)
        interpolate(self.blocks, left, share, DARKEST, BRIGHTEST, rows)
        return Light(rows, _positions(self.size[0], self.blocks.shape[0]))


@lru_cache(maxsize=16)
def _positions(n_pixels: int, n_blocks: int) -> Planes:
    """Where the centres of pixels lie between those of blocks, `(n_pixels,)`; block 0 is before the first."""
    return ((np.arange(n_pixels) + 0.5) * n_blocks / n_pixels + 0.5).astype(np.float32)


@lru_cache(maxsize=16)
def _neighbours(n_pixels: int, n_blocks: int) -> tuple[NDArray[np.intp], Planes]:
    """The block left of every pixel, and the share of the one right of it."""
    position = _positions(n_pixels, n_blocks)
    left = position.astype(np.intp)
    return left, (position - left).astype(np.float32)


def followed(
    before: LightField, image: NDArray[np.uint8], mean: NDArray[np.int16], covered: Planes, elapsed: float
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
        `(channels, n_pixels)` int16, the empty scene (see `Gaussians`).
    covered
        `(block_rows, block_columns)` share of the block behind known objects.
    elapsed
        s since the frame before.
    """
    ratios, agreement, texture = (np.empty_like(before.blocks) for _ in range(3))
    flat = np.ascontiguousarray(image).reshape(-1)
    light = before.along_rows  # made before the threads ask for it

    def work(first: int, end: int) -> None:
        light_ratios(first, end, flat, mean, light, ratios, agreement, texture)

    over_bands(work, len(before.blocks))
    rule = Following(
        FASTEST_LIGHT * elapsed, STEADY_LIGHT, -math.expm1(-elapsed / LIGHT_TIME),
        -math.expm1(-elapsed / HIDDEN_TIME), SAME_LIGHT, LEAST_AGREEMENT, UNSEEN, WINDOW_WEIGHT, OWN_WEIGHT,
        DARKEST, BRIGHTEST,
    )  # fmt: skip
    blocks: Planes = np.empty_like(before.blocks)
    follow(before.blocks, ratios, agreement, texture, covered, rule, blocks)
    return LightField(blocks, before.size)


def light_grid(height: int, width: int) -> tuple[int, int]:
    """Blocks of light over a picture: 24 along its longer side, at least two each way."""
    block = max(height, width) / 24
    return max(round(height / block), 2), max(round(width / block), 2)


def share_of_blocks(covered: NDArray[np.uint8], grid: tuple[int, ...]) -> Planes:
    """Share of every block of light that is covered: `(height, width)` uint8, 255 where it is."""
    shares: Planes = np.zeros(grid, np.float32)
    share_covered(
        covered, min(SAMPLED, *(max(n // m, 1) for n, m in zip(covered.shape, grid, strict=True))), shares
    )
    return shares

"""Loops over the boxes of objects: layers composed front to back."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, exponential, logarithm

_f4 = np.float32

LEAST_CLEAR = 1e-3

_LEAST = _f4(1e-30)  # of a product of many layers; the logarithm wants normal numbers


class Sprite(NamedTuple):
    """An object's mask `(height, width)` and colours `(channels, height, width)`, all float32.

    A pixel that it covers shows its colour with the density, relative to the uniform one, exp(log_ratio -
    half_precision d^2) in a share 1 - outliers of all cases; without channels every colour is alike.
    """

    mask: NDArray[np.float32]
    appearance: NDArray[np.float32]
    half_precision: np.float32
    log_ratio: np.float32
    outliers: np.float32


@compiled
def colour_distance(patch, top, left, appearance, row, first, end, out):
    """Squared distance of one row of a patch from an appearance placed at `(top, left)` in it."""
    for x in range(first, end):
        out[x] = _f4(0)
    for channel in range(appearance.shape[0]):
        seen = patch[channel, top + row, left + first : left + end]
        expected = appearance[channel, row, first:end]
        part = out[first:end]
        for x in range(end - first):
            difference = seen[x] - expected[x]
            part[x] += difference * difference


@compiled
def compose_layer(clear, explained, patch, top, left, sprite, strength, ghost):
    """Put one layer behind those already composed.

    `(top, left)` is the place of its mask in the region; parts outside the region are left out.
    """
    mask, appearance, half_precision = sprite.mask, sprite.appearance, sprite.half_precision
    log_ratio, outliers = sprite.log_ratio, sprite.outliers
    height, width = clear.shape
    first, end = max(0, -left), min(mask.shape[1], width - left)
    distance = np.zeros(mask.shape[1], np.float32)
    inlying = _f4(1.0) - outliers
    for row in range(max(0, -top), min(mask.shape[0], height - top)):
        colour_distance(patch, top, left, appearance, row, first, end, distance)
        covers = mask[row, first:end]
        away = distance[first:end]
        free = clear[top + row, left + first : left + end]
        weight = explained[top + row, left + first : left + end]
        if ghost:
            for x in range(end - first):
                weight[x] *= _f4(1.0) - _f4(0.998) * covers[x] * free[x]
        else:
            for x in range(end - first):
                density = inlying * exponential(log_ratio - half_precision * away[x]) + outliers
                weight[x] += strength * free[x] * covers[x] * density
                free[x] *= max(_f4(1.0) - covers[x], _f4(LEAST_CLEAR))


@compiled
def shift_of(clear, explained, shift):
    """Log ratio of what layers say for background and for objects."""
    for row in range(clear.shape[0]):
        free, weight, out = clear[row], explained[row], shift[row]
        for x in range(clear.shape[1]):
            out[x] = logarithm(max(free[x], _LEAST)) - logarithm(max(weight[x], _LEAST))

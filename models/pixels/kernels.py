"""Loops over pixels that every chain needs: layers of objects composed front to back, runs of foreground."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import compiled, exponential, inlined, logarithm

Planes = NDArray[np.float32]

_f4 = np.float32

LEAST_CLEAR = 1e-3

_LEAST = _f4(1e-30)  # of a product of many layers; the logarithm wants normal numbers


LAYER = np.dtype(
    [
        *((name, np.int64) for name in ("top", "left", "rows", "columns", "start", "coloured", "ghost")),
        *((name, np.float64) for name in ("spread", "log_ratio", "outliers", "strength")),
    ]
)
"""A layer as loops over pixels need it: see `models.pixels.layers.Layer`.

Its mask begins at `start` of those of all layers, its colours, if it is `coloured`, at `channels * start`;
with `log_ratio` the density of its own colour is relative to the uniform one.
"""

ODDS_STEPS = 20.0
"""Steps of the stored log odds per nat; they saturate at +-6 nats."""

SPAN = 64
"""Pixels that are looked at together for whether any of them needs more than most pixels do."""

_SIGNS = np.uint64(0x8080808080808080)


class Pools(NamedTuple):
    """Pixels of all layers, float32: `(n,)` of masks, and `(channels * n,)` of colours, plane by plane."""

    masks: NDArray[np.float32]
    colours: NDArray[np.float32]


class Composition(NamedTuple):
    """Layers, composed in regions that are apart; elsewhere they say nothing.

    `boxes` `(n, 4)` are the regions' top, left, height, width px in the picture. Their pixels follow each
    other, from `starts` `(n,)` on, in flat float32 maps: `clear`, the weight of B=1; `explained`, that of B=0
    with this pixel's colour, relative to "anything" alone; `shift`, the log of their ratio.
    """

    boxes: NDArray[np.int64]
    starts: NDArray[np.int64]
    clear: NDArray[np.float32]
    explained: NDArray[np.float32]
    shift: NDArray[np.float32]


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
def apart(layers, size, frames, members):
    """Boxes of layers that overlap, or whose common frame overlaps others, in one frame; frames are apart.

    Writes the frames' top, left, bottom, right px inside of a picture of `size` into `frames` `(n, 4)`, and
    into `members` `(n,)` in which frame each layer is, -1 where it is none in the picture. Gives how many
    frames there are.
    """
    count = 0
    for k in range(layers.size):
        layer = layers[k]
        top, left, bottom, right = layer.top, layer.left, layer.top + layer.rows, layer.left + layer.columns
        members[k] = -1
        if top >= size[0] or left >= size[1] or bottom <= 0 or right <= 0:
            continue
        own = count
        members[k], count = own, count + 1
        other = 0
        while other < own:
            its_top, its_left, its_bottom, its_right = frames[other]
            if top < its_bottom and its_top < bottom and left < its_right and its_left < right:
                top, left = min(top, its_top), min(left, its_left)
                bottom, right = max(bottom, its_bottom), max(right, its_right)
                # the last frame but this one takes the place of the one that was swallowed
                frames[other] = frames[own - 1]
                for j in range(k + 1):
                    if members[j] == other or members[j] == own:
                        members[j] = own - 1
                    elif members[j] == own - 1:
                        members[j] = other
                own, count, other = own - 1, count - 1, 0
            else:
                other += 1
        frames[own, 0], frames[own, 1], frames[own, 2], frames[own, 3] = top, left, bottom, right
    for k in range(count):
        frames[k, 0], frames[k, 1] = max(frames[k, 0], 0), max(frames[k, 1], 0)
        frames[k, 2], frames[k, 3] = min(frames[k, 2], size[0]), min(frames[k, 3], size[1])
    return count


@inlined
def _squared_distance(pixels, k, own, j, plane, channels):
    """Of the colour of pixel `k` of a picture from colour `j` of an appearance, whose planes are apart."""
    if channels == 1:
        d0 = _f4(pixels[k]) - own[j]
        return d0 * d0
    b, g, r = _f4(pixels[k]), _f4(pixels[k + np.uint64(1)]), _f4(pixels[k + np.uint64(2)])
    grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
    d0 = grey - own[j]
    d1 = _f4(1.426) * (r - grey) - own[j + plane]
    d2 = _f4(1.128) * (b - grey) - own[j + np.uint64(2) * plane]
    return d0 * d0 + d1 * d1 + d2 * d2


@compiled
def compose(layers, pools, members, image, boxes, starts, clear, explained, distance):
    """Put layers behind each other in their regions, in their order.

    `boxes` `(n, 4)` and `starts` say where regions are (see `Composition`), `members` in which one each layer
    is. Without an `image` `(height, width, channels)`, which has no pixels then, any colour is as likely:
    densities integrate to 1. `distance` has room for the longest row of a layer.
    """
    _, width, channels = image.shape
    pixels, masks, colours = image.reshape(-1), pools.masks, pools.colours
    for k in range(layers.size):
        if members[k] < 0:
            continue
        layer, start = layers[k], starts[members[k]]
        top, left, rows, columns = boxes[members[k]]
        compared = layer.coloured and channels > 0
        half_precision = _f4(0.5 / layer.spread)
        log_ratio = _f4(layer.log_ratio) if compared else _f4(0)
        outliers, strength = _f4(layer.outliers), _f4(layer.strength)
        inlying = _f4(1) - outliers
        first, end = max(left - layer.left, 0), min(layer.columns, left + columns - layer.left)
        count, plane = np.uint64(end - first), np.uint64(layer.rows * layer.columns)
        away = distance[: end - first]
        for row in range(max(top - layer.top, 0), min(layer.rows, top + rows - layer.top)):
            here = layer.start + row * layer.columns + first
            covers = masks[here : here + end - first]
            there = start + (layer.top + row - top) * columns + layer.left + first - left
            free, weight = clear[there : there + end - first], explained[there : there + end - first]
            if layer.ghost:
                for x in range(count):
                    weight[x] *= _f4(1.0) - _f4(0.998) * covers[x] * free[x]
                continue
            if compared:
                shown = np.uint64(channels * ((layer.top + row) * width + layer.left + first))
                own = np.uint64(channels * layer.start + row * layer.columns + first)
                if channels == 3:
                    for x in range(count):
                        seen = shown + np.uint64(3) * x
                        away[x] = _squared_distance(pixels, seen, colours, own + x, plane, 3)
                else:
                    for x in range(count):
                        away[x] = _squared_distance(pixels, shown + x, colours, own + x, plane, 1)
            else:
                away[:] = _f4(0)
            for x in range(count):
                density = inlying * exponential(log_ratio - half_precision * away[x]) + outliers
                weight[x] += strength * free[x] * covers[x] * density
                free[x] *= max(_f4(1.0) - covers[x], _f4(LEAST_CLEAR))


@compiled
def shift_of(clear, explained, shift):
    """Log ratio of what layers say for background and for objects, `(n,)` each."""
    for i in range(clear.size):
        shift[i] = logarithm(max(clear[i], _LEAST)) - logarithm(max(explained[i], _LEAST))


class StoredPlanes(NamedTuple):
    """Colours of a whole picture as they are stored: `values` of so many grey levels (`step`) each.

    `values` is `(channels, height, width)` of any type of numbers, in the planes of `colour`.
    """

    values: NDArray[np.int16] | Planes
    step: np.float32

    def grey_levels(self) -> Planes:
        """`(channels, height, width)` float32."""
        levels: Planes = self.values * self.step
        return levels


@inlined
def _any_negative(words, first):
    """Whether any of the 64 numbers in eight words is negative."""
    signs = np.uint64(0)
    for k in range(8):
        signs |= words[first + k]
    return signs & _SIGNS != np.uint64(0)


@compiled
def foreground_spans(log_odds, spans):
    """Starts of the runs of `SPAN` pixels in which there is foreground; returns how many there are.

    Most of a picture is background, and looking at 64 signs at once costs little more than looking at one.
    """
    words = log_odds[: log_odds.size // 8 * 8].view(np.uint64)
    count = 0
    for start in range(0, log_odds.size, SPAN):
        if start + SPAN > log_odds.size or _any_negative(words, start // 8):
            spans[count] = start
            count += 1
    return count

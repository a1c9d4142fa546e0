"""Loops over the boxes of objects: layers composed front to back, and the background behind them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, exponential, inlined, logarithm
from .gaussian import (
    HIGHEST_NOISE,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    LOWEST_VARIANCE,
    ODDS_STEPS,
    light_beside,
)

_f4 = np.float32

LEAST_CLEAR = 1e-3

REVEALED = 1
"""Among what is covered: others are so sure of background that the picture was taken as it is."""

_LEAST = _f4(1e-30)  # of a product of many layers; the logarithm wants normal numbers


LAYER = np.dtype(
    [
        *((name, np.int64) for name in ("top", "left", "rows", "columns", "start", "coloured", "ghost")),
        *((name, np.float64) for name in ("spread", "log_ratio", "outliers", "strength")),
    ]
)
"""A layer as loops over pixels need it: see `models.background.layers.Layer`.

Its mask begins at `start` of those of all layers, its colours, if it is `coloured`, at `channels * start`;
with `log_ratio` the density of its own colour is relative to the uniform one.
"""


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


@compiled
def update_behind(top, left, shift, patch, log_odds, before, light, model, after, covered):
    """Background of one region again, now with what layers say of it.

    Pixels are weighted by their log odds and `shift`. Where others are sure of background that the
    prediction contradicts, the picture is taken as it is. Where they are sure of an object, in the beginning,
    and it looks as the prediction does, that was learned from the object: the background is unknown there.

    `covered` is 255 where an object is predicted, and `REVEALED` where the picture was taken as it is.
    """
    channels = before.mean.shape[0]
    n_channels = _f4(channels)
    width, columns = light.rows.shape[1], shift.shape[1]
    glow, distance = np.empty(columns, np.float32), np.empty(columns, np.float32)
    steps = np.empty(columns, np.float32)
    for row in range(shift.shape[0]):
        others = shift[row]
        above, below, below_share = light_beside(light, top + row)
        upper, lower = above[left : left + columns], below[left : left + columns]
        for x in range(columns):
            glow[x] = upper[x] + below_share * (lower[x] - upper[x])
            distance[x] = _f4(0)
        here = slice((top + row) * width + left, (top + row) * width + left + columns)
        for channel in range(channels):
            seen, expected = patch[channel, row], before.mean[channel, here]
            for x in range(columns):
                difference = seen[x] - glow[x] * expected[x]
                distance[x] += difference * difference
        odds_here, variance_here, noise_here = log_odds[here], before.variance[here], before.noise[here]
        variance_after, noise_after, covered_after = after.variance[here], after.noise[here], covered[here]
        for x in range(columns):
            # read before any branch: what only one branch reads keeps a loop from being vectorised
            old_variance, old_noise = variance_here[x], noise_here[x]
            odds = _f4(odds_here[x]) * _f4(1 / ODDS_STEPS) + others[x]
            weight = _f4(1) / (_f4(1) + exponential(-min(max(odds, _f4(-30)), _f4(30))))
            wandered = old_variance + model.drift
            total = glow[x] * glow[x] * wandered + old_noise
            revealed = (others[x] > _f4(3)) & (distance[x] > _f4(9) * total)
            gain = glow[x] * wandered / total
            step = weight * gain
            # "was seen" and "was covered" differ by so much there that a mean of both would be neither
            wide = old_variance > _f4(HIGHEST_VARIANCE)
            step = _f4(0) if wide & (weight < _f4(0.5)) else step
            steps[x] = _f4(1) / glow[x] if revealed else step
            per_channel = distance[x] / n_channels
            spread = wandered - step * glow[x] * wandered + step * (gain - step) * per_channel
            objects = (others[x] < _f4(-3)) & (distance[x] < _f4(9) * total)
            unknown = model.unknown_variance if objects else _f4(0)
            highest = max(max(old_variance, unknown), _f4(HIGHEST_VARIANCE))
            spread = min(max(max(spread, unknown), _f4(LOWEST_VARIANCE)), highest)
            variance_after[x] = model.first_variance if revealed else spread
            noisier = old_noise + model.noise_share * weight * (per_channel - total)
            noisier = min(max(noisier, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
            noise_after[x] = old_noise if revealed | wide else noisier
            known = np.uint8(REVEALED) if revealed else np.uint8(0)
            covered_after[x] = np.uint8(255) if others[x] < _f4(-0.5) else known
        for channel in range(channels):
            seen, expected = patch[channel, row], before.mean[channel, here]
            mean_after = after.mean[channel, here]
            for x in range(columns):
                mean_after[x] = expected[x] + steps[x] * (seen[x] - glow[x] * expected[x])

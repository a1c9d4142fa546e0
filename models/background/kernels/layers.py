"""Loops over the boxes of objects: layers composed front to back, and the background behind them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, exponential, logarithm
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

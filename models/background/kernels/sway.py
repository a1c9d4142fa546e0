"""Loops over pixels of a scene that moves to and fro: leaves, water, a flag."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, inlined, logarithm
from .gaussian import ODDS_STEPS, foreground_spans, light_beside

_f4 = np.float32

LEAST_RATE = 0.02
"""Share of a block's pixels that must be moved again and again: less happens by chance."""

SURPRISE = 11.3
"""Squared distance over the variance that a pixel in a hundred exceeds by noise (three channels)."""

SAMPLED = 3
"""px between the pixels of which the rates are learned."""


class Sway(NamedTuple):
    """How often pixels show what is beside them, `(block_rows, block_columns)`, and from how far, px."""

    rates: NDArray[np.float32]
    reach: int


@inlined
def squared_gap(pixels, mean, i, shown, light):
    """Squared distance in the planes of pixel `shown` of a picture from the background of pixel `i`."""
    if mean.shape[0] == 1:
        d0 = _f4(pixels[shown]) - light * mean[0, i]
        return d0 * d0
    b, g, r = _f4(pixels[3 * shown]), _f4(pixels[3 * shown + 1]), _f4(pixels[3 * shown + 2])
    grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
    d0 = grey - light * mean[0, i]
    d1 = _f4(1.426) * (r - grey) - light * mean[1, i]
    d2 = _f4(1.128) * (b - grey) - light * mean[2, i]
    return d0 * d0 + d1 * d1 + d2 * d2


@inlined
def luma_gap(pixels, mean, i, light):
    """Luma of pixel `i` of a picture less that of its background."""
    if mean.shape[0] == 1:
        return _f4(pixels[i]) - light * mean[0, i]
    b, g, r = _f4(pixels[3 * i]), _f4(pixels[3 * i + 1]), _f4(pixels[3 * i + 2])
    return _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r - light * mean[0, i]


@inlined
def _least_gap(pixels, mean, y, x, size, reach, light):
    """The least squared distance of a pixel from the background within `reach` px, on a grid of 7 x 7."""
    height, width = size
    step = max(reach // 3, 1)
    least = _f4(1e30)
    for row in range(max(y - 3 * step, 0), min(y + 3 * step, height - 1) + 1, step):
        for column in range(max(x - 3 * step, 0), min(x + 3 * step, width - 1) + 1, step):
            least = min(least, squared_gap(pixels, mean, row * width + column, y * width + x, light))
    return least


@compiled
def recall_moved(first, end, pixels, before, light_field, model, sway, log_odds):
    """Foreground that shows the background of a place nearby, where such things happen, is background.

    p(I) = rate max_d N(I; m(k + d), noise), d within the reach (a neighbourhood likelihood as Elgammal,
    Harwood and Davis', ECCV 2000). `first` and `end` are rows.
    """
    mean, noise = before.mean, before.noise
    channels, height, width = mean.shape[0], light_field.positions.size, light_field.rows.shape[1]
    block_rows, block_columns = sway.rates.shape
    spans = np.empty((end - first) * width // 64 + 1, np.int64)
    for k in range(foreground_spans(log_odds[first * width : end * width], spans)):
        start = first * width + spans[k]
        for i in range(start, min(start + 64, end * width)):
            y = i // width
            x = i - y * width
            rate = sway.rates[y * block_rows // height, x * block_columns // width]
            if log_odds[i] >= 0 or rate < _f4(LEAST_RATE):
                continue
            upper, lower, below_share = light_beside(light_field, y)
            light = upper[x] + below_share * (lower[x] - upper[x])
            gap = _least_gap(pixels, mean, y, x, (height, width), sway.reach, light)
            spread = noise[i] + light * light * before.variance[i]
            odds = model.log_prior_odds + logarithm(rate)
            odds -= _f4(0.5) * (_f4(channels) * logarithm(spread) + gap / spread)
            log_odds[i] = max(log_odds[i], np.int8(min(max(odds, _f4(-6)), _f4(6)) * _f4(ODDS_STEPS)))


@compiled
def count_moved(pixels, before, light_field, covered, reach, counts):
    """Counts per block, `(block_rows, block_columns, 4)`, of a sample of its pixels.

    Those that nothing covers; those that were moved; and of these the sum of differences in luma from the
    background, and of their sizes. A pixel was moved if its own background does not explain what it shows,
    but that of a place nearby does.
    """
    mean = before.mean
    height, width = light_field.positions.size, light_field.rows.shape[1]
    block_rows, block_columns = counts.shape[:2]
    counts[:] = 0
    for y in range(SAMPLED // 2, height, SAMPLED):
        upper, lower, below_share = light_beside(light_field, y)
        for x in range(SAMPLED // 2, width, SAMPLED):
            i = y * width + x
            if covered[i] != 0:
                continue
            row, column = y * block_rows // height, x * block_columns // width
            counts[row, column, 0] += 1
            light = upper[x] + below_share * (lower[x] - upper[x])
            spread = before.noise[i] + light * light * before.variance[i]
            if squared_gap(pixels, mean, i, i, light) > _f4(SURPRISE) * spread:
                gap = _least_gap(pixels, mean, y, x, (height, width), reach, light)
                if gap < _f4(SURPRISE) * spread:
                    brighter = luma_gap(pixels, mean, i, light)
                    counts[row, column, 1] += 1
                    counts[row, column, 2] += brighter
                    counts[row, column, 3] += abs(brighter)

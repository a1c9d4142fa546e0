"""Loops over specular reflections on horizontal surfaces: floors, tables, water.

Where an object stands on or behind such a surface, a pixel shows the scene and a share of the object in place
of what it mirrors otherwise: the difference from the scene is that of the pixel as far above an axis as this
is below, times the share,

    I(x, y) = B(x, y) + share (I(x, 2 axis - y) - B(x, 2 axis - y)),

as far as what is mirrored otherwise looks like what is behind the object. Axis and share are the most likely
ones of each column of blocks in every frame, on a coarse grid of pixels, against the scene as it is where a
pixel looks so, and any colour where not; a share of `MOST_SHARE` or more means an object that goes on. That
happens by chance, too: a column mirrors if its foreground has done so for most of the time.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, inlined, logarithm
from ...models.pixels.background import ODDS_STEPS, SPAN, blocks_along, foreground_spans
from ...models.pixels.colour import planes_of
from .gaussians import MOST_RECALLED, light_beside, mean_of, noise_of

_f4 = np.float32

FINE = 96  # pixels along the longer side that the axes are looked for on
SHARES = 10  # that are tried, 1 / `SHARES` to 1
MOST_SHARE = 0.6
NOISE, BLURRED = 30.0, 100.0  # squared grey levels: of what is seen, and of what is mirrored besides
STRANGE = -4.0  # nats at least, of a pixel: a surface ends somewhere
LEAST = 2.0  # nats per pixel of foreground below an axis
LEAST_SEEN = 24  # pixels of foreground in three columns of blocks that may tell
MIRROR_TIME = 10.0  # s for which it is remembered
EVERY = 4  # frames of which one is looked at for columns that mirror
LITTLE = 0.2  # share of time for which a column has to show foreground to tell by itself


def mirroring(seen: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which columns of blocks mirror, `(block_columns,)`.

    `seen` `(2, block_columns)` are shares of time in which each had foreground, and an axis. A column is as
    the film, as far as it was not seen itself; of the film one column's time has to be seen.
    """
    asked, found = seen
    usual = found.sum() / (asked.sum() + 1)
    return np.asarray(found + LITTLE * usual > 0.5 * (asked + LITTLE))


def update_mirror(
    seen: NDArray[np.float32], now: NDArray[np.float32], age: float, elapsed: float
) -> NDArray[np.float32]:
    """Return the shares of time after a frame, `elapsed` s after the last; the first was `age` s ago."""
    share = 1 - math.exp(-elapsed / (min(age, MIRROR_TIME) + 1))
    return np.asarray(seen + share * (now - seen), np.float32)


@inlined
def _difference(pixels, mean, light_field, y, x):
    """Planes of what pixel `(y, x)` shows beyond the scene; those that it has not are 0."""
    channels, width = mean.shape[0], light_field.rows.shape[1]
    upper, lower, below_share = light_beside(light_field, y)
    light, i = upper[x] + below_share * (lower[x] - upper[x]), y * width + x
    if channels == 1:
        return _f4(pixels[i]) - light * mean_of(mean[0, i]), _f4(0), _f4(0)
    luma, red, blue = planes_of(pixels[3 * i], pixels[3 * i + 1], pixels[3 * i + 2])
    luma, red = luma - light * mean_of(mean[0, i]), red - light * mean_of(mean[1, i])
    return luma, red, blue - light * mean_of(mean[2, i])


@compiled
def find_axes(pixels, before, light_field, model, log_odds, wanted, axes, shares, seen):
    """Write twice the row of each column's axis into `axes` `(block_columns,)`, -1 for none, and its share.

    It is looked for in those columns of blocks that are `wanted` `(block_columns,)`. `seen` `(2,
    block_columns)` gets 1 where there is enough foreground, and an axis.
    """
    height, width = light_field.positions.size, light_field.rows.shape[1]
    step = max(1, max(height, width) // FINE)
    rows, columns, blocks = height // step, width // step, axes.size
    differences = np.empty((rows, 3), np.float32)
    foreground = np.zeros((columns, rows), np.uint8)
    tables = np.zeros((columns, 2 * rows, SHARES), np.float32)
    asked = np.zeros(columns, np.bool_)
    for block in range(blocks):
        axes[block] = -1
        if wanted[block]:
            asked[max((block - 1) * columns // blocks, 0) : (block + 2) * columns // blocks] = True
    for column in range(columns):
        if not asked[column]:
            continue
        x, count = column * step + step // 2, 0
        for row in range(rows):
            foreground[column, row] = log_odds[(row * step + step // 2) * width + x] < 0
            count += foreground[column, row]
        if count > 2:
            for row in range(rows):
                differences[row] = _difference(pixels, before.mean, light_field, row * step + step // 2, x)
            _weigh_axes(differences, foreground[column], model, before.mean.shape[0], tables[column])
    for block in range(blocks):
        if not wanted[block]:
            continue
        left, right = max((block - 1) * columns // blocks, 0), min((block + 2) * columns // blocks, columns)
        count = 0
        for column in range(left, right):
            for row in range(rows):
                count += foreground[column, row]
        seen[0, block] = count >= LEAST_SEEN
        if count < LEAST_SEEN:
            continue
        top, twice, best = _f4(0), 0, 0
        for each in range(2 * rows):
            for k in range(SHARES):
                total = _f4(0)
                for column in range(left, right):
                    total += tables[column, each, k]
                if total > top:
                    top, twice, best = total, each, k
        below = 0
        for column in range(left, right):
            for row in range(twice // 2 + 1, rows):
                below += foreground[column, row]
        shares[block] = _f4(best + 1) / _f4(SHARES)
        if top > _f4(LEAST) * below and shares[block] < _f4(MOST_SHARE):
            axes[block], seen[1, block] = twice * step + 2 * (step // 2), 1


@compiled
def _weigh_axes(differences, foreground, model, channels, table):
    """Add to `table` `(2 n_rows, SHARES)` nats for axes, at half their row, in one column of pixels."""
    fixed, scale = np.empty(SHARES, np.float32), np.empty(SHARES, np.float32)
    for k in range(SHARES):
        share = _f4(k + 1) / _f4(SHARES)
        variance = _f4(NOISE) + _f4(NOISE + BLURRED) * share * share
        fixed[k], scale[k] = _f4(-0.5) * channels * logarithm(variance), _f4(-0.5) / variance
    any_colour = model.log_prior_odds - model.label_odds
    for up in range(foreground.size):
        if foreground[up] == 0:
            continue
        m0, m1, m2 = differences[up]
        mirrored = m0 * m0 + m1 * m1 + m2 * m2
        for down in range(up + 1, foreground.size):
            d0, d1, d2 = differences[down]
            own, product = d0 * d0 + d1 * d1 + d2 * d2, d0 * m0 + d1 * m1 + d2 * m2
            scene = _f4(0.5) * (channels * logarithm(_f4(NOISE)) + own * _f4(1 / NOISE))
            other = any_colour if foreground[down] else min(any_colour, scene)
            row = table[up + down]
            for k in range(SHARES):
                share = _f4(k + 1) * _f4(1 / SHARES)
                gap = own + share * (share * mirrored - _f4(2) * product)
                row[k] += max(fixed[k] + other + scale[k] * gap, _f4(STRANGE))


@compiled
def recall_mirrored(pixels, before, light_field, model, axes, shares, log_odds, mirrored):
    """Turn foreground that shows the scene and what is above an axis into background.

    `mirrored` `(n_pixels,)` uint8 gets 255 there.
    """
    height, width = light_field.positions.size, light_field.rows.shape[1]
    channels, spans = before.mean.shape[0], np.empty(width // SPAN + 1, np.int64)
    any_colour, blocks = model.log_prior_odds - model.label_odds, blocks_along(width, axes.size)
    for y in range(height):
        odds = log_odds[y * width : (y + 1) * width]
        for span in range(foreground_spans(odds, spans)):
            for x in range(spans[span], min(spans[span] + SPAN, width)):
                block = blocks[x]
                up = axes[block] - y
                if odds[x] >= 0 or not 0 <= up < y or log_odds[up * width + x] >= 0:
                    continue
                share, noise = shares[block], noise_of(before.noise[y * width + x])
                own = _difference(pixels, before.mean, light_field, y, x)
                above = _difference(pixels, before.mean, light_field, up, x)
                gap = _f4(0)
                for k in range(3):
                    gap += (own[k] - share * above[k]) ** 2
                variance = noise + (noise + _f4(BLURRED)) * share * share
                ratio = any_colour - _f4(0.5) * (channels * logarithm(variance) + gap / variance)
                ratio = min(ratio + model.label_odds, _f4(MOST_RECALLED))
                if ratio > 0:
                    odds[x], mirrored[y * width + x] = np.int8(ratio * _f4(ODDS_STEPS)), 255

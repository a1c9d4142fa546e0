"""Blocks of pixels that show what is expected sleep: they are looked at, but not compared, nor learned from.

One row of each block is looked at, another one in every frame. A block is compared if a pixel of that row is
probably foreground, or if neighbours in it differ together from the scene by more than noise; then the blocks
around it are compared too. And each is compared in its turn, so that it is learned from at
all. In all other blocks all pixels are sure background, and their variances grow by the drift, exactly as in
frames without an image. So nothing has to be kept of how long a block has slept.

What wakes a block within two frames, in 96 of 100 cases, is an area of 40 px, four or more rows high and
columns wide, whose luma differs by 12 grey levels.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, inlined, put
from ...models.numerics.threads import over_bands
from ...models.pixels.colour import planes_of
from .gaussians import (
    CERTAIN,
    HIGHEST_VARIANCE,
    MEAN_STEPS,
    NOISE_STEPS,
    SURE,
    VARIANCE_STEPS,
    FastPathThresholds,
    Gaussians,
    Light,
    is_sure,
    light_beside,
    rounding_along,
)

_f4, _i4 = np.float32, np.int32
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)

BLOCK_ROWS, BLOCK_COLUMNS = 8, 32  # px

ROW_STEP = 5  # from the row of a block that is looked at to the next frame's: two leave gaps of 2 and 4

LONGEST_SLEEP = 1.0
"""s after which a block is compared in any case: variances have grown by a sixteenth of the lowest noise."""

LONE = 2.0
"""Nats for foreground of a pixel by which it wakes its block. With less, a lone one is no foreground either:
the pixels around it say more for background."""

RUN, MOST_DEVIATIONS = 4, 4.0
"""So many neighbours in a row wake their block if their mean luma is so far from the scene's; of a thousand
blocks a few are by chance."""

RESTLESS = 0.15
"""Share of blocks that show something unexpected beyond which all are compared: hardly any would sleep, as
those around them do not."""

SHORT_GAP = 6  # blocks: going over them costs no more than ending a loop and beginning it again

WORTH_THREADS = 1 << 21  # bytes of a picture from which on several threads look at it faster

Flags = NDArray[np.uint8]


def blocks_in_turn(size: tuple[int, int], age: float, elapsed: float) -> Flags:
    """Return which blocks are compared in any case, `(block_rows, block_columns)` of 0 and 1: whole rows.

    The scene of `size` `(height, width)` px has been seen for `age` s, the last time `elapsed` s ago.
    """
    height, width = size
    phases = np.arange(-(-height // BLOCK_ROWS)) * 0.6180339887498949 % 1  # neighbours' turns lie far apart
    before, now = (np.floor(since / LONGEST_SLEEP + phases) for since in (age, age + elapsed))
    return np.repeat((now > before).astype(np.uint8)[:, None], -(-width // BLOCK_COLUMNS), axis=1)


def find_awake(
    in_turn: Flags,
    frames: int,
    pixels: NDArray[np.uint8],
    before: Gaussians,
    light: Light,
    thresholds: FastPathThresholds,
) -> Flags:
    """Return the blocks to be compared, those `in_turn` among them, after so many `frames`.

    `pixels` `(n_pixels * channels,)` is the picture, and `before` what was known before it.
    """
    surprised, offset = np.zeros_like(in_turn), ROW_STEP * frames % BLOCK_ROWS

    def look(first: int, end: int) -> None:
        look_at_rows(first, end, offset, pixels, before, light, thresholds, surprised)

    over_bands(look, len(in_turn), worth=pixels.size > WORTH_THREADS)
    if surprised.mean() > RESTLESS:
        return np.ones_like(in_turn)
    awake = in_turn | np.asarray(cv2.dilate(surprised, np.ones((3, 3), np.uint8)), np.uint8)
    close_gaps(awake)
    return awake


@compiled
def close_gaps(awake):
    """Set also the blocks of rows that lie in short gaps."""
    for blocks in awake:
        last = -SHORT_GAP - 1
        for block in range(blocks.size):
            if blocks[block]:
                if block - last <= SHORT_GAP:
                    blocks[last:block] = 1
                last = block


@compiled
def look_at_rows(first, end, offset, pixels, before, light_field, thresholds, surprised):
    """Set which blocks of their rows `first` to `end` show in one row of pixels what is not expected."""
    height, width = light_field.positions.size, light_field.rows.shape[1]
    away, expected = np.zeros(width + RUN - 1, np.float32), np.zeros(width + RUN - 1, np.float32)
    unexpected = np.empty(width, np.int32)
    for row in range(first, end):
        y = min(row * BLOCK_ROWS + offset, height - 1)
        if before.mean.shape[0] == 3:
            _look_at_colour(y, pixels, before, light_field, thresholds, away, expected, unexpected)
        else:
            _look_at_grey(y, pixels, before, light_field, thresholds, away, expected, unexpected)
        for x in range(np.uint64(width)):
            run = away[x] + away[x + _ONE] + away[x + _TWO] + away[x + _THREE]
            noise = expected[x] + expected[x + _ONE] + expected[x + _TWO] + expected[x + _THREE]
            far = run * run * _f4(VARIANCE_STEPS / MOST_DEVIATIONS**2) > noise
            unexpected[x] = _i4(1) if far else unexpected[x]
        for block in range(surprised.shape[1]):
            some = _i4(0)
            for each in unexpected[block * BLOCK_COLUMNS : (block + 1) * BLOCK_COLUMNS]:
                some |= each
            surprised[row, block] = some


@inlined
def _is_foreground(distance, total, known, thresholds, channels):
    """Whether a pixel has more than `LONE` nats for foreground, or is unknown."""
    more = _f4(2 * (CERTAIN + LONE)) / channels  # what the log odds may be below their bound
    background = is_sure(distance - more * total, total, thresholds)
    return _i4(not (background & (known <= _f4(HIGHEST_VARIANCE * VARIANCE_STEPS))))


@compiled
def _look_at_colour(y, pixels, before, light_field, thresholds, away, expected, foreground):
    luma, red, blue = before.mean[0], before.mean[1], before.mean[2]
    variance, noise = before.variance, before.noise
    upper, lower, below_share = light_beside(light_field, y)
    base = np.uint64(y * upper.size)
    for x in range(np.uint64(upper.size)):
        i = base + x
        k = _THREE * i
        c0, c1, c2 = planes_of(pixels[k], pixels[k + _ONE], pixels[k + _TWO])
        light = upper[x] + below_share * (lower[x] - upper[x])
        glow = light * _f4(1 / MEAN_STEPS)
        d0, d1, d2 = c0 - glow * _f4(luma[i]), c1 - glow * _f4(red[i]), c2 - glow * _f4(blue[i])
        distance, known = (d0 * d0 + d1 * d1 + d2 * d2) * _f4(VARIANCE_STEPS / 3), _f4(variance[i])
        total = light * light * (known + thresholds.drift) + _f4(VARIANCE_STEPS / NOISE_STEPS) * _f4(noise[i])
        away[x], expected[x] = d0, total
        foreground[x] = _is_foreground(distance, total, known, thresholds, _f4(3))


@compiled
def _look_at_grey(y, pixels, before, light_field, thresholds, away, expected, foreground):
    luma, variance, noise = before.mean[0], before.variance, before.noise
    upper, lower, below_share = light_beside(light_field, y)
    base = np.uint64(y * upper.size)
    for x in range(np.uint64(upper.size)):
        i = base + x
        light = upper[x] + below_share * (lower[x] - upper[x])
        d0, known = _f4(pixels[i]) - light * _f4(1 / MEAN_STEPS) * _f4(luma[i]), _f4(variance[i])
        distance = d0 * d0 * _f4(VARIANCE_STEPS)
        total = light * light * (known + thresholds.drift) + _f4(VARIANCE_STEPS / NOISE_STEPS) * _f4(noise[i])
        away[x], expected[x] = d0, total
        foreground[x] = _is_foreground(distance, total, known, thresholds, _f4(1))


@compiled
def sleep_through(first, end, left, right, width, before, drift, rounding, after, log_odds):
    """Write what follows for pixels of rows `first` to `end` and columns `left` to `right` that sleep.

    `log_odds` are those of row `first` and what follows it; `drift` is in the steps of variances.
    """
    highest = _f4(HIGHEST_VARIANCE * VARIANCE_STEPS)
    for y in range(first, end):
        here = slice(y * width + left, y * width + right)
        for channel in range(before.mean.shape[0]):
            put(before.mean[channel, here], after.mean[channel, here])
        put(before.noise[here], after.noise[here])
        known, grown = before.variance[here], after.variance[here]
        cut = rounding_along(rounding, y)[left:right]
        odds = log_odds[(y - first) * width + left : (y - first) * width + right]
        for x in range(known.size):
            variance = _f4(known[x])
            grown[x] = np.uint16(_i4(max(min(variance + drift, highest), variance) + cut[x]))
            odds[x] = SURE

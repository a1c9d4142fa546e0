"""Loops over pixels of a scene that moves to and fro: leaves, water, a flag."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, inlined, logarithm
from ...models.pixels.background import ODDS_STEPS, SPAN, blocks_along, foreground_spans
from ...models.pixels.colour import planes_of
from .gaussians import MOST_RECALLED, SURE, Gaussians, Light, light_beside, mean_of, noise_of, variance_of

_f4 = np.float32

LEAST_RATE = 0.02  # share of a block's pixels that must be moved again and again: less happens by chance

SURPRISE = 11.3
"""Squared distance over the variance that a pixel in a hundred exceeds by noise (three channels)."""

SAMPLED = 5  # px between the pixels of which the rates are learned


_FAR = _f4(1e15)  # grey levels from any colour; its square is still finite
_SPAN, _TWO, _THREE, _FOUR, _FIVE = (np.uint64(number) for number in (SPAN, 2, 3, 4, 5))


class Sway(NamedTuple):
    """Rates at which pixels show what is beside them, `(block_rows, block_columns)`, and its distance, px."""

    rates: NDArray[np.float32]
    reach: int


@compiled
def recall_moved(first, pixels, before, light_field, model, sway, log_odds):
    """Turn foreground that shows the background of a place nearby, where things sway, into background.

    p(I) = rate max_d N(I; m(k + d), noise), d within the reach (a neighbourhood likelihood as Elgammal,
    Harwood and Davis', ECCV 2000), on a grid of 7 x 7. `log_odds` are those from row `first` on.
    """
    mean, channels = before.mean, _f4(before.mean.shape[0])
    height, width = light_field.positions.size, light_field.rows.shape[1]
    block_rows, block_columns = sway.rates.shape
    spans, blocks = np.empty(width // SPAN + 1, np.int64), blocks_along(width, block_columns)
    work = np.empty(8 * SPAN + 18 * max(sway.reach // 3, 1), np.float32)
    light, least = work[:SPAN], work[SPAN : 2 * SPAN]
    for row in range(log_odds.size // width):
        y = first + row
        rates = sway.rates[y * block_rows // height]
        if not _any_sways(rates):
            continue
        odds_here = log_odds[row * width : (row + 1) * width]
        for span in range(foreground_spans(odds_here, spans)):
            left, right = spans[span], min(spans[span] + SPAN, width)
            left, right = _swaying_foreground(odds_here, left, right, rates, blocks)
            if left == right:
                continue
            _least_gaps(pixels, mean, y, left, right, sway.reach, light_field, work)
            for x in range(left, right):
                rate, i = rates[blocks[x]], y * width + x
                if odds_here[x] >= 0 or rate < _f4(LEAST_RATE):
                    continue
                glow = light[x - left]
                expected = noise_of(before.noise[i]) + glow * glow * variance_of(before.variance[i])
                odds = model.log_prior_odds + logarithm(rate)
                odds -= _f4(0.5) * (channels * logarithm(expected) + least[x - left] / expected)
                odds_here[x] = max(
                    odds_here[x], np.int8(min(max(odds, _f4(-6)), _f4(MOST_RECALLED)) * _f4(ODDS_STEPS))
                )


@inlined
def _any_sways(rates):
    greatest = _f4(0)
    for k in range(rates.size):
        greatest = max(greatest, rates[k])
    return greatest >= _f4(LEAST_RATE)


@inlined
def _swaying_foreground(log_odds, left, right, rates, blocks):
    """The part of a span that its foreground in swaying blocks lies in; empty where there is none."""
    while left < right and (log_odds[left] >= 0 or rates[blocks[left]] < _f4(LEAST_RATE)):
        left += 1
    while left < right and (log_odds[right - 1] >= 0 or rates[blocks[right - 1]] < _f4(LEAST_RATE)):
        right -= 1
    return left, right


@compiled
def _least_gaps(pixels, mean, y, left, right, reach, light_field, work):
    """The least squared distances of pixels `left` to `right` of a row from what is beside them.

    `work` gets `SPAN` numbers each: the light, the least distances, and the planes of what is seen; then
    planes of one row of the background about the span, far from any colour beyond the picture's edges.
    """
    channels, height, width = mean.shape[0], light_field.positions.size, light_field.rows.shape[1]
    start = y * width + left
    upper, lower, below_share = light_beside(light_field, y)
    for x in range(right - left):
        work[x] = upper[left + x] + below_share * (lower[left + x] - upper[left + x])
        luma, red, blue = _planes_of_pixel(pixels, start + x, channels)
        work[2 * SPAN + x], work[3 * SPAN + x], work[4 * SPAN + x] = luma, red, blue
    work[SPAN : 2 * SPAN] = _FAR * _FAR
    step = max(reach // 3, 1)
    wide = right - left + 6 * step
    begin, end = max(0, 3 * step - left), min(wide, width - left + 3 * step)
    work[5 * SPAN :] = _FAR
    for row in range(max(y - 3 * step, 0), min(y + 3 * step, height - 1) + 1, step):
        there = row * width + left - 3 * step
        for channel in range(channels):
            beside = work[5 * SPAN + channel * (SPAN + 6 * step) :][begin:end]
            stored = mean[channel, there + begin : there + end]
            for x in range(stored.size):
                beside[x] = mean_of(stored[x])
        for aside in range(0, 6 * step + 1, step):
            _nearer(work, np.uint64(aside), np.uint64(SPAN + 6 * step), channels)


@inlined
def _nearer(work, aside, plane, channels):
    """What is nearer to pixels than all before, of the background `aside` px from where its row begins."""
    luma = _SPAN * _FIVE + aside
    if channels == 3:
        red, blue = luma + plane, luma + plane + plane
        for x in range(_SPAN):
            d0 = work[_SPAN * _TWO + x] - work[x] * work[luma + x]
            d1 = work[_SPAN * _THREE + x] - work[x] * work[red + x]
            d2 = work[_SPAN * _FOUR + x] - work[x] * work[blue + x]
            work[_SPAN + x] = min(work[_SPAN + x], d0 * d0 + d1 * d1 + d2 * d2)
    else:
        for x in range(_SPAN):
            d0 = work[_SPAN * _TWO + x] - work[x] * work[luma + x]
            work[_SPAN + x] = min(work[_SPAN + x], d0 * d0)


@compiled
def count_moved(pixels, before, light_field, log_odds, covered, reach, counts):
    """Add to counts per block, `(block_rows, block_columns, 5)`, those of a sample of its pixels.

    Those that nothing covers; those that were moved; of these the sum of differences in luma from the
    background, and of their sizes; and those that no background nearby explains. A pixel was moved if its own
    background does not explain what it shows, but that of a place nearby does; where its own `log_odds` are
    at their bound, its own does.
    """
    mean = before.mean
    size = height, width = light_field.positions.size, light_field.rows.shape[1]
    block_rows, block_columns = counts.shape[:2]
    columns = blocks_along(width, block_columns)
    per_column = np.zeros(block_columns, np.float32)
    for x in range(SAMPLED // 2, width, SAMPLED):
        per_column[columns[x]] += _f4(1)
    for y in range(SAMPLED // 2, height, SAMPLED):
        row = counts[y * block_rows // height]
        for column in range(block_columns):  # numba's own sum of arrays takes two seconds to compile
            row[column, 0] += per_column[column]
        upper, lower, below_share = light_beside(light_field, y)
        for left in range(0, width, SPAN):
            right = min(left + SPAN, width)
            behind = covered[y * width + left : y * width + right]
            sure = _all_alike(log_odds[y * width + left : y * width + right], SURE)
            if sure and _all_alike(behind, np.uint8(0)):
                continue
            for x in range(left + (SAMPLED // 2 - left) % SAMPLED, right, SAMPLED):
                i, block = y * width + x, row[columns[x]]
                if behind[x - left] != 0:
                    block[0] -= 1
                    continue
                if log_odds[i] == SURE:
                    continue
                light = upper[x] + below_share * (lower[x] - upper[x])
                expected = noise_of(before.noise[i]) + light * light * variance_of(before.variance[i])
                shown = _planes_of_pixel(pixels, i, mean.shape[0])
                if _squared_gap(shown, mean, i, light) <= _f4(SURPRISE) * expected:
                    continue
                if _least_gap(shown, mean, y, x, reach, light, size) < _f4(SURPRISE) * expected:
                    brighter = shown[0] - light * mean_of(mean[0, i])
                    block[1] += 1
                    block[2] += brighter
                    block[3] += abs(brighter)
                else:
                    block[4] += 1


@compiled
def learn_rates(counts, rates, share, least_seen, after):
    """Update the rates of blocks by counts in 3 x 3 blocks about each; `share` is that of the frame.

    Leaves change places, some get brighter and some darker; a shade and a person change all one way. About
    half of what passes by looks like something nearby by chance: as much as does not look like anything.
    """
    rows, columns = rates.shape
    for row in range(rows):
        for column in range(columns):
            seen = moved = brighter = changed = strange = _f4(0)
            for k in range(9):
                y, x = row + k // 3 - 1, column + k % 3 - 1
                block = counts[min(max(y, 0), rows - 1), min(max(x, 0), columns - 1)]
                seen, moved = seen + block[0], moved + block[1]
                brighter, changed = brighter + block[2], changed + block[3]
                strange += block[4]
            own = rates[row, column]
            if seen > least_seen:
                now = max(moved - strange, _f4(0)) * (_f4(1) - abs(brighter) / max(changed, _f4(1e-6))) / seen
                own += share * (now - own)
            after[row, column] = own


@inlined
def _all_alike(values, wanted):
    different = np.int32(0)
    for k in range(values.size):
        different += np.int32(values[k] != wanted)
    return different == 0


@inlined
def _planes_of_pixel(pixels, i, channels):
    """Planes of pixel `i` of a picture; those that it has not are 0."""
    if channels == 1:
        return _f4(pixels[i]), _f4(0), _f4(0)
    return planes_of(pixels[3 * i], pixels[3 * i + 1], pixels[3 * i + 2])


@inlined
def _squared_gap(shown, mean, i, light):
    """Squared distance of the planes of a pixel from the background of pixel `i`."""
    d0 = shown[0] - light * mean_of(mean[0, i])
    if mean.shape[0] == 1:
        return d0 * d0
    d1, d2 = shown[1] - light * mean_of(mean[1, i]), shown[2] - light * mean_of(mean[2, i])
    return d0 * d0 + d1 * d1 + d2 * d2


@compiled
def _least_gap(shown, mean, y, x, reach, light, size):
    """As `_least_gaps`, of one pixel."""
    height, width = size
    step = max(reach // 3, 1)
    left, right = x - min(x // step, 3) * step, min(x + 3 * step, width - 1) + 1
    least = _FAR
    for row in range(y - min(y // step, 3) * step, min(y + 3 * step, height - 1) + 1, step):
        there = mean[:, row * width + left : row * width + right : step]
        for k in range(there.shape[1]):
            least = min(least, _squared_gap(shown, there, k, light))
    return least


SWAY_REACH = 0.01  # share of the picture's longer side within which leaves sway

SWAY_TIME = 10.0
"""s for which it is remembered that something swayed: a lull lasts longer than a passer-by."""

CALM_TIME = 0.2
"""s for which it is taken for granted in the beginning that nothing sways.

Shorter than it takes false tracks to form on leaves: of what they cover, nothing is learned.
"""

LEAST_SEEN = 4  # pixels of a block that tell how much of it sways


def sway_reach(size: tuple[int, int]) -> int:
    """Return the px within which the scene of `size` `(height, width)` sways."""
    return max(math.ceil(SWAY_REACH * max(size)), 3)


def update_rates(
    sway: Sway,
    pixels: NDArray[np.uint8],
    before: Gaussians,
    light: Light,
    log_odds: NDArray[np.int8],
    covered: NDArray[np.uint8],
    age: float,
    elapsed: float,
) -> NDArray[np.float32]:
    """Return the rates after a frame, `elapsed` s after the last, without `covered` `(n_pixels,)` pixels.

    `log_odds` `(n_pixels,)` int8 are of each pixel by itself; the scene has been seen for `age` s.
    """
    counts = np.zeros((*sway.rates.shape, 5), np.float32)
    count_moved(pixels, before, light, log_odds, covered, sway.reach, counts)
    share = 1 - math.exp(-elapsed / (min(age, SWAY_TIME) + CALM_TIME))
    rates: NDArray[np.float32] = np.empty_like(sway.rates)
    learn_rates(counts, sway.rates, np.float32(share), LEAST_SEEN, rates)
    return rates

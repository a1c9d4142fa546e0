"""Loops over all pixels of the background: flat, planar, float32 within, uint8 in (one pass over the bytes).

What is known of each pixel is `(n_pixels,)` or `(channels, n_pixels)`, 16 bits a number. Log odds are int8 in
steps of `1 / ODDS_STEPS`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, exponential, inlined, logarithm, sigmoid
from ...models.pixels.background import NEVER, ODDS_STEPS
from ...models.pixels.colour import planes_of

Planes = NDArray[np.float32]

_f4, _i4 = np.float32, np.int32


LOWEST_VARIANCE, HIGHEST_VARIANCE = 0.5, 60.0
"""Squared grey levels of a mean that was seen: it always follows a little; beyond, a value is unknown."""

LOWEST_NOISE, HIGHEST_NOISE = 20.0, 400.0
"""Squared grey levels of one observation in each plane: of a quiet sensor, and of a texture that moves."""

MEAN_STEPS, VARIANCE_STEPS, NOISE_STEPS = 32.0, 256.0, 128.0
"""Steps of the stored means per grey level, of variances and noises per squared grey level."""

COARSE_STEPS = 8.0  # steps of a variance beyond `HIGHEST_VARIANCE`, which need not be exact

_COARSE_START = HIGHEST_VARIANCE * (VARIANCE_STEPS / COARSE_STEPS - 1)
"""Where the line of coarse steps crosses that of fine ones at `HIGHEST_VARIANCE`."""

ROUNDING = 65536.0
"""In what is added before a number is cut off to whole steps: none is below 0 then, and 16 bits drop it."""

ROUNDING_PERIOD = 256  # rows of pixels are rounded by one table, each from another place in it
CERTAIN = 6.0  # nats: the bound of the log odds of a pixel by itself
SURE = np.int8(CERTAIN * ODDS_STEPS)  # log odds at their bound, which only a pixel's own Gaussian gives

MOST_RECALLED = 5.95
"""Nats at most, of pixels that are background for another reason: a step less than `SURE`."""


class Gaussians(NamedTuple):
    """Gaussians of all pixels, in 16 bits a number."""

    mean: NDArray[np.int16]  # (channels, n_pixels), in steps of 1 / `MEAN_STEPS` grey levels, to +-1024
    # (n_pixels,), of 1 / `VARIANCE_STEPS`, of 1 / `COARSE_STEPS` beyond `HIGHEST_VARIANCE`
    variance: NDArray[np.uint16]
    # (n_pixels,) of an observation (sensor and scene), in steps of 1 / `NOISE_STEPS`
    noise: NDArray[np.uint16]


class Light(NamedTuple):
    """Today's light relative to that of the mean, interpolated along x."""

    rows: Planes  # (block_rows + 2, width) at the blocks' centres, one more on either side
    positions: Planes  # (height,): where between them each row of pixels lies


class FastPathThresholds(NamedTuple):
    """Thresholds of `is_sure` and `fast_update`, in the steps of the numbers that are stored, all float32.

    Log odds are at their bound of 6 nats where the squared distance does not exceed t (c - channels log t),
    t being its variance. That is concave in t, so that chords are below it: `offset` and `slope` of one that
    ends where the second begins, which ends at `most`. With the probability w of background there, `weight`
    is w, `weights` w (1 - w), `step` w times the steps of means; `noise_share` is times w, too.
    """

    offset: np.float32
    slope: np.float32
    offset_beyond: np.float32
    slope_beyond: np.float32
    most: np.float32
    drift: np.float32
    weight: np.float32
    weights: np.float32
    step: np.float32
    noise_share: np.float32


class PixelModel(NamedTuple):
    """Parameters of the model that all pixels share."""

    log_prior_odds: np.float32  # of background before the image, in the units of the planes
    label_odds: np.float32  # the same where the background may have any colour
    drift: np.float32  # variance that is added to a mean's since the last observation
    noise_share: np.float32  # by which the noise follows what is seen
    first_variance: np.float32  # of a value that was seen once
    unknown_variance: np.float32  # of one that may be that of an object which was there from the first, or 0


@inlined
def light_beside(light, y):
    """Return the rows of the light above and below a row of pixels, and the share of the lower one."""
    above = int(light.positions[y])
    return light.rows[above], light.rows[above + 1], light.positions[y] - _f4(above)


@inlined
def mean_of(steps):
    """Return a stored mean, grey levels."""
    return _f4(steps) * _f4(1 / MEAN_STEPS)


@inlined
def variance_of(steps):
    """Return a stored variance, the higher one of two lines."""
    value = _f4(steps)
    return max(value * _f4(1 / VARIANCE_STEPS), value * _f4(1 / COARSE_STEPS) - _f4(_COARSE_START))


@inlined
def noise_of(steps):
    """Return a stored noise."""
    return _f4(steps) * _f4(1 / NOISE_STEPS)


@inlined
def whole_steps(value, rounding):
    """Return a number of steps, cut off at both ends of the range."""
    steps = _i4(value + rounding) - _i4(ROUNDING)
    return np.int16(min(max(steps, _i4(-32768)), _i4(32767)))


@inlined
def mean_steps(value, rounding):
    """Return a mean to be stored; `rounding` is `ROUNDING` and a number from 0 to 1."""
    return whole_steps(value * _f4(MEAN_STEPS), rounding)


@inlined
def variance_steps(value, rounding):
    """Return a variance to be stored."""
    fine, coarse = value * _f4(VARIANCE_STEPS), (value + _f4(_COARSE_START)) * _f4(COARSE_STEPS)
    return np.uint16(_i4(min(fine, coarse) + rounding))


@inlined
def noise_steps(value, rounding):
    """Return a noise to be stored."""
    return np.uint16(_i4(value * _f4(NOISE_STEPS) + rounding))


@inlined
def rounding_along(rounding, y):
    """Return the offsets for rounding row `y`, of the table for all."""
    return rounding[(37 * y) % ROUNDING_PERIOD :]


@inlined
def is_sure(distance, total, thresholds):
    """Return whether the log odds of background are at their bound; see `FastPathThresholds`."""
    bound = min(
        thresholds.offset + thresholds.slope * total,
        thresholds.offset_beyond + thresholds.slope_beyond * total,
    )
    return (distance <= bound) & (total <= thresholds.most)


@inlined
def posterior(distance, light, variance, noise, model, channels):
    """Return a pixel's log odds of background, step of its mean per grey level, new variance and noise.

    The mean R has prediction N(m, s); seen, it shows I ~ N(light R, noise); covered, it shows anything. The
    posterior is a mixture of "was seen" and "was covered", collapsed by its moments.
    """
    before = variance + model.drift
    total = light * light * before + noise
    precision = _f4(1.0) / total
    odds = model.log_prior_odds - _f4(0.5) * (channels * logarithm(total) + distance * precision)
    # a value that is not known at all may be any colour, as an object's
    odds = odds if variance <= _f4(HIGHEST_VARIANCE) else model.label_odds
    odds = min(max(odds, _f4(-CERTAIN)), _f4(CERTAIN))
    weight = sigmoid(odds)
    gain = light * before * precision
    step = weight * gain
    per_channel = distance * (_f4(1.0) / channels)
    after = before - step * light * before + step * (gain - step) * per_channel
    after = min(max(after, _f4(LOWEST_VARIANCE)), max(variance, _f4(HIGHEST_VARIANCE)))
    # of a value that was not known, an observation tells nothing of the noise
    share = model.noise_share if variance <= _f4(HIGHEST_VARIANCE) else _f4(0)
    noisier = noise + share * weight * (per_channel - total)
    noisier = min(max(noisier, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
    return odds, step, after, noisier


@compiled
def smooth_log_odds(first, end, height, width, log_odds, prior, share, smoothed):
    """Smooth rows `first` to `end`: own log odds and `share` of the 5 x 5 around, saturated as int8."""
    column = np.zeros(width + 4, np.int16)
    bound = np.int16(4 * ODDS_STEPS)
    sums = column[2 : width + 2]
    for row in range(max(first - 2, 0), min(first + 2, height)):
        values = log_odds[row * width : (row + 1) * width]
        for x in range(width):
            sums[x] += min(max(np.int16(np.int16(values[x]) - prior), np.int16(-bound)), bound)
    for y in range(first, end):
        if y + 2 < height:
            values = log_odds[(y + 2) * width : (y + 3) * width]
            for x in range(width):
                sums[x] += min(max(np.int16(np.int16(values[x]) - prior), np.int16(-bound)), bound)
        own, out = log_odds[y * width : (y + 1) * width], smoothed[y * width : (y + 1) * width]
        for x in range(width):
            around = column[x] + column[x + 1] + column[x + 2] + column[x + 3] + column[x + 4]
            total = _f4(own[x]) + share * _f4(np.int32(around))
            out[x] = np.int8(min(max(total, _f4(-127.0)), _f4(127.0)))
        if y >= 2:
            values = log_odds[(y - 2) * width : (y - 1) * width]
            for x in range(width):
                sums[x] -= min(max(np.int16(np.int16(values[x]) - prior), np.int16(-bound)), bound)


@compiled
def log_evidence(pixels, before, light_field, model, shift):
    """Return the sum over pixels of log(exp(log odds + shift) + 1), neither rounded nor saturated.

    In each row, pixels before and after all those that may show background, by their shift, are left out.
    """
    mean = before.mean
    channels, (height, width) = mean.shape[0], (light_field.positions.size, light_field.rows.shape[1])
    distance, light = np.empty(width, np.float32), np.empty(width, np.float32)
    added = np.full(width, shift[0])
    total = 0.0
    for y in range(height):
        row, first, end = slice(y * width, (y + 1) * width), 0, width
        if shift.size > 1:
            own = shift[row]
            while first < end and own[first] <= _f4(NEVER):
                first += 1
            while first < end and own[end - 1] <= _f4(NEVER):
                end -= 1
            for x in range(first, end):
                added[x] = own[x]
        upper, lower, below_share = light_beside(light_field, y)
        shown, luma = pixels[channels * y * width : channels * (y + 1) * width], mean[0, row]
        for x in range(first, end):
            light[x] = upper[x] + below_share * (lower[x] - upper[x])
        if channels == 3:
            red, blue = mean[1, row], mean[2, row]
            for x in range(first, end):
                c0, c1, c2 = planes_of(shown[3 * x], shown[3 * x + 1], shown[3 * x + 2])
                d0 = c0 - light[x] * mean_of(luma[x])
                d1 = c1 - light[x] * mean_of(red[x])
                d2 = c2 - light[x] * mean_of(blue[x])
                distance[x] = d0 * d0 + d1 * d1 + d2 * d2
        else:
            for x in range(first, end):
                d0 = _f4(shown[x]) - light[x] * mean_of(luma[x])
                distance[x] = d0 * d0
        variance, noise = before.variance[row], before.noise[row]
        in_row = _f4(0)
        for x in range(first, end):
            known = variance_of(variance[x])
            expected = light[x] * light[x] * (known + model.drift) + noise_of(noise[x])
            odds = model.log_prior_odds - _f4(0.5) * (
                _f4(channels) * logarithm(expected) + distance[x] / expected
            )
            odds = odds if known <= _f4(HIGHEST_VARIANCE) else model.label_odds
            odds += added[x]
            in_row += max(odds, _f4(0.0)) + logarithm(_f4(1.0) + exponential(-abs(odds)))
        total += in_row
    return total

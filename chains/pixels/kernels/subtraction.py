"""The one pass over the pixels of a frame, band by band: all that an image says of a predicted background.

Most pixels show the background for sure, which takes neither a logarithm nor an exponential; the others are
looked at again.
"""

import numpy as np

from ....models.numerics.compiled import compiled, inlined, put
from ....models.pixels.kernels import ODDS_STEPS, SPAN, foreground_spans
from .gaussian import (
    HIGHEST_NOISE,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    LOWEST_VARIANCE,
    MEAN_STEPS,
    NOISE_STEPS,
    SURE,
    VARIANCE_STEPS,
    Gaussians,
    light_beside,
    mean_of,
    mean_steps,
    noise_of,
    noise_steps,
    posterior,
    rounding_along,
    smooth_log_odds,
    variance_of,
    variance_steps,
    whole_steps,
)
from .second_colours import recall
from .sway import LEAST_RATE, recall_moved

_f4, _i4 = np.float32, np.int32
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)
_SPAN = np.uint64(SPAN)
_ODDS, _PLANES, _VARIANCES, _NOISES = (np.uint64(number * SPAN) for number in (1, 2, 5, 6))

_UNSURE = np.int8(-128)
"""Where the log odds are not known yet."""

_HIGHEST = HIGHEST_VARIANCE * VARIANCE_STEPS

HALO = 2
"""Rows beyond a band that its own log odds depend on."""


BLOCK = 32
"""Rows that are worked on at a time: small enough to stay in the cache."""


@inlined
def usual_update(distance, light, spread, noise, certain):
    """What `posterior` gives where the log odds are at their bound, without its logarithm and exponential.

    Everything is in the steps of the numbers that are stored: `spread`, the variance with the drift, and
    `distance` per channel in those of variances. Gives the step of the mean in theirs per grey level,
    variance and noise to be stored, and whether the log odds are at their bound indeed.
    """
    over = light * spread
    total = light * over + _f4(VARIANCE_STEPS / NOISE_STEPS) * noise
    gain = over / total
    narrower = spread - gain * (certain.weight * over - certain.weights * gain * distance)
    narrower = min(max(narrower, _f4(LOWEST_VARIANCE * VARIANCE_STEPS)), _f4(_HIGHEST))
    noisier = noise + certain.noise_share * (distance - total)
    noisier = min(max(noisier, _f4(LOWEST_NOISE * NOISE_STEPS)), _f4(HIGHEST_NOISE * NOISE_STEPS))
    bound = min(certain.offset + certain.slope * total, certain.offset_beyond + certain.slope_beyond * total)
    sure = (distance <= bound) & (total <= certain.most)
    return certain.step * gain, narrower, noisier, sure


@compiled
def usual_rows_of_colour(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds):
    """Rows `first` to `end` of a colour picture where they show the background for sure.

    Their `log_odds` are `_UNSURE` where they do not; what follows for the Gaussians, in `after` from pixel
    `to` on, holds only where they do. (A loop over rows that is a function of its own keeps the constants of
    the inner one from being spilled: measured once, a third of the time.)
    """
    luma, red, blue = before.mean[0], before.mean[1], before.mean[2]
    new_luma, new_red, new_blue = after.mean[0], after.mean[1], after.mean[2]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        cut = rounding_along(rounding, y)
        own = (y - first) * width
        base, base_after, base_odds = np.uint64(y * width), np.uint64(to + own), np.uint64(own)
        for x in range(np.uint64(width)):
            i, j = base + x, base_after + x
            k = _THREE * i
            b, g, r = _f4(pixels[k]), _f4(pixels[k + _ONE]), _f4(pixels[k + _TWO])
            grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
            light = upper[x] + below_share * (lower[x] - upper[x])
            glow = light * _f4(1 / MEAN_STEPS)
            m0, m1, m2 = _f4(luma[i]), _f4(red[i]), _f4(blue[i])
            d0 = grey - glow * m0
            d1 = _f4(1.426) * (r - grey) - glow * m1
            d2 = _f4(1.128) * (b - grey) - glow * m2
            distance = (d0 * d0 + d1 * d1 + d2 * d2) * _f4(VARIANCE_STEPS / 3)
            known, grain = _f4(variance[i]), _f4(noise[i])
            step, narrower, noisier, sure = usual_update(
                distance, light, known + certain.drift, grain, certain
            )
            new_luma[j] = whole_steps(m0 + step * d0, cut[x])
            new_red[j] = whole_steps(m1 + step * d1, cut[x])
            new_blue[j] = whole_steps(m2 + step * d2, cut[x])
            new_variance[j] = np.uint16(_i4(narrower + cut[x]))
            new_noise[j] = np.uint16(_i4(noisier + cut[x]))
            log_odds[base_odds + x] = SURE if sure & (known <= _f4(_HIGHEST)) else _UNSURE


@compiled
def usual_rows_of_grey(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds):
    """Rows `first` to `end` of a grey picture, as `usual_rows_of_colour`."""
    luma, new_luma = before.mean[0], after.mean[0]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        cut = rounding_along(rounding, y)
        own = (y - first) * width
        base, base_after, base_odds = np.uint64(y * width), np.uint64(to + own), np.uint64(own)
        for x in range(np.uint64(width)):
            i, j = base + x, base_after + x
            light = upper[x] + below_share * (lower[x] - upper[x])
            m0 = _f4(luma[i])
            d0 = _f4(pixels[i]) - light * _f4(1 / MEAN_STEPS) * m0
            known, grain = _f4(variance[i]), _f4(noise[i])
            distance = d0 * d0 * _f4(VARIANCE_STEPS)
            step, narrower, noisier, sure = usual_update(
                distance, light, known + certain.drift, grain, certain
            )
            new_luma[j] = whole_steps(m0 + step * d0, cut[x])
            new_variance[j] = np.uint16(_i4(narrower + cut[x]))
            new_noise[j] = np.uint16(_i4(noisier + cut[x]))
            log_odds[base_odds + x] = SURE if sure & (known <= _f4(_HIGHEST)) else _UNSURE


@compiled
def other_rows(first, end, pixels, before, light_field, model, rounding, to, after, log_odds):
    """Rows `first` to `end` of a picture again, in spans with pixels that do not show background for sure.

    Gives the greatest variance there, as it is stored. A span is worked on in one array of its own: loops
    over many arrays find out first, each time, that they do not overlap.
    """
    channels, width = before.mean.shape[0], light_field.rows.shape[1]
    spans, work = np.empty(width // SPAN + 1, np.int64), np.zeros(8 * SPAN, np.float32)
    most = _i4(0)
    for y in range(first, end):
        own = (y - first) * width
        for k in range(foreground_spans(log_odds[own : own + width], spans)):
            left, right = spans[k], min(spans[k] + SPAN, width)
            start = y * width + left
            _take_in(pixels[channels * start : channels * (y * width + right)], channels, work)
            _take_in_light(light_field, y, left, right, work)
            here = slice(start, y * width + right)
            most = max(most, _take_in_state(before, here, work))
            _posteriors(model, _f4(channels), work)
            there = slice(to + own + left, to + own + right)
            _put_out(work, rounding_along(rounding, y)[left:right], before, here, after, there)
            odds = log_odds[own + left : own + right]
            for x in range(odds.size):
                odds[x] = np.int8(work[_ODDS + np.uint64(x)] * _f4(ODDS_STEPS))
    return most


@compiled
def _take_in(shown, channels, work):
    """Planes of a span of pixels."""
    if channels == 3:
        for x in range(np.uint64(shown.size // 3)):
            k = _THREE * x
            b, g, r = _f4(shown[k]), _f4(shown[k + _ONE]), _f4(shown[k + _TWO])
            grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
            work[_PLANES + x] = grey
            work[_PLANES + _SPAN + x] = _f4(1.426) * (r - grey)
            work[_PLANES + _SPAN + _SPAN + x] = _f4(1.128) * (b - grey)
    else:
        for x in range(np.uint64(shown.size)):
            work[_PLANES + x] = _f4(shown[x])


@compiled
def _take_in_light(light_field, y, left, right, work):
    upper, lower, below_share = light_beside(light_field, y)
    above, below = upper[left:right], lower[left:right]
    for x in range(above.size):
        work[x] = above[x] + below_share * (below[x] - above[x])


@compiled
def _take_in_state(before, here, work):
    """Differences from the means of a span, its variances and noises; gives the greatest variance stored."""
    for channel in range(before.mean.shape[0]):
        mean, seen = before.mean[channel, here], work[(2 + channel) * SPAN : (3 + channel) * SPAN]
        for x in range(mean.size):
            seen[x] -= work[x] * mean_of(mean[x])
    variance, noise = before.variance[here], before.noise[here]
    most = _i4(0)
    for x in range(np.uint64(variance.size)):
        work[_VARIANCES + x] = variance_of(variance[x])
        most = max(most, _i4(variance[x]))
    for x in range(np.uint64(noise.size)):
        work[_NOISES + x] = noise_of(noise[x])
    return most


@compiled
def _posteriors(model, channels, work):
    """Log odds, steps, variances and noises of a whole span."""
    for x in range(_SPAN):
        d0 = work[_PLANES + x]
        d1, d2 = work[_PLANES + _SPAN + x], work[_PLANES + _SPAN + _SPAN + x]
        odds, step, spread, grain = posterior(
            d0 * d0 + d1 * d1 + d2 * d2, work[x], work[_VARIANCES + x], work[_NOISES + x], model, channels
        )
        work[_ODDS + x] = odds
        work[x] = step
        work[_VARIANCES + x] = spread
        work[_NOISES + x] = grain


@compiled
def _put_out(work, cut, before, here, after, there):
    """What follows for the Gaussians of a span."""
    for channel in range(before.mean.shape[0]):
        old, new = before.mean[channel, here], after.mean[channel, there]
        away = work[(2 + channel) * SPAN : (3 + channel) * SPAN]
        for x in range(new.size):
            new[x] = mean_steps(mean_of(old[x]) + work[x] * away[x], cut[x])
    variance, noise = after.variance[there], after.noise[there]
    for x in range(np.uint64(variance.size)):
        variance[x] = variance_steps(work[_VARIANCES + x], cut[x])
    for x in range(np.uint64(noise.size)):
        noise[x] = noise_steps(work[_NOISES + x], cut[x])


@compiled
def subtract(
    first, end, pixels, before, light_field, model, certain, rounding, second, tolerance, sway, prior, share,
    after, log_odds, smoothed,
):  # fmt: skip
    """Rows `first` to `end` of a picture: log odds of background, and the update that they imply.

    `certain` is what pixels need of the `model` that show background for sure, `rounding` what is added to
    numbers before they are cut off. What else a pixel may show and be background is its `second` colour,
    within a tolerance, and what sways. `log_odds` get those of each pixel by itself, `smoothed` those with
    the neighbours' `share` of them, less the `prior` ones (int16, in steps). What rows of other bands add to
    that is worked out again here, so that no band waits for another one.
    """
    channels, (height, width) = before.mean.shape[0], (light_field.positions.size, light_field.rows.shape[1])
    top, bottom = max(first - HALO, 0), min(end + HALO, height)
    own = np.empty((bottom - top) * width, np.int8)
    beyond = Gaussians(
        np.empty((channels, HALO * width), np.int16),
        np.empty(HALO * width, np.uint16),
        np.empty(HALO * width, np.uint16),
    )
    most, start = 0, top
    while start < bottom:
        # one call for all rows: a copy of the loops inside is compiled for each
        is_own = first <= start < end
        if is_own:
            stop, to, updated = min(start + BLOCK, end), start * width, after
        else:
            stop, to, updated = first if start < first else bottom, 0, beyond
        odds = own[(start - top) * width : (stop - top) * width]
        highest = _rows(start, stop, pixels, before, light_field, model, certain, rounding, to, updated, odds)
        most = max(most, highest) if is_own else most
        start = stop
    recall(top * width, pixels, second, tolerance, model, own)
    if sway.rates.max() >= LEAST_RATE:
        recall_moved(top, pixels, before, light_field, model, sway, own)
    put(own[(first - top) * width : (end - top) * width], log_odds[first * width : end * width])
    smooth_log_odds(
        first - top, end - top, bottom - top, width, own, prior, share,
        smoothed[top * width : bottom * width],
    )  # fmt: skip
    if most > HIGHEST_VARIANCE * VARIANCE_STEPS:  # neighbours tell nothing of a value that nobody knows
        for i in range(first * width, end * width):
            if before.variance[i] > HIGHEST_VARIANCE * VARIANCE_STEPS:
                smoothed[i] = np.int8(model.label_odds * np.float32(ODDS_STEPS))


@compiled
def _rows(first, end, pixels, before, light_field, model, certain, rounding, to, after, log_odds):
    """Rows `first` to `end`: their `log_odds`, and the Gaussians `after` them from pixel `to` on."""
    if before.mean.shape[0] == 3:
        usual_rows_of_colour(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds)
    else:
        usual_rows_of_grey(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds)
    return other_rows(first, end, pixels, before, light_field, model, rounding, to, after, log_odds)

"""Loops over pixels that show something else than the scene, and may be background all the same.

Second colours are what a pixel shows when it does not show the scene. Behind layers of objects, others speak
of the labels.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, exponential, logarithm
from ...models.pixels.background import ODDS_STEPS, SPAN, foreground_spans
from ...models.pixels.colour import colour_gap, planes_of
from .gaussians import (
    HIGHEST_NOISE,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    LOWEST_VARIANCE,
    MOST_RECALLED,
    ROUNDING,
    light_beside,
    mean_of,
    mean_steps,
    noise_of,
    noise_steps,
    rounding_along,
    variance_of,
    variance_steps,
)

_f4 = np.float32

SETTLED = 1 << 14  # steps of the settling time: a second colour seen for so long has settled

KNOWN = SETTLED * 3 // 2
"""Steps for what was the scene's colour before: it wears off after a quarter of the settling time."""

REVEALED = 1  # among what is covered: others are so sure of background that the picture was taken as it is


class SecondColours(NamedTuple):
    """Second hypothesis of every pixel."""

    colours: NDArray[np.uint8]  # (n_pixels * channels,)
    seen: NDArray[np.uint16]  # (n_pixels,): share of the settling time, in steps of 1 / `SETTLED`


class Settling(NamedTuple):
    """Parameters by which a second colour takes the mean's place."""

    tolerance: np.float32  # squared grey levels, within which it is the same colour
    step: int  # what one observation adds to the time for which it was seen
    least: int  # the least time
    variance: np.float32  # that it has then
    unsure_variance: np.float32  # a mean of more gives way earlier


@compiled
def recall(first, pixels, second, tolerance, model, log_odds):
    """Turn foreground that shows the second colour of a pixel known to have two into background.

    A colour that was the scene's before counts as the mean does, one that was seen for half the settling time
    just so much that a pixel by itself is background. `log_odds` are those from pixel `first` on.
    """
    channels = second.colours.size // second.seen.size
    variance = tolerance * _f4(0.25) / _f4(channels)  # the tolerance is two standard deviations
    best = model.log_prior_odds - _f4(0.5) * _f4(channels) * logarithm(variance)
    spans = np.empty(log_odds.size // SPAN + 1, np.int64)
    for span in range(foreground_spans(log_odds, spans)):
        for k in range(spans[span], min(spans[span] + SPAN, log_odds.size)):
            i = first + k
            if log_odds[k] >= 0 or 2 * second.seen[i] < SETTLED:
                continue
            gap = colour_gap(pixels, second.colours, i, channels)
            if gap < tolerance:
                known = second.seen[i] >= SETTLED
                odds = best - _f4(0.5) * gap / variance if known else _f4(1)
                log_odds[k] = np.int8(min(max(odds, _f4(1)), _f4(MOST_RECALLED)) * _f4(ODDS_STEPS))


@compiled
def learn_second_colours(
    pixels, log_odds, covered, light_field, to_planes, from_planes, settling, after, second
):
    """Learn second colours of pixels that show neither the background nor a predicted object.

    A colour that lasts changes places with the mean (see `Settling`); another one wears it out twice as fast.
    A mean that was hardly seen itself gives way to one that was seen about twice as often, also behind an
    object: it may only seem to be one because the scene was never seen without what stood there at first.
    """
    mean, variance, candidate, seen = after.mean, after.variance, second.colours, second.seen
    channels, width = mean.shape[0], light_field.rows.shape[1]
    old = np.empty(channels, np.float32)
    nearest = _f4(ROUNDING + 0.5)
    spans = np.empty(log_odds.size // SPAN + 1, np.int64)
    for span in range(foreground_spans(log_odds, spans)):
        for i in range(spans[span], min(spans[span] + SPAN, log_odds.size)):
            unsure = variance_of(variance[i]) > settling.unsure_variance
            if log_odds[i] >= 0 or (covered[i] != 0 and not unsure):
                continue
            if seen[i] == 0 or colour_gap(pixels, candidate, i, channels) >= settling.tolerance:
                if seen[i] > 2 * settling.step:
                    seen[i] -= 2 * settling.step
                else:
                    seen[i] = settling.step
                    for k in range(channels):
                        candidate[channels * i + k] = pixels[channels * i + k]
                continue
            seen[i] += settling.step
            # noise over variance is about how often the mean was seen
            own = settling.least + settling.step * int(
                _f4(2) * noise_of(after.noise[i]) / variance_of(variance[i])
            )
            if seen[i] < (min(SETTLED, own) if unsure else SETTLED):
                continue
            y = i // width
            x = i - y * width
            upper, lower, below_share = light_beside(light_field, y)
            light = upper[x] + below_share * (lower[x] - upper[x])
            for channel in range(channels):
                old[channel] = light * mean_of(mean[channel, i])
                value = _f4(0)
                for k in range(channels):
                    value += to_planes[channel, k] * _f4(pixels[channels * i + k])
                mean[channel, i] = mean_steps(value / light, nearest)
            for channel in range(channels):
                value = _f4(0)
                for k in range(channels):
                    value += from_planes[channel, k] * old[k]
                candidate[channels * i + channel] = np.uint8(min(max(value + _f4(0.5), _f4(0)), _f4(255)))
            variance[i] = variance_steps(settling.variance, nearest)
            seen[i] = 0 if unsure else KNOWN


@compiled
def update_behind(
    regions, shifts, pixels, log_odds, before, light_field, model, rounding, from_planes, after, second,
    covered,
):  # fmt: skip
    """Update the background of some regions again, with what layers say of it.

    Pixels are weighted by their log odds and what is said of them. Where others are sure of background that
    the prediction contradicts, the picture is taken as it is, and what was there before stays the second
    colour: it is background again at once if the verdict was wrong, and it wears off once something else
    lasts there. Where they are sure of an object, in the beginning, and it looks as the prediction does, that
    was learned from the object: the background is unknown there.

    Of each region `regions` `(n, 4)` have top, left, height and width px, and `shifts` in one row after the
    other the log ratio of what layers say for background and for objects. What is `covered` becomes 255 where
    an object is predicted, and `REVEALED` where the picture was taken as it is.
    """
    width = light_field.rows.shape[1]
    start = 0
    for region in range(len(regions)):
        top, left, height, columns = regions[region]
        # light, squared distance, step; then the differences from the prediction in all planes
        work = np.empty((3 + before.mean.shape[0], columns), np.float32)
        for y in range(top, top + height):
            first = y * width + left
            here = slice(first, first + columns)
            others = shifts[start : start + columns]
            start += columns
            upper, lower, below_share = light_beside(light_field, y)
            _differences(pixels, before.mean, first, upper[left:], lower[left:], below_share, work)
            cut = rounding_along(rounding, y)[left:]
            _row_behind(others, log_odds[here], before, here, model, cut, work, after, covered[here])
            for channel in range(before.mean.shape[0]):
                old, new = before.mean[channel, here], after.mean[channel, here]
                step, difference = work[2], work[3 + channel]
                for x in range(columns):
                    new[x] = mean_steps(mean_of(old[x]) + step[x] * difference[x], cut[x])
            for x in range(columns):
                if covered[first + x] == REVEALED:
                    _remember(first + x, work[0, x], before.mean, from_planes, second)


@compiled
def _differences(pixels, mean, first, upper, lower, below_share, work):
    """Light, squared distance and differences of what is seen along a row from what is predicted."""
    channels, columns = mean.shape[0], work.shape[1]
    glow, distance = work[0], work[1]
    shown = pixels[channels * first : channels * (first + columns)]
    for x in range(columns):
        glow[x] = upper[x] + below_share * (lower[x] - upper[x])
        distance[x] = _f4(0)
    if channels == 3:
        luma, red, blue = work[3], work[4], work[5]
        for x in range(columns):
            luma[x], red[x], blue[x] = planes_of(shown[3 * x], shown[3 * x + 1], shown[3 * x + 2])
    else:
        luma = work[3]
        for x in range(columns):
            luma[x] = _f4(shown[x])
    for channel in range(channels):
        difference, expected = work[3 + channel], mean[channel, first : first + columns]
        for x in range(columns):
            difference[x] -= glow[x] * mean_of(expected[x])
            distance[x] += difference[x] * difference[x]


@compiled
def _row_behind(others, log_odds, before, here, model, cut, work, after, covered):
    """Variances and noises along one row, and the step of its means, which `work` gets."""
    glow, distance, steps = work[0], work[1], work[2]
    n_channels = _f4(before.mean.shape[0])
    old_variances, old_noises = before.variance[here], before.noise[here]
    variance_after, noise_after = after.variance[here], after.noise[here]
    for x in range(others.size):
        # read before any branch: what only one branch reads keeps a loop from being vectorised
        old_variance, old_noise = variance_of(old_variances[x]), noise_of(old_noises[x])
        odds = _f4(log_odds[x]) * _f4(1 / ODDS_STEPS) + others[x]
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
        narrower = wandered - step * glow[x] * wandered + step * (gain - step) * per_channel
        objects = (others[x] < _f4(-3)) & (distance[x] < _f4(9) * total)
        unknown = model.unknown_variance if objects else _f4(0)
        highest = max(max(old_variance, unknown), _f4(HIGHEST_VARIANCE))
        narrower = min(max(max(narrower, unknown), _f4(LOWEST_VARIANCE)), highest)
        variance_after[x] = variance_steps(model.first_variance if revealed else narrower, cut[x])
        noisier = old_noise + model.noise_share * weight * (per_channel - total)
        noisier = min(max(noisier, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
        noise_after[x] = noise_steps(old_noise if revealed | wide else noisier, cut[x])
        known = np.uint8(REVEALED) if revealed else np.uint8(0)
        covered[x] = np.uint8(255) if others[x] < _f4(-0.5) else known


@compiled
def _remember(i, light, mean, from_planes, second):
    """What pixel `i` showed is its second colour from now on."""
    channels = mean.shape[0]
    for channel in range(channels):
        value = _f4(0.5)
        for k in range(channels):
            value += from_planes[channel, k] * light * mean_of(mean[k, i])
        second.colours[channels * i + channel] = np.uint8(min(max(value, _f4(0)), _f4(255)))
    second.seen[i] = KNOWN

"""The background behind layers of objects: what a picture says of it where others speak of the labels."""

import numpy as np

from ....models.numerics.compiled import compiled, exponential
from ....models.pixels.kernels.gaussian import (
    HIGHEST_NOISE,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    LOWEST_VARIANCE,
    ODDS_STEPS,
    light_beside,
    mean_of,
    mean_steps,
    noise_of,
    noise_steps,
    rounding_along,
    variance_of,
    variance_steps,
)
from ....models.pixels.kernels.second_colours import KNOWN

_f4 = np.float32

REVEALED = 1
"""Among what is covered: others are so sure of background that the picture was taken as it is."""


@compiled
def update_behind(regions, pixels, log_odds, before, light_field, model, rounding, from_planes, results):
    """Background of some regions again, now with what layers say of it.

    Pixels are weighted by their log odds and what is said of them. Where others are sure of background that
    the prediction contradicts, the picture is taken as it is, and what was there before stays the second
    colour: it is known at once, so that it is background again at once if the verdict was wrong, and it wears
    off as any second colour does once something else lasts there. Where they are sure of an object, in the
    beginning, and it looks as the prediction does, that was learned from the object: the background is
    unknown there.

    Of each of the `regions` boxes `(n, 4)` have top, left, height and width px, and shifts in one row after
    the other the log ratio of what layers say for background and for objects. The `results` are the Gaussians
    and second colours after the frame, and what is covered: it becomes 255 where an object is predicted, and
    `REVEALED` where the picture was taken as it is.
    """
    (boxes, shifts), (after, second, covered) = regions, results
    width = light_field.rows.shape[1]
    start = 0
    for region in range(len(boxes)):
        top, left, height, columns = boxes[region]
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
                old, new, difference = (
                    before.mean[channel, here],
                    after.mean[channel, here],
                    work[3 + channel],
                )
                step = work[2]
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
            b, g, r = _f4(shown[3 * x]), _f4(shown[3 * x + 1]), _f4(shown[3 * x + 2])
            grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
            luma[x] = grey
            red[x] = _f4(1.426) * (r - grey)
            blue[x] = _f4(1.128) * (b - grey)
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
        spread = wandered - step * glow[x] * wandered + step * (gain - step) * per_channel
        objects = (others[x] < _f4(-3)) & (distance[x] < _f4(9) * total)
        unknown = model.unknown_variance if objects else _f4(0)
        highest = max(max(old_variance, unknown), _f4(HIGHEST_VARIANCE))
        spread = min(max(max(spread, unknown), _f4(LOWEST_VARIANCE)), highest)
        variance_after[x] = variance_steps(model.first_variance if revealed else spread, cut[x])
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

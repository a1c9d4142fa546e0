"""Loops over pixels for their second colours: what a pixel shows when it does not show the scene."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, inlined, logarithm
from .gaussian import (
    MOST_RECALLED,
    ODDS_STEPS,
    ROUNDING,
    SPAN,
    foreground_spans,
    light_beside,
    mean_of,
    mean_steps,
    noise_of,
    variance_of,
    variance_steps,
)

_f4 = np.float32

SETTLED = 1 << 14
"""Steps of the settling time: a second colour seen for so long has settled."""

KNOWN = SETTLED * 3 // 2
"""Steps for what was the scene's colour before: it wears off after a quarter of the settling time."""


class SecondColours(NamedTuple):
    """A second hypothesis: `(n_pixels * channels,)` uint8 colours, and for how long each was seen.

    `seen` is `(n_pixels,)` uint16, the share of the settling time in steps of 1 / `SETTLED`.
    """

    colours: NDArray[np.uint8]
    seen: NDArray[np.uint16]


class Settling(NamedTuple):
    """When a second colour takes the mean's place.

    It is the same colour within `tolerance` (squared grey levels); `step` is what one observation adds to the
    time for which it was seen, `least` the least time. It has `variance` then; a mean of more than
    `unsure_variance` gives way earlier.
    """

    tolerance: np.float32
    step: int
    least: int
    variance: np.float32
    unsure_variance: np.float32


@inlined
def colour_gap(pixels, candidate, i, channels):
    """Squared distance in the planes of pixel `i` of a picture and of the candidates."""
    k = channels * i
    if channels == 1:
        d0 = _f4(pixels[k]) - _f4(candidate[k])
        return d0 * d0
    b = _f4(pixels[k]) - _f4(candidate[k])
    g = _f4(pixels[k + 1]) - _f4(candidate[k + 1])
    r = _f4(pixels[k + 2]) - _f4(candidate[k + 2])
    grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
    d1 = _f4(1.426) * (r - grey)
    d2 = _f4(1.128) * (b - grey)
    return grey * grey + d1 * d1 + d2 * d2


@compiled
def recall(first, pixels, second, tolerance, model, log_odds):
    """Foreground that shows the second colour of a pixel known to have two is background after all.

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
    """A second hypothesis for pixels that show neither the background nor a predicted object.

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

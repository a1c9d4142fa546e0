"""Loops over all pixels of the background: flat, planar, float32 within, uint8 in (one pass over the bytes).

What is known of each pixel is `(n_pixels,)` or `(channels, n_pixels)`. Log odds are int8 in steps of
`1 / ODDS_STEPS`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, exponential, inlined, logarithm, sigmoid

_f4 = np.float32
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)

ODDS_STEPS = 20.0
"""Steps of the stored log odds per nat; they saturate at +-6 nats."""

LOWEST_VARIANCE, HIGHEST_VARIANCE = 0.5, 60.0
LOWEST_NOISE, HIGHEST_NOISE = 20.0, 400.0

SETTLED = 1 << 14
"""Steps of the settling time: a second colour seen for so long has settled."""

KNOWN = SETTLED * 3 // 2
"""Steps for what was the scene's colour before: it wears off after a quarter of the settling time."""

_SIGNS = np.uint64(0x8080808080808080)

Planes = NDArray[np.float32]


class Gaussians(NamedTuple):
    """One Gaussian a pixel: `(channels, n_pixels)` mean, `(n_pixels,)` variance of the mean and noise.

    In squared grey levels; the noise is that of a single observation (sensor and scene). All float32.
    """

    mean: Planes
    variance: Planes
    noise: Planes


class Light(NamedTuple):
    """Today's light relative to that of the mean, interpolated along x.

    `rows` `(block_rows + 2, width)` float32 are at the blocks' centres, one more on either side; `positions`
    `(height,)` float32 says where between them each row of pixels lies.
    """

    rows: Planes
    positions: Planes


class PixelModel(NamedTuple):
    """Numbers of the model that all pixels share, float32.

    `log_prior_odds` of background before the image, in the units of the planes, and `label_odds`, the same
    where the background may have any colour; `drift`, the variance that is
    added to a mean's since the last observation; `noise_share`, by which the noise follows what is seen;
    `first_variance` of a value that was seen once; `unknown_variance`, of one that may be that of an object
    which was there from the first frame on, 0 if there can be none any more.
    """

    log_prior_odds: np.float32
    label_odds: np.float32
    drift: np.float32
    noise_share: np.float32
    first_variance: np.float32
    unknown_variance: np.float32


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
def light_beside(light, y):
    """The rows of the light above and below a row of pixels, and the share of the lower one."""
    above = int(light.positions[y])
    return light.rows[above], light.rows[above + 1], light.positions[y] - _f4(above)


@inlined
def posterior(distance, light, variance, noise, model, channels):
    """One pixel's log odds of background, step of its mean per grey level, variance and noise afterwards.

    The mean R has prediction N(m, s); seen, it shows I ~ N(light R, noise); covered, it shows anything. The
    posterior is a mixture of "was seen" and "was covered", collapsed by its moments.
    """
    before = variance + model.drift
    total = light * light * before + noise
    precision = _f4(1.0) / total
    odds = model.log_prior_odds - _f4(0.5) * (channels * logarithm(total) + distance * precision)
    # a value that is not known at all may be any colour, as an object's
    odds = odds if variance <= _f4(HIGHEST_VARIANCE) else model.label_odds
    odds = min(max(odds, _f4(-6.0)), _f4(6.0))
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
def subtract_colour(first, end, pixels, before, light_field, model, after, log_odds):
    """Rows `first` to `end` of a colour picture: log odds of background, and the update that they imply."""
    luma, red, blue = before.mean[0], before.mean[1], before.mean[2]
    new_luma, new_red, new_blue = after.mean[0], after.mean[1], after.mean[2]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        base = np.uint64(y * width)
        for x in range(np.uint64(width)):
            i = base + x
            k = _THREE * i
            b, g, r = _f4(pixels[k]), _f4(pixels[k + _ONE]), _f4(pixels[k + _TWO])
            grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
            light = upper[x] + below_share * (lower[x] - upper[x])
            d0 = grey - light * luma[i]
            d1 = _f4(1.426) * (r - grey) - light * red[i]
            d2 = _f4(1.128) * (b - grey) - light * blue[i]
            distance = d0 * d0 + d1 * d1 + d2 * d2
            odds, step, spread, noisier = posterior(distance, light, variance[i], noise[i], model, _f4(3.0))
            new_luma[i] = luma[i] + step * d0
            new_red[i] = red[i] + step * d1
            new_blue[i] = blue[i] + step * d2
            new_variance[i] = spread
            new_noise[i] = noisier
            log_odds[i] = np.int8(odds * _f4(ODDS_STEPS))


@compiled
def subtract_grey(first, end, pixels, before, light_field, model, after, log_odds):
    """Rows `first` to `end` of a grey picture: log odds of background, and the update that they imply."""
    luma, new_luma = before.mean[0], after.mean[0]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        base = np.uint64(y * width)
        for x in range(np.uint64(width)):
            i = base + x
            light = upper[x] + below_share * (lower[x] - upper[x])
            d0 = _f4(pixels[i]) - light * luma[i]
            odds, step, spread, noisier = posterior(d0 * d0, light, variance[i], noise[i], model, _f4(1.0))
            new_luma[i] = luma[i] + step * d0
            new_variance[i] = spread
            new_noise[i] = noisier
            log_odds[i] = np.int8(odds * _f4(ODDS_STEPS))


@compiled
def smooth_log_odds(first, end, height, width, log_odds, prior, share, smoothed):
    """Rows `first` to `end`: own log odds and `share` of what the 5 x 5 around show, saturated as int8.

    What a pixel shows is its log odds without the `prior` (int16, in the same steps), clipped to 4 nats.
    """
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
    """Sum over pixels of log(exp(log odds + shift) + 1), the log odds neither rounded nor saturated.

    `shift` has one entry a pixel, or a single one for all.
    """
    mean = before.mean
    channels, (height, width) = mean.shape[0], (light_field.positions.size, light_field.rows.shape[1])
    distance, light = np.empty(width, np.float32), np.empty(width, np.float32)
    added = np.full(width, shift[0])
    total = 0.0
    for y in range(height):
        upper, lower, below_share = light_beside(light_field, y)
        row = slice(y * width, (y + 1) * width)
        shown, luma = pixels[channels * y * width : channels * (y + 1) * width], mean[0, row]
        for x in range(width):
            light[x] = upper[x] + below_share * (lower[x] - upper[x])
        if channels == 3:
            red, blue = mean[1, row], mean[2, row]
            for x in range(width):
                b, g, r = _f4(shown[3 * x]), _f4(shown[3 * x + 1]), _f4(shown[3 * x + 2])
                grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                d0 = grey - light[x] * luma[x]
                d1 = _f4(1.426) * (r - grey) - light[x] * red[x]
                d2 = _f4(1.128) * (b - grey) - light[x] * blue[x]
                distance[x] = d0 * d0 + d1 * d1 + d2 * d2
        else:
            for x in range(width):
                d0 = _f4(shown[x]) - light[x] * luma[x]
                distance[x] = d0 * d0
        variance, noise = before.variance[row], before.noise[row]
        if shift.size > 1:
            added[:] = shift[row]
        in_row = _f4(0)
        for x in range(width):
            spread = light[x] * light[x] * (variance[x] + model.drift) + noise[x]
            odds = model.log_prior_odds - _f4(0.5) * (
                _f4(channels) * logarithm(spread) + distance[x] / spread
            )
            odds = odds if variance[x] <= _f4(HIGHEST_VARIANCE) else model.label_odds
            odds += added[x]
            in_row += max(odds, _f4(0.0)) + logarithm(_f4(1.0) + exponential(-abs(odds)))
        total += in_row
    return total


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


@inlined
def _any_negative(words, first):
    """Whether any of the 64 numbers in eight words is negative."""
    signs = np.uint64(0)
    for k in range(8):
        signs |= words[first + k]
    return signs & _SIGNS != np.uint64(0)


@compiled
def foreground_spans(log_odds, spans):
    """Starts of the runs of 64 pixels in which there is foreground; returns how many there are.

    Most of a picture is background, and looking at 64 signs at once costs little more than looking at one.
    """
    words = log_odds[: log_odds.size // 8 * 8].view(np.uint64)
    count = 0
    for start in range(0, log_odds.size, 64):
        if start + 64 > log_odds.size or _any_negative(words, start // 8):
            spans[count] = start
            count += 1
    return count


@compiled
def recall(first, end, pixels, second, tolerance, model, log_odds):
    """Foreground that shows the second colour of a pixel known to have two is background after all.

    A colour that was the scene's before counts as the mean does, one that was seen for half the settling time
    just so much that a pixel by itself is background. `first` and `end` are pixels.
    """
    channels = second.colours.size // second.seen.size
    variance = tolerance * _f4(0.25) / _f4(channels)  # the tolerance is two standard deviations
    best = model.log_prior_odds - _f4(0.5) * _f4(channels) * logarithm(variance)
    spans = np.empty((end - first) // 64 + 1, np.int64)
    for k in range(foreground_spans(log_odds[first:end], spans)):
        start = first + spans[k]
        for i in range(start, min(start + 64, end)):
            if log_odds[i] >= 0 or 2 * second.seen[i] < SETTLED:
                continue
            gap = colour_gap(pixels, second.colours, i, channels)
            if gap < tolerance:
                known = second.seen[i] >= SETTLED
                odds = best - _f4(0.5) * gap / variance if known else _f4(1)
                log_odds[i] = np.int8(min(max(odds, _f4(1)), _f4(6)) * _f4(ODDS_STEPS))


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
    spans = np.empty(log_odds.size // 64 + 1, np.int64)
    for span in range(foreground_spans(log_odds, spans)):
        for i in range(spans[span], min(spans[span] + 64, log_odds.size)):
            unsure = variance[i] > settling.unsure_variance
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
            own = settling.least + settling.step * int(2 * after.noise[i] / variance[i])
            if seen[i] < (min(SETTLED, own) if unsure else SETTLED):
                continue
            y = i // width
            x = i - y * width
            upper, lower, below_share = light_beside(light_field, y)
            light = upper[x] + below_share * (lower[x] - upper[x])
            for channel in range(channels):
                old[channel] = light * mean[channel, i]
                value = _f4(0)
                for k in range(channels):
                    value += to_planes[channel, k] * _f4(pixels[channels * i + k])
                mean[channel, i] = value / light
            for channel in range(channels):
                value = _f4(0)
                for k in range(channels):
                    value += from_planes[channel, k] * old[k]
                candidate[channels * i + channel] = np.uint8(min(max(value + _f4(0.5), _f4(0)), _f4(255)))
            variance[i] = settling.variance
            seen[i] = 0 if unsure else KNOWN

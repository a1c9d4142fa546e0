"""Loops over all pixels of the background: flat, planar, float32 within, uint8 in (one pass over the bytes).

`mean` is `(channels, n_pixels)`, everything else per pixel is `(n_pixels,)`; `light_rows` is the light field at
block rows, already interpolated along x: `(block_rows, width)`. Log odds are int8 in steps of `1 / ODDS_STEPS`.
"""

import math

import numpy as np

from .compiled import compiled, exponential, inlined, logarithm

_f4 = np.float32
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)

ODDS_STEPS = 20.0
"""Steps of the stored log odds per nat; they saturate at +-6 nats."""

LOWEST_VARIANCE, HIGHEST_VARIANCE = 0.5, 60.0
LOWEST_NOISE, HIGHEST_NOISE = 20.0, 400.0


@inlined
def posterior(distance, light, variance, noise, drift, log_prior, channels, rate):  # type: ignore[no-untyped-def]
    """One pixel's log odds of background, step of its mean per grey level, variance and noise afterwards.

    The mean R has prediction N(m, s); seen, it shows I ~ N(light R, noise); covered, it shows anything. The
    posterior is a mixture of "was seen" and "was covered", collapsed by its moments.
    """
    before = variance + drift
    total = light * light * before + noise
    precision = _f4(1.0) / total
    odds = log_prior - _f4(0.5) * (channels * logarithm(total) + distance * precision)
    odds = min(max(odds, _f4(-6.0)), _f4(6.0))
    weight = _f4(1.0) / (_f4(1.0) + exponential(-odds))
    gain = light * before * precision
    step = weight * gain
    per_channel = distance * (_f4(1.0) / channels)
    after = before - step * light * before + step * (gain - step) * per_channel
    after = min(max(after, _f4(LOWEST_VARIANCE)), _f4(HIGHEST_VARIANCE))
    noisier = noise + rate * weight * (per_channel - total)
    noisier = min(max(noisier, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
    return odds, step, after, noisier


@compiled
def subtract_colour(
    first, end, width, pixels, mean, variance, noise, light_rows, row_position, drift, log_prior, rate,
    new_mean, new_variance, new_noise, log_odds,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """Rows `first` to `end` of a colour picture: log odds of background, and the update that they imply."""
    luma, red, blue = mean[0], mean[1], mean[2]
    new_luma, new_red, new_blue = new_mean[0], new_mean[1], new_mean[2]
    for y in range(first, end):
        above = int(row_position[y])
        below_share = row_position[y] - _f4(above)
        upper, lower = light_rows[above], light_rows[above + 1]
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
            odds, step, after, noisier = posterior(
                distance, light, variance[i], noise[i], drift, log_prior, _f4(3.0), rate
            )
            new_luma[i] = luma[i] + step * d0
            new_red[i] = red[i] + step * d1
            new_blue[i] = blue[i] + step * d2
            new_variance[i] = after
            new_noise[i] = noisier
            log_odds[i] = np.int8(odds * _f4(ODDS_STEPS))


@compiled
def subtract_grey(
    first, end, width, pixels, mean, variance, noise, light_rows, row_position, drift, log_prior, rate,
    new_mean, new_variance, new_noise, log_odds,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """Rows `first` to `end` of a grey picture: log odds of background, and the update that they imply."""
    luma, new_luma = mean[0], new_mean[0]
    for y in range(first, end):
        above = int(row_position[y])
        below_share = row_position[y] - _f4(above)
        upper, lower = light_rows[above], light_rows[above + 1]
        base = np.uint64(y * width)
        for x in range(np.uint64(width)):
            i = base + x
            light = upper[x] + below_share * (lower[x] - upper[x])
            d0 = _f4(pixels[i]) - light * luma[i]
            odds, step, after, noisier = posterior(
                d0 * d0, light, variance[i], noise[i], drift, log_prior, _f4(1.0), rate
            )
            new_luma[i] = luma[i] + step * d0
            new_variance[i] = after
            new_noise[i] = noisier
            log_odds[i] = np.int8(odds * _f4(ODDS_STEPS))


@compiled
def pool_log_odds(first, end, height, width, log_odds, prior, share, pooled):  # type: ignore[no-untyped-def]
    """Rows `first` to `end`: own log odds and `share` of what the 5 x 5 pixels around saw, saturated as int8.

    What a pixel saw is its log odds without the `prior` (int16, in the same steps), clipped to 4 nats.
    """
    column = np.empty(width + 4, np.int16)
    bound = np.int16(4 * ODDS_STEPS)
    column[:] = 0
    for y in range(first, end):
        for x in range(width):
            column[x + 2] = 0
        for row in range(max(y - 2, 0), min(y + 3, height)):
            values = log_odds[row * width : (row + 1) * width]
            for x in range(width):
                column[x + 2] += min(max(np.int16(np.int16(values[x]) - prior), -bound), bound)
        own, out = log_odds[y * width : (y + 1) * width], pooled[y * width : (y + 1) * width]
        for x in range(width):
            around = column[x] + column[x + 1] + column[x + 2] + column[x + 3] + column[x + 4]
            total = _f4(own[x]) + share * _f4(around)
            out[x] = np.int8(min(max(total, _f4(-127.0)), _f4(127.0)))


@compiled
def log_evidence_sum(log_odds, shift, step):  # type: ignore[no-untyped-def]
    """Sum over pixels of log(exp(log odds + shift) + 1); `shift` has one entry a pixel, or a single one."""
    total = 0.0
    everywhere = shift.size == 1
    for i in range(log_odds.size):
        odds = _f4(log_odds[i]) * step + (shift[0] if everywhere else shift[i])
        larger = max(odds, _f4(0.0))
        total += larger + logarithm(_f4(1.0) + exponential(-abs(odds)))
    return total


@compiled
def light_ratios(pixels, mean, light_rows, row_position, height, width, ratios, agreement):  # type: ignore[no-untyped-def]
    """Robust brightness of the picture relative to the prediction, per block of the light field.

    A block is sampled on a grid of 6 x 6 pixels. `ratios` gets the median of luma seen over luma predicted,
    `agreement` the share of samples within 5 % of it.
    """
    channels = mean.shape[0]
    block_rows, block_columns = ratios.shape
    values = np.empty(36, np.float32)
    for row in range(block_rows):
        for column in range(block_columns):
            count = 0
            for sample in range(36):
                y = int((row + (sample // 6 + 0.5) / 6.0) * height / block_rows)
                x = int((column + (sample % 6 + 0.5) / 6.0) * width / block_columns)
                i = y * width + x
                if channels == 3:
                    seen = 0.114 * pixels[3 * i] + 0.587 * pixels[3 * i + 1] + 0.299 * pixels[3 * i + 2]
                else:
                    seen = float(pixels[i])
                above = int(row_position[y])
                below_share = row_position[y] - above
                light = light_rows[above, x] + below_share * (light_rows[above + 1, x] - light_rows[above, x])
                expected = light * mean[0, i]
                if expected > 16.0 and 2.0 < seen < 250.0:
                    values[count] = seen / expected
                    count += 1
            if count < 12:
                ratios[row, column] = 1.0
                agreement[row, column] = 0.0
                continue
            part = np.sort(values[:count])
            median = part[count // 2]
            close = 0
            for k in range(count):
                if abs(part[k] - median) < 0.05 * median:
                    close += 1
            ratios[row, column] = median
            agreement[row, column] = close / count


@inlined
def colour_gap(pixels, candidate, i, to_planes):  # type: ignore[no-untyped-def]
    """Squared distance in the planes of pixel `i` of a picture and of the candidates."""
    channels = to_planes.shape[0]
    distance = _f4(0)
    for channel in range(channels):
        difference = _f4(0)
        for k in range(channels):
            step = _f4(pixels[channels * i + k]) - _f4(candidate[channels * i + k])
            difference += to_planes[channel, k] * step
        distance += difference * difference
    return distance


@compiled
def recall(pixels, candidate, seen, trusted_looks, to_planes, tolerance, log_odds):  # type: ignore[no-untyped-def]
    """Foreground that shows the second colour of a pixel which is known to have two is background after all."""
    whole = log_odds.size // 8 * 8
    words = log_odds[:whole].view(np.uint64)
    for start in range(0, log_odds.size, 8):
        if start < whole and words[start // 8] & np.uint64(0x8080808080808080) == np.uint64(0):
            continue
        for i in range(start, min(start + 8, log_odds.size)):
            if log_odds[i] < 0 and seen[i] >= trusted_looks:
                if colour_gap(pixels, candidate, i, to_planes) < tolerance:
                    log_odds[i] = np.int8(ODDS_STEPS)


@compiled
def second_look(
    pixels, log_odds, covered, width, light_rows, row_position, to_planes, from_planes, tolerance, settle_looks,
    settled_variance, mean, variance, candidate, seen,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """A second hypothesis for pixels that show neither the background nor a predicted object.

    A colour that stays for `settle_looks` changes places with the mean. Log odds are looked at eight at a
    time: where all eight are background (no sign bit), nothing else is read.
    """
    channels = mean.shape[0]
    whole = log_odds.size // 8 * 8
    words = log_odds[:whole].view(np.uint64)
    old = np.empty(channels, np.float32)
    for start in range(0, log_odds.size, 8):
        if start < whole and words[start // 8] & np.uint64(0x8080808080808080) == np.uint64(0):
            continue
        for i in range(start, min(start + 8, log_odds.size)):
            if log_odds[i] >= 0 or covered[i] != 0:
                continue
            if seen[i] > 0 and colour_gap(pixels, candidate, i, to_planes) < tolerance:
                seen[i] += 1
            elif seen[i] > 2:
                seen[i] -= 2
            else:
                seen[i] = 1
                for k in range(channels):
                    candidate[channels * i + k] = pixels[channels * i + k]
            if seen[i] < settle_looks:
                continue
            y = i // width
            x = i - y * width
            above = int(row_position[y])
            below_share = row_position[y] - _f4(above)
            light = light_rows[above, x] + below_share * (light_rows[above + 1, x] - light_rows[above, x])
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
            variance[i] = settled_variance
            seen[i] = settle_looks // 2

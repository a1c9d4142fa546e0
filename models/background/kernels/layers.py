"""Loops over the boxes of objects: layers composed front to back, and the background behind them."""

import numpy as np

from ...numerics.compiled import compiled, exponential, logarithm
from .gaussian import HIGHEST_NOISE, HIGHEST_VARIANCE, LOWEST_NOISE, LOWEST_VARIANCE, ODDS_STEPS

_f4 = np.float32

LEAST_CLEAR = 1e-3

_LEAST = _f4(1e-30)  # of a product of many layers; the logarithm wants normal numbers


@compiled
def colour_distance(patch, top, left, appearance, row, first, end, out):
    """Squared distance of one row of a patch from an appearance placed at `(top, left)` in it."""
    for x in range(first, end):
        out[x] = _f4(0)
    for channel in range(appearance.shape[0]):
        seen = patch[channel, top + row, left + first : left + end]
        expected = appearance[channel, row, first:end]
        part = out[first:end]
        for x in range(end - first):
            difference = seen[x] - expected[x]
            part[x] += difference * difference


@compiled
def compose_layer(
    clear, explained, patch, top, left, mask, appearance, half_precision, log_ratio, outliers, strength, ghost
):
    """Put one layer behind those already composed.

    `(top, left)` is the place of its mask in the region; parts outside the region are left out. Without
    appearance (no channels) every colour is equally likely.
    """
    height, width = clear.shape
    first, end = max(0, -left), min(mask.shape[1], width - left)
    distance = np.zeros(mask.shape[1], np.float32)
    inlying = _f4(1.0) - outliers
    for row in range(max(0, -top), min(mask.shape[0], height - top)):
        colour_distance(patch, top, left, appearance, row, first, end, distance)
        covers = mask[row, first:end]
        away = distance[first:end]
        free = clear[top + row, left + first : left + end]
        told = explained[top + row, left + first : left + end]
        if ghost:
            for x in range(end - first):
                told[x] *= _f4(1.0) - _f4(0.998) * covers[x] * free[x]
        else:
            for x in range(end - first):
                density = inlying * exponential(log_ratio - half_precision * away[x]) + outliers
                told[x] += strength * free[x] * covers[x] * density
                free[x] *= max(_f4(1.0) - covers[x], _f4(LEAST_CLEAR))


@compiled
def shift_of(clear, explained, shift):
    """Log ratio of what layers say for background and for objects."""
    for row in range(clear.shape[0]):
        free, told, out = clear[row], explained[row], shift[row]
        for x in range(clear.shape[1]):
            out[x] = logarithm(max(free[x], _LEAST)) - logarithm(max(told[x], _LEAST))


@compiled
def update_behind(
    top, left, shift, width, patch, pooled, mean, variance, noise, light_rows, row_position, drift,
    settled_variance, rate, new_mean, new_variance, new_noise, covered,
):  # fmt: skip
    """Background of one region again, now with what layers say of it.

    Pixels are weighted by their pooled log odds and `shift`. Where others are sure of background that the
    prediction contradicts, the picture is taken as it is. `covered` is 255 where an object is predicted.
    """
    channels = _f4(mean.shape[0])
    columns = shift.shape[1]
    glow, distance = np.empty(columns, np.float32), np.empty(columns, np.float32)
    steps = np.empty(columns, np.float32)
    for row in range(shift.shape[0]):
        told = shift[row]
        above = int(row_position[top + row])
        below_share = row_position[top + row] - _f4(above)
        upper = light_rows[above, left : left + columns]
        lower = light_rows[above + 1, left : left + columns]
        for x in range(columns):
            glow[x] = upper[x] + below_share * (lower[x] - upper[x])
            distance[x] = _f4(0)
        here = slice((top + row) * width + left, (top + row) * width + left + columns)
        for channel in range(mean.shape[0]):
            seen, expected = patch[channel, row], mean[channel, here]
            for x in range(columns):
                difference = seen[x] - glow[x] * expected[x]
                distance[x] += difference * difference
        odds_here, variance_here, noise_here = pooled[here], variance[here], noise[here]
        variance_after, noise_after, covered_after = new_variance[here], new_noise[here], covered[here]
        for x in range(columns):
            # read before any branch: what only one branch reads keeps a loop from being vectorised
            old_variance, old_noise = variance_here[x], noise_here[x]
            odds = _f4(odds_here[x]) * _f4(1 / ODDS_STEPS) + told[x]
            weight = _f4(1) / (_f4(1) + exponential(-min(max(odds, _f4(-30)), _f4(30))))
            before = old_variance + drift
            total = glow[x] * glow[x] * before + old_noise
            revealed = (told[x] > _f4(3)) & (distance[x] > _f4(9) * total)
            gain = glow[x] * before / total
            step = weight * gain
            steps[x] = _f4(1) / glow[x] if revealed else step
            per_channel = distance[x] / channels
            after = before - step * glow[x] * before + step * (gain - step) * per_channel
            after = min(max(after, _f4(LOWEST_VARIANCE)), _f4(HIGHEST_VARIANCE))
            variance_after[x] = settled_variance if revealed else after
            noisier = old_noise + rate * weight * (per_channel - total)
            noisier = min(max(noisier, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
            noise_after[x] = old_noise if revealed else noisier
            covered_after[x] = np.uint8(255) if told[x] < _f4(-0.5) else np.uint8(0)
        for channel in range(mean.shape[0]):
            seen, expected, after_here = patch[channel, row], mean[channel, here], new_mean[channel, here]
            for x in range(columns):
                after_here[x] = expected[x] + steps[x] * (seen[x] - glow[x] * expected[x])

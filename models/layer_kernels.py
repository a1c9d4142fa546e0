"""Loops over the boxes of objects: layers composed front to back, and the background behind them."""

import numpy as np

from .background_kernels import ODDS_STEPS
from .compiled import compiled, exponential, logarithm

_f4 = np.float32

LEAST_CLEAR = 1e-3


@compiled
def colour_distance(patch, top, left, appearance, row, first, end, out):  # type: ignore[no-untyped-def]
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
):  # type: ignore[no-untyped-def]
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
def shift_of(clear, explained, shift):  # type: ignore[no-untyped-def]
    """Log ratio of what layers say for background and for objects."""
    for row in range(clear.shape[0]):
        free, told, out = clear[row], explained[row], shift[row]
        for x in range(clear.shape[1]):
            out[x] = logarithm(free[x]) - logarithm(told[x])


@compiled
def update_behind(
    top, left, shift, width, patch, pooled, mean, variance, noise, light_rows, row_position, drift,
    settled_variance, rate, new_mean, new_variance, new_noise, covered,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """Background of one region again, now with what layers say of it.

    Pixels are weighted by their pooled log odds and `shift`. Where others are sure of background that the
    prediction contradicts, the picture is taken as it is. `covered` is set where an object is predicted.
    """
    channels = mean.shape[0]
    for row in range(shift.shape[0]):
        base = (top + row) * width + left
        above = int(row_position[top + row])
        below_share = row_position[top + row] - _f4(above)
        upper, lower = light_rows[above], light_rows[above + 1]
        for x in range(shift.shape[1]):
            i = base + x
            glow = upper[left + x] + below_share * (lower[left + x] - upper[left + x])
            odds = _f4(pooled[i]) * _f4(1 / ODDS_STEPS) + shift[row, x]
            weight = _f4(1.0) / (_f4(1.0) + exponential(-min(max(odds, _f4(-30.0)), _f4(30.0))))
            before = variance[i] + drift
            total = glow * glow * before + noise[i]
            distance = _f4(0)
            for channel in range(channels):
                difference = patch[channel, row, x] - glow * mean[channel, i]
                distance += difference * difference
            revealed = shift[row, x] > _f4(3.0) and distance > _f4(9.0) * total
            gain = _f4(1.0) / glow if revealed else glow * before / total
            step = (_f4(1.0) if revealed else weight) * gain
            for channel in range(channels):
                new_mean[channel, i] = mean[channel, i] + step * (patch[channel, row, x] - glow * mean[channel, i])
            per_channel = distance / _f4(channels)
            if revealed:
                new_variance[i] = settled_variance
                new_noise[i] = noise[i]
            else:
                after = before - step * glow * before + step * (gain - step) * per_channel
                new_variance[i] = min(max(after, _f4(0.5)), _f4(60.0))
                noisier = noise[i] + rate * weight * (per_channel - total)
                new_noise[i] = min(max(noisier, _f4(20.0)), _f4(400.0))
            covered[i] = 1 if shift[row, x] < _f4(-0.5) else 0

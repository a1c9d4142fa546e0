"""Loops over all pixels for a mixture of Gaussians per pixel.

Components are kept in the order of weight over standard deviation: the first ones are the background's.
Arrays are planar, `(components[, channels], n_pixels)` float32, and worked on row by row.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled, exponential, logarithm
from ....models.pixels.kernels import ODDS_STEPS
from .gaussian import HIGHEST_NOISE, LOWEST_NOISE

_f4 = np.float32

LEAST_WEIGHT = 1e-9
"""Weight below which a component is forgotten: it is 0 from then on."""

_LEAST_DENSITY = _f4(1e-30)


class Mixture(NamedTuple):
    """Components of every pixel, in the order of weight over standard deviation; all float32.

    `(components, n_pixels)` weights, whose sum is 1 (0 where there is no such component);
    `(components, channels, n_pixels)` means in the planes of `colour`; `(components, n_pixels)`
    variances of each channel, squared grey levels.
    """

    weights: NDArray[np.float32]
    means: NDArray[np.float32]
    variances: NDArray[np.float32]


@compiled
def _row_distance(planes, mean, here, out):
    """Squared distance of what is seen from one component's mean, along the row of pixels `here`."""
    out[:] = _f4(0)
    for channel in range(planes.shape[0]):
        seen, expected = planes[channel, here], mean[channel, here]
        for x in range(out.size):
            difference = seen[x] - expected[x]
            out[x] += difference * difference


@compiled
def _row_log_odds(planes, mixture, here, share, log_prior, out):
    """Log odds of background along one row: density of the components that together exceed `share`."""
    channels = _f4(planes.shape[0])
    distance = np.empty(out.size, np.float32)
    density, gathered = np.zeros(out.size, np.float32), np.zeros(out.size, np.float32)
    for k in range(len(mixture.weights)):
        _row_distance(planes, mixture.means[k], here, distance)
        weight, variance = mixture.weights[k, here], mixture.variances[k, here]
        for x in range(out.size):
            part = weight[x] if gathered[x] <= share else _f4(0)
            power = _f4(-0.5) * (channels * logarithm(variance[x]) + distance[x] / variance[x])
            density[x] += part * exponential(power)
            gathered[x] += part
    for x in range(out.size):
        out[x] = log_prior + logarithm(max(density[x], _LEAST_DENSITY)) - logarithm(gathered[x])


@compiled
def subtract_mixture(first, end, width, planes, mixture, share, log_prior, log_odds):
    """Rows `first` to `end`: log odds of background as int8 in steps of `1 / ODDS_STEPS`."""
    odds = np.empty(width, np.float32)
    for y in range(first, end):
        here = slice(y * width, (y + 1) * width)
        _row_log_odds(planes, mixture, here, share, log_prior, odds)
        out = log_odds[here]
        for x in range(width):
            out[x] = np.int8(min(max(odds[x], _f4(-6)), _f4(6)) * _f4(ODDS_STEPS))


@compiled
def mixture_log_evidence(width, planes, mixture, share, log_prior, shift):
    """Sum over pixels of log(exp(log odds + shift) + 1), the log odds neither rounded nor saturated.

    `shift` has one entry a pixel, or a single one for all.
    """
    odds, added = np.empty(width, np.float32), np.full(width, shift[0])
    total = 0.0
    for y in range(planes.shape[1] // width):
        here = slice(y * width, (y + 1) * width)
        _row_log_odds(planes, mixture, here, share, log_prior, odds)
        if shift.size > 1:
            added[:] = shift[here]
        in_row = _f4(0)
        for x in range(width):
            sum_of_both = odds[x] + added[x]
            in_row += max(sum_of_both, _f4(0)) + logarithm(_f4(1) + exponential(-abs(sum_of_both)))
        total += in_row
    return total


@compiled
def learn_mixture(first, end, width, planes, rates, least_rate, first_variance, reach, before, mixture):
    """Rows `first` to `end`: one step of learning from `before` to `mixture`, by each pixel's own rate.

    The most probable component within `reach` variances learns. Where there is none, a new one takes the
    place of the last, if the rate exceeds `least_rate`: a component cannot be replaced in part.
    """
    weights, means, variances = before
    new_weights, new_means, new_variances = mixture
    components, channels = means.shape[:2]
    distances = np.empty((components, width), np.float32)
    shown, fresh = np.empty(width, np.float32), np.empty(width, np.float32)
    gain, total = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(first, end):
        here = slice(y * width, (y + 1) * width)
        rate = rates[here]
        shown[:] = _f4(components)
        for k in range(components - 1, -1, -1):
            distance, weight, variance = distances[k], weights[k, here], variances[k, here]
            _row_distance(planes, means[k], here, distance)
            for x in range(width):
                near = (weight[x] > _f4(0)) & (distance[x] < reach * variance[x])
                shown[x] = _f4(k) if near else shown[x]
        for x in range(width):
            replaced = (shown[x] == _f4(components)) & (rate[x] > least_rate)
            fresh[x] = _f4(1) if replaced else _f4(0)
            shown[x] = _f4(components - 1) if replaced else shown[x]
        total[:] = _f4(0)
        for k in range(components):
            distance, weight, variance = distances[k], weights[k, here], variances[k, here]
            weight_after, variance_after = new_weights[k, here], new_variances[k, here]
            for x in range(width):
                is_shown = shown[x] == _f4(k)
                new = is_shown & (fresh[x] > _f4(0))
                kept = _f4(0) if new else (_f4(1) - rate[x]) * weight[x]
                after = kept + rate[x] if is_shown else kept
                after = after if after > _f4(LEAST_WEIGHT) else _f4(0)
                step = rate[x] / max(after, _f4(LEAST_WEIGHT)) if is_shown else _f4(0)
                rest = _f4(1) - step
                spread = rest * variance[x] + step * rest * rest * distance[x] / _f4(channels)
                spread = min(max(spread, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
                weight_after[x] = after
                variance_after[x] = first_variance if new else (spread if is_shown else variance[x])
                gain[x] = step
                total[x] += after
            for channel in range(channels):
                seen, mean, mean_after = (
                    planes[channel, here],
                    means[k, channel, here],
                    new_means[k, channel, here],
                )
                for x in range(width):
                    mean_after[x] = mean[x] + gain[x] * (seen[x] - mean[x])
        for k in range(components):
            weight_after = new_weights[k, here]
            for x in range(width):
                weight_after[x] /= total[x]
        # only one component can be out of order: one pass lets it sink, the other lets it rise
        for k in range(components - 1):
            _order(k, here, mixture, shown)
        for k in range(components - 3, -1, -1):
            _order(k, here, mixture, shown)


@compiled
def _order(k, here, mixture, swapped):
    """Let components `k` and `k + 1` of a row change places where the second is the more probable."""
    weights, means, variances = mixture
    weight, next_weight = weights[k, here], weights[k + 1, here]
    variance, next_variance = variances[k, here], variances[k + 1, here]
    for x in range(swapped.size):
        ahead = weight[x] * weight[x] * next_variance[x]
        behind = next_weight[x] * next_weight[x] * variance[x]
        swapped[x] = _f4(1) if behind > ahead else _f4(0)
    _swap(weight, next_weight, swapped)
    _swap(variance, next_variance, swapped)
    for channel in range(means.shape[1]):
        _swap(means[k, channel, here], means[k + 1, channel, here], swapped)


@compiled
def _swap(one, other, swapped):
    for x in range(swapped.size):
        here, there = one[x], other[x]
        one[x] = there if swapped[x] > _f4(0) else here
        other[x] = here if swapped[x] > _f4(0) else there

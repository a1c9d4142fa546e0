"""Loops over the pixels of the background maps of many experts."""

from typing import NamedTuple

import numpy as np

from ....models.numerics.compiled import compiled, logarithm

_f4 = np.float32
_LOG_2_PI = _f4(1.8378771)
_LOG_GREYS = _f4(np.log(256))


class MapNoise(NamedTuple):
    """Squared grey levels: of an observation, of a change since the last one, and of a pixel never seen."""

    observation: np.float32
    change: np.float32
    unknown: np.float32


@compiled
def compare_with_maps(grey, mean, variance, box, noise, least, ratio, trust, everywhere):
    """Log density of a picture under each map over the uniform one, and the trust in it, cut out of a box.

    `grey` `(height, width)` uint8; `mean` and `variance` `(n, height, width)`; `ratio` (not below `least`
    nats) and `trust` `(n, rows, columns)` of the `box`; `everywhere` `(n,)`: sum of their product over all
    pixels.
    """
    height, width = grey.shape
    top, left, rows, columns = box
    line, share = np.empty(width, _f4), np.empty(width, _f4)
    for m in range(len(mean)):
        total = 0.0
        for y in range(height):
            seen, expected, spread = grey[y], mean[m, y], variance[m, y]
            in_row = _f4(0)
            for x in range(width):
                before = min(spread[x] + noise.change, noise.unknown)
                whole = before + noise.observation
                off = _f4(seen[x]) - expected[x]
                nats = _LOG_GREYS - _f4(0.5) * (_LOG_2_PI + logarithm(whole) + off * off / whole)
                nats = max(nats, least)
                known = _f4(1) - before / noise.unknown
                line[x], share[x] = nats, known
                in_row += known * nats
            total += in_row
            if top <= y < top + rows:
                ratio[m, y - top] = line[left : left + columns]
                trust[m, y - top] = share[left : left + columns]
        everywhere[m] = total


@compiled
def update_maps(grey, mean, variance, parents, hidden, box, noise, new_mean, new_variance):
    """Kalman filter of every pixel of every map; no gain where `hidden` `(n, rows, columns)` in the box."""
    height, width = grey.shape
    top, left, rows, columns = box
    shown = np.empty(width, _f4)
    for m in range(len(parents)):
        parent = parents[m]
        for y in range(height):
            shown[:] = _f4(1)
            if top <= y < top + rows:
                covered = hidden[m, y - top]
                for x in range(columns):
                    shown[left + x] = _f4(1) - _f4(covered[x])
            seen, before, spread = grey[y], mean[parent, y], variance[parent, y]
            after, narrow = new_mean[m, y], new_variance[m, y]
            for x in range(width):
                wide = min(spread[x] + noise.change, noise.unknown)
                gain = shown[x] * wide / (wide + noise.observation)
                after[x] = before[x] + gain * (_f4(seen[x]) - before[x])
                narrow[x] = (_f4(1) - gain) * wide

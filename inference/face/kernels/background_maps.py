"""Loops over the pixels of the background maps of many experts."""

import numpy as np

from ....models.numerics.compiled import compiled, logarithm

_f4 = np.float32
_LOG_2_PI = _f4(1.8378771)


@compiled
def read_maps(grey, mean, variance, top, left, unknown, noise, log_greys, least, ratio, trust, everywhere):
    """Log density of a picture under each map over the uniform one, and the trust in it, cut out of a box.

    `grey` `(height, width)` uint8; `mean` and `variance` `(n, height, width)`; `ratio` and `trust`
    `(n, rows, columns)` from `(top, left)`; `everywhere` `(n,)`: sum of their product over all pixels.
    """
    height, width = grey.shape
    rows, columns = ratio.shape[1], ratio.shape[2]
    line, share = np.empty(width, _f4), np.empty(width, _f4)
    for m in range(len(mean)):
        total = 0.0
        for y in range(height):
            seen, expected, spread = grey[y], mean[m, y], variance[m, y]
            in_row = _f4(0)
            for x in range(width):
                before = spread[x]
                whole = before + noise
                off = _f4(seen[x]) - expected[x]
                nats = log_greys - _f4(0.5) * (_LOG_2_PI + logarithm(whole) + off * off / whole)
                nats = max(nats, least)
                known = _f4(1) - before / unknown
                line[x], share[x] = nats, known
                in_row += known * nats
            total += in_row
            if top <= y < top + rows:
                ratio[m, y - top] = line[left : left + columns]
                trust[m, y - top] = share[left : left + columns]
        everywhere[m] = total


@compiled
def update_maps(
    grey, mean, variance, parents, hidden, top, left, noise, wandering, unknown, new_mean, new_variance
):
    """Kalman filter of every pixel of every map; no gain where `hidden` `(n, rows, columns)`."""
    height, width = grey.shape
    rows, columns = hidden.shape[1], hidden.shape[2]
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
                gain = shown[x] * spread[x] / (spread[x] + noise)
                after[x] = before[x] + gain * (_f4(seen[x]) - before[x])
                narrow[x] = min((_f4(1) - gain) * spread[x] + wandering, unknown)

"""Loops over the texels of experts' textures: prediction, Kalman update, how well a picture was predicted."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled

Map = NDArray[np.float32]

_f4 = np.float32


class Noises(NamedTuple):
    """Of texels, each `(n_experts, n_texels)` float32 or `(1, n_texels)` where it is the same for all.

    Squared grey levels of an observation and of what changed since the last one, and variance after the first
    look.
    """

    rendering: Map
    process: Map
    first: Map


class Lasting(NamedTuple):
    """Lasting textures `(n_experts, n_texels)`, or nothing `(0, 0)`; mean and looks."""

    mean: Map
    looks: Map


class Memory(NamedTuple):
    """How lasting textures learn, of texels `(n_experts, n_texels)` or `(1, n_texels)`: what their first
    picture counts for, and the least share of a new one."""

    first: Map
    share: Map


@compiled
def predict(mean, variance, lasting, returned, noises, most, new_mean, new_variance):
    """Variances grow, up to `most`, and means return by a share to the lasting texture where there is one."""
    process = noises.process
    for d in range(len(variance)):
        change = process[d if len(process) > 1 else 0]
        before, after = variance[d], new_variance[d]
        for i in range(len(before)):
            after[i] = min(before[i] + change[i], most)
        new_mean[d] = mean[d]
        if len(lasting.mean):
            where, looks, its_mean = lasting.mean[d], lasting.looks[d], new_mean[d, 0]
            for i in range(len(before)):
                off = where[i] - its_mean[i] if looks[i] > _f4(0) else _f4(0)
                its_mean[i] += returned * off


@compiled
def learn(observed, seen, mean, variance, noises, unknown, new_mean, new_variance):
    """Kalman update of the finest level of every texel that is seen; the coarse ones hold what is seen.

    Texels of a variance of `unknown` or more take what they are seen to be.
    """
    rendering, first = noises.rendering, noises.first
    for d in range(len(variance)):
        own = d if len(rendering) > 1 else 0
        noise, least, shown = rendering[own], first[own], seen[d]
        before, after, look, old, new = (
            variance[d],
            new_variance[d],
            observed[d, 0],
            mean[d, 0],
            new_mean[d, 0],
        )
        for i in range(len(before)):
            v = before[i]
            gain = _f4(1) if v >= unknown else v / (v + noise[i])
            gain = gain if shown[i] else _f4(0)
            after[i] = least[i] if shown[i] & (v >= unknown) else (_f4(1) - gain) * v
            new[i] = old[i] + gain * (look[i] - old[i])
        for level in range(1, mean.shape[1]):
            look, old, new = observed[d, level], mean[d, level], new_mean[d, level]
            for i in range(len(before)):
                new[i] = look[i] if shown[i] else old[i]


@compiled
def learn_lasting(observed, seen, lasting, memory, weight, after):
    """Means over all that was seen, of texels that are seen; as of `LastingTexture`. A picture counts for
    `weight` of the usual rate."""
    for d in range(len(seen)):
        own = d if len(memory.first) > 1 else 0
        first, least, look, shown = memory.first[own], memory.share[own], observed[d, 0], seen[d]
        mean, looks, new_mean, new_looks = lasting.mean[d], lasting.looks[d], after.mean[d], after.looks[d]
        for i in range(len(mean)):
            fresh = looks[i] == _f4(0)
            counts = first[i] if fresh else weight
            total = looks[i] + (counts if shown[i] else _f4(0))
            share = _f4(1) if fresh else max(weight / max(total, weight), least[i])
            new_mean[i] = mean[i] + (share * (look[i] - mean[i]) if shown[i] else _f4(0))
            new_looks[i] = total


@compiled
def explain(observed, mean, visible, seen, least_inside, share):
    """Share of the picture's variance that predictions explain, as of `texture_filter.explained`."""
    for d in range(len(seen)):
        look, expected, shown = observed[d, 0], mean[d, 0], seen[d]
        count = facing = 0
        total = _f4(0)
        for i in range(len(shown)):
            count += shown[i]
            facing += visible[d, i]
            total += look[i] if shown[i] else _f4(0)
        middle = total / _f4(max(count, 1))
        error = power = _f4(0)
        for i in range(len(shown)):
            off, spread = look[i] - expected[i], look[i] - middle
            error += off * off if shown[i] else _f4(0)
            power += spread * spread if shown[i] else _f4(0)
        share[d] = _f4(0)
        if max(count, 1) > least_inside * max(facing, 1):
            share[d] = max(_f4(1) - error / max(power, _f4(1)), _f4(-1))

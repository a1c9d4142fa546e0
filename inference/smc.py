"""Resampling of weighted samples, from weights in log space."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def log_sum(values: Array) -> float:
    """Return log sum exp of `values`; minus infinity where all are. (scipy's takes five times as long.)"""
    peak = float(values.max(initial=-np.inf))
    return peak + float(np.log(np.exp(values - peak).sum())) if np.isfinite(peak) else -np.inf


def normalised(log_weights: Array) -> Array:
    """Return `log_weights` shifted so that weights sum to one; equal ones where none is above zero."""
    total = log_sum(log_weights)
    if not np.isfinite(total):
        return np.full(log_weights.shape, -np.log(max(log_weights.size, 1)))
    return log_weights - total


def systematic(log_weights: Array, n: int, random: np.random.Generator) -> NDArray[np.int64]:
    """Return `(n,)` indices by systematic resampling: each sample in proportion to its weight, within one."""
    ends = np.cumsum(np.exp(normalised(log_weights)))
    points = (np.arange(n) + random.random()) * (ends[-1] / n)
    return np.asarray(np.searchsorted(ends[:-1], points, side="right"), np.int64)


def copied(random: np.random.Generator) -> np.random.Generator:
    """Return a copy of a generator in the same state; several times faster than `copy.deepcopy`."""
    fresh = type(random.bit_generator)(0)
    fresh.state = random.bit_generator.state
    return np.random.Generator(fresh)

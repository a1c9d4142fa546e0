"""Resampling of weighted samples, from weights in log space."""

import numpy as np
from numpy.typing import NDArray

from .kernels.resampling import systematic_indices

Array = NDArray[np.float64]


def log_sum(values: Array, axis: int | None = None) -> Array:
    """log sum exp of `values` along `axis`; minus infinity where all are."""
    peak = np.max(values, axis=axis, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    with np.errstate(divide="ignore"):
        total: Array = np.log(np.exp(values - peak).sum(axis=axis, keepdims=True)) + peak
    return total.reshape(()) if axis is None else np.squeeze(total, axis=axis)


def normalised(log_weights: Array) -> Array:
    """`log_weights` shifted so that weights sum to one; equal ones where none is above zero."""
    total = log_sum(log_weights)
    if not np.isfinite(total):
        return np.full(log_weights.shape, -np.log(log_weights.size))
    return log_weights - total


def systematic(log_weights: Array, n: int, random: np.random.Generator) -> NDArray[np.int64]:
    """`(n,)` indices drawn by systematic resampling: each sample as often as its weight says, within one."""
    chosen: NDArray[np.int64] = systematic_indices(log_weights, n, random.random())
    return chosen

"""Compiled loop of systematic resampling."""

import numba
import numpy as np

SMALLEST = -700.0
"""Nats below the greatest weight, where exponentials end."""


# unlike other kernels without fast-math's promise that nothing is infinite: the log of no weight is
@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def systematic_indices(log_weights, n, offset):
    """`(n,)` int64 indices of samples, by points (k + offset) / n on the sum of their weights.

    `log_weights` `(m,)` may have any constant added; where all are minus infinity, weights are equal. No loop
    branches on the weights, which no processor could foresee.
    """
    m = len(log_weights)
    peak = log_weights[0]
    for k in range(1, m):
        peak = max(peak, log_weights[k])
    if peak == -np.inf:
        peak = 0.0
    weights, total = np.empty(m), 0.0
    for k in range(m):
        # exp by its series at 1/4096 of the exponent: the twelve squarings leave an error below 1e-12
        x = max(log_weights[k] - peak, SMALLEST) * (1 / 4096)
        power = 1 + x * (1 / 5) * (1 + x * (1 / 6) * (1 + x * (1 / 7) * (1 + x * (1 / 8))))
        power = 1 + x * (1 + x * (1 / 2) * (1 + x * (1 / 3) * (1 + x * (1 / 4) * power)))
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        power *= power
        weights[k] = power
        total += power
    # the sample of a point is the number of samples whose weights end before it; those that end beyond the
    # last point are counted in an entry more
    chosen = np.zeros(n + 1, np.int64)
    scale, beyond = n / total, 1.0 - offset
    for k in range(m - 1):
        beyond += scale * weights[k]
        chosen[min(np.int64(beyond), n)] += 1
    ended = 0
    for k in range(n):
        ended += chosen[k]
        chosen[k] = ended
    return chosen[:n]

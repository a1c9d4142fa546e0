"""Loop that cuts points into runs, the widest one first."""

import numpy as np

from ....models.numerics.compiled import compiled, inlined


@inlined
def _spread(points, order, first, end, variances):
    """Write into `variances` `(d,)` those of the points `order[first]` to before `order[end]`."""
    count = end - first
    for axis in range(points.shape[1]):
        mean = 0.0
        for k in range(first, end):
            mean += points[order[k], axis]
        mean /= count
        total = 0.0
        for k in range(first, end):
            step = points[order[k], axis] - mean
            total += step * step
        variances[axis] = total / count


@compiled
def cut(points, narrow, most, rounds, numbers):
    """Cut points in two, again and again, where and along which axis they are widest.

    Parameters
    ----------
    points
        `(n, d)`.
    narrow
        variance along an axis below which nothing is cut.
    most
        pieces.
    rounds
        in which the middle between two halves is found, each of which is nearer to its own mean.
    numbers
        `(n,)` int64 written: the piece of each point.
    """
    n, d = points.shape
    order, kept = np.arange(n), np.empty(n, np.int64)
    firsts, ends = np.zeros(most, np.int64), np.zeros(most, np.int64)
    variances = np.zeros((most, d))
    ends[0], count = n, 1
    numbers[:] = 0
    if n > 1:
        _spread(points, order, 0, n, variances[0])
    while count < most:
        widest, axis = 0, 0
        for piece in range(count):
            for k in range(d):
                if variances[piece, k] > variances[widest, axis]:
                    widest, axis = piece, k
        if variances[widest, axis] < narrow:
            break
        first, end = firsts[widest], ends[widest]
        middle = 0.0
        for k in range(first, end):
            middle += points[order[k], axis]
        middle /= end - first
        for _ in range(rounds):
            above, below, n_above = 0.0, 0.0, 0
            for k in range(first, end):
                value = points[order[k], axis]
                if value > middle:
                    above, n_above = above + value, n_above + 1
                else:
                    below += value
            middle = 0.5 * (above / n_above + below / (end - first - n_above))
        split, n_above = first, 0
        for k in range(first, end):
            point = order[k]
            if points[point, axis] > middle:
                kept[n_above] = point
                numbers[point] = count
                n_above += 1
            else:
                order[split] = point
                split += 1
        for k in range(n_above):
            order[split + k] = kept[k]
        ends[widest], firsts[count], ends[count] = split, split, end
        _spread(points, order, first, split, variances[widest])
        _spread(points, order, split, end, variances[count])
        count += 1

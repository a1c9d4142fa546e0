"""Compiled loop that compares poses with the points that a detector has found of a person."""

import numpy as np

from ...numerics.compiled import compiled, exponential

_f4 = np.float32


@compiled
def keypoint_terms(joints, places, ends, shares, heights, halves, false, chances, out):
    """Log likelihood ratios of points against points anywhere about a person, added to `out` `(n,)`.

    Parameters
    ----------
    joints
        `(n, 8, 3)` px.
    places
        `(m, 2)` px: points that were found.
    ends, shares
        `(h, m, 2)` and `(m,)`: between which joints each is, and how far on the way from the first to the
        second, under each of h hypotheses.
    heights, halves
        `(m,)`: highest value of a point's ratio, and half its precision, 1/px^2.
    false
        `(m,)`: what the ratio is at least.
    chances
        `(h + 1,)`: probabilities of the hypotheses, and of that in which all is somebody else's.
    """
    for k in range(len(joints)):
        total = _f4(chances[len(ends)])
        for h in range(len(ends)):
            product = _f4(chances[h])
            for p in range(len(places)):
                first, second = ends[h, p, 0], ends[h, p, 1]
                x, y, share = joints[k, first, 0], joints[k, first, 1], shares[p]
                x += share * (joints[k, second, 0] - x) - places[p, 0]
                y += share * (joints[k, second, 1] - y) - places[p, 1]
                near = exponential(_f4(-halves[p] * (x * x + y * y)))
                product *= _f4(heights[p]) * near + _f4(false[p])
            total += product
        out[k] += np.log(np.float64(total))

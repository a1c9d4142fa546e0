"""Compiled loops over a frame's evidence of a body: detected key points, and tables of skin colours."""

import numpy as np

from ...numerics.compiled import compiled, exponential, logarithm

_f4 = np.float32


@compiled
def keypoint_terms(joints, places, ends, shares, heights, halves, false, chances, out):
    """Log likelihood ratios of points against points anywhere about a person, added to `out` `(n,)`.

    Parameters
    ----------
    joints
        `(n, 8, 2)` or `(n, 8, 3)` px.
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


@compiled
def looked_up(luma_red_blue, table, out):
    """`out` (n,) float32 from `table` (8 * 64 * 64,) float32 at the colours (n, 3) uint8: Y, Cr, Cb."""
    for i in range(out.size):
        luma, red, blue = luma_red_blue[i, 0], luma_red_blue[i, 1], luma_red_blue[i, 2]
        out[i] = table[(np.int32(luma >> 5) << 12) | (np.int32(red >> 2) << 6) | np.int32(blue >> 2)]


@compiled
def blended(odds, others, own, other):
    """Turn log odds `odds` `(n,)` float32 into those of a mixture with `others` `(n,)`, by their shares."""
    own, other = _f4(own), _f4(other)
    for k in range(len(odds)):
        odds[k] = logarithm(own * exponential(odds[k]) + other * exponential(others[k]))

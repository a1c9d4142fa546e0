"""Loops over an image's pixels that read a table of colours, and blend what two of them say."""

import numpy as np

from ...numerics.compiled import compiled, exponential, logarithm

_f4 = np.float32


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

"""Where experts begin to climb: apart, so that not all of them take a wrong peak for the right one."""

import numpy as np
from numpy.typing import NDArray

from ...models.face.pose import Poses

Array = NDArray[np.float64]

FARTHEST_AHEAD = 1.5
"""Share of an expert's last motion, up to which experts begin their search ahead."""

ASIDE = 0.5
"""How far they begin it aside, in standard deviations of the motion."""

STRAIGHT = 0.25
"""Share of the experts that do not."""


def apart(poses: Poses, motion: Array, walk: Array, random: np.random.Generator) -> Poses:
    """Poses from which experts begin their search in a picture.

    They go on by different shares of their last motion, and most of them step aside, too. What they believe
    is not touched by it: all climb on the same likelihood and prior, each from a place of its own.

    Parameters
    ----------
    poses
        of the experts in the picture before.
    motion
        `(n, dimension)`: how each would have moved until now, had it gone on.
    walk
        `(dimension,)` variances of the motion.
    random
        to draw from; it is moved on.
    """
    n, dimension = motion.shape
    share = np.linspace(0.0, FARTHEST_AHEAD, n)[random.permutation(n)]
    aside = ASIDE * np.sqrt(walk) * random.standard_normal((n, dimension))
    aside[random.random(n) < STRAIGHT] = 0.0
    return poses.moved(share[:, None] * motion + aside)

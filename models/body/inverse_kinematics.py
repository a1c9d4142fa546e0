"""Inverse kinematics of an arm: all its postures that lead from the shoulder to a given place of the hand.

The elbow moves on a circle about the line from shoulder to hand; the angle on it is the swivel. Hand position
and swivel together are as good as the two directions of the arm, and `log_volume` says how areas change.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .kernels import elbows, reach

if TYPE_CHECKING:
    from .upper_body import UpperBody

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REFERENCE = np.array([0.7, -0.7, 0.1]) / np.sqrt(0.99)
"""Swivel 0 of the left arm: the elbow lies outwards and up. Hands are seldom on this line from a shoulder."""


def arm_at(body: "UpperBody", side: int, offsets: Array, swivels: Array) -> tuple[Array, Mask]:
    """Arms that bring their hands to given places, by the law of cosines.

    Parameters
    ----------
    side
        0 for the left arm, 1 for the right one.
    offsets
        `(n, 3)` px: hand minus shoulder.
    swivels
        `(n,)` rad: where on its circle the elbow is, from the direction nearest to `REFERENCE`; arms that
        are mirror images of each other have equal swivels.

    Returns
    -------
    arms
        `(n, 2, 3)`: unit vectors along upper arm and forearm.
    reachable
        `(n,)`: whether hands can be there; the other arms are stretched, or folded, along the line to it.
    """
    arms, reachable = np.empty((len(offsets), 2, 3)), np.empty(len(offsets), np.bool_)
    reach(
        np.ascontiguousarray(offsets), np.ascontiguousarray(swivels),
        body.upper_arm, body.forearm, 1.0 - 2.0 * side, REFERENCE, arms, reachable,
    )  # fmt: skip
    return arms, reachable


def swivels(side: int, arms: Array, body: "UpperBody") -> Array:
    """`(n,)` rad from -pi to pi: swivels, as `arm_at` takes them, of `arms` `(n, 2, 3)`."""
    upright, level = np.empty((2, len(arms)))
    sign = 1.0 - 2.0 * side
    elbows(np.ascontiguousarray(arms), body.upper_arm, body.forearm, sign, REFERENCE, upright, level)
    angles: Array = np.arctan2(upright, level)
    return angles


def log_volume(body: "UpperBody", offsets: Array) -> Array:
    """`(n,)`: log of r L1 L2 for hands at `offsets` `(n, 3)` px from their shoulders, r their distance.

    d(hand x, y, z) d(swivel) = r L1 L2 d(upper arm) d(forearm), where the directions have areas on unit
    spheres and L1, L2 are the lengths: a density over directions is that over places times r L1 L2.
    """
    squares = np.maximum(np.einsum("nx,nx->n", offsets, offsets), np.finfo(np.float64).tiny)
    volume: Array = 0.5 * np.log(squares) + np.log(body.upper_arm * body.forearm)
    return volume

"""Inverse kinematics of an arm: all its postures that lead from the shoulder to a given place of the hand.

The elbow moves on a circle about the line from shoulder to hand; the angle on it is the swivel. Hand position
and swivel together are as good as the two directions of the arm, and `log_volume` says how areas change.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .body_poses import cross

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
    upper, fore = body.upper_arm, body.forearm
    along, distance = _direction(offsets)
    reachable = (distance <= upper + fore) & (distance >= abs(upper - fore)) & (distance > 0)
    safe = np.where(distance > 0, distance, 1.0)
    cosine = np.clip((upper**2 + distance**2 - fore**2) / (2 * upper * safe), -1, 1)
    sine = np.sqrt(1 - cosine**2)
    outwards, sideways = _circle(side, along)
    across = np.cos(swivels)[:, None] * outwards + np.sin(swivels)[:, None] * sideways
    arms = np.empty((len(offsets), 2, 3))
    arms[:, 0] = cosine[:, None] * along + sine[:, None] * across
    arms[:, 1], _ = _direction(offsets - upper * arms[:, 0])
    return arms, reachable


def swivels(side: int, arms: Array, body: "UpperBody") -> Array:
    """`(n,)` rad from -pi to pi: swivels, as `arm_at` takes them, of `arms` `(n, 2, 3)`."""
    along, _ = _direction(body.upper_arm * arms[:, 0] + body.forearm * arms[:, 1])
    outwards, sideways = _circle(side, along)
    angles: Array = np.arctan2((arms[:, 0] * sideways).sum(-1), (arms[:, 0] * outwards).sum(-1))
    return angles


def log_volume(body: "UpperBody", offsets: Array) -> Array:
    """`(n,)`: log of r L1 L2 for hands at `offsets` `(n, 3)` px from their shoulders, r their distance.

    d(hand x, y, z) d(swivel) = r L1 L2 d(upper arm) d(forearm), where the directions have areas on unit
    spheres and L1, L2 are the lengths: a density over directions is that over places times r L1 L2.
    """
    squares = np.maximum((offsets**2).sum(-1), np.finfo(np.float64).tiny)
    volume: Array = 0.5 * np.log(squares) + np.log(body.upper_arm * body.forearm)
    return volume


def _direction(offsets: Array) -> tuple[Array, Array]:
    """Unit vectors along `offsets` `(n, 3)`, any where they are 0, and their lengths `(n,)`."""
    length = np.sqrt((offsets**2).sum(-1))
    nowhere = length == 0
    along: Array = offsets / np.where(nowhere, 1.0, length)[:, None]
    along[nowhere] = [0.0, 1.0, 0.0]
    return along, length


def _circle(side: int, along: Array) -> tuple[Array, Array]:
    """Unit vectors across `along` `(n, 3)`: to the elbow at swivel 0 and at swivel pi/2."""
    sign = 1.0 if side == 0 else -1.0
    outwards = _across(REFERENCE * [sign, 1.0, 1.0], along)
    length = np.sqrt((outwards**2).sum(-1))
    lost = length < 1e-9
    if lost.any():
        outwards[lost] = _across(np.array([0.0, 0.0, -1.0]), along[lost])
        length = np.sqrt((outwards**2).sum(-1))
    outwards /= length[:, None]
    return outwards, sign * cross(along, outwards)


def _across(reference: Array, along: Array) -> Array:
    """What of `reference` `(3,)` is perpendicular to `along` `(n, 3)`."""
    perpendicular: Array = reference - (along @ reference)[:, None] * along
    return perpendicular

"""Poses of an upper body to test with: hanging arms, arms of given angles, turns of upper arms."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rsmcm.models.body.poses import BodyPoses, cross, transport
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def resting(roots: ArrayLike) -> BodyPoses:
    """Bodies at `roots` `(n, 2)` px that look at the viewer, with their arms hanging straight down."""
    places = np.asarray(roots, np.float64)
    n = len(places)
    return BodyPoses(places, np.zeros((n, 3)), np.tile([0.0, 1.0, 0.0], (n, 2, 2, 1)))


def from_angles(angles: Array) -> BodyPoses:
    """Poses from the rows of `angles` `(n, 13)`, as `BodyPoses.angles` gives them."""
    n = len(angles)
    per_arm = angles[:, 5:].reshape(2 * n, 4)
    rotations = Rotation.from_rotvec(per_arm[:, :3]).as_matrix().reshape(n, 2, 3, 3)
    flexions = per_arm[:, 3].reshape(n, 2, 1)
    upper_arms = rotations[..., 1]
    forearms = np.cos(flexions) * upper_arms - np.sin(flexions) * rotations[..., 2]
    return BodyPoses(angles[:, :2].copy(), angles[:, 2:5].copy(), np.stack([upper_arms, forearms], axis=2))


def twists(arms: Array) -> Array:
    """`(...)` rad: turns about the upper arms of `arms` `(..., 2, 3)` that `transport` leaves out.

    The shoulder's rotation is a turn about (0, 1, 0) by this angle, then the transport. The turn is positive
    where the forearm of a hanging arm points to the left of the picture, to the person's right.
    """
    axis = cross(arms[..., 1, :], arms[..., 0, :])
    local = np.einsum("...ij,...i->...j", transport(arms[..., 0, :]), axis)
    turns: Array = np.arctan2(-local[..., 2], local[..., 0])
    return turns

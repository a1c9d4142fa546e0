"""Poses of an upper body to test with: hanging arms, arms of given angles, turns, masks, outlines."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from rsmcm.chains.body.kernels import outlines
from rsmcm.chains.body.kernels.outlines import LANES, NUMBERS, ROW
from rsmcm.chains.body.likelihood import OUTLINE_PARTS, solid_of
from rsmcm.models.body.upper_body import BodyPoses, UpperBody, transport
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def _from_a_loop(function: Any) -> Any:
    """A function that only loops can call."""
    return njit(lambda *arguments: function(*arguments))


put_body, fronts, trace = map(_from_a_loop, (outlines.put_body, outlines.fronts, outlines.trace))

FAR = 1e9
"""Depth where a part is not."""


def resting(roots: ArrayLike) -> BodyPoses:
    """Bodies at `roots` `(n, 2)` px that look at the viewer, with their arms hanging straight down."""
    places = np.asarray(roots, np.float64)
    n = len(places)
    return BodyPoses(places, np.zeros((n, 3)), np.zeros((n, 3)), np.tile([0.0, 1.0, 0.0], (n, 2, 2, 1)))


def from_angles(angles: Array) -> BodyPoses:
    """Poses from the rows of `angles` `(n, 16)`, as `BodyPoses.angles` gives them."""
    n = len(angles)
    per_arm = angles[:, 8:].reshape(2 * n, 4)
    rotations = Rotation.from_rotvec(per_arm[:, :3]).as_matrix().reshape(n, 2, 3, 3)
    flexions = per_arm[:, 3].reshape(n, 2, 1)
    upper_arms = rotations[..., 1]
    forearms = np.cos(flexions) * upper_arms - np.sin(flexions) * rotations[..., 2]
    roots, torsos, necks = (angles[:, run].copy() for run in (slice(2), slice(2, 5), slice(5, 8)))
    return BodyPoses(roots, torsos, necks, np.stack([upper_arms, forearms], axis=2))


def twists(arms: Array) -> Array:
    """`(...)` rad: turns about the upper arms of `arms` `(..., 2, 3)` that `transport` leaves out.

    The shoulder's rotation is a turn about (0, 1, 0) by this angle, then the transport. The turn is positive
    where the forearm of a hanging arm points to the left of the picture, to the person's right.
    """
    axis = np.cross(arms[..., 1, :], arms[..., 0, :])
    local = np.einsum("...ij,...i->...j", transport(arms[..., 0, :]), axis)
    turns: Array = np.arctan2(-local[..., 2], local[..., 0])
    return turns


def masks(body: UpperBody, poses: BodyPoses, size: tuple[int, int]) -> NDArray[np.uint8]:
    """`(n, h, w)` pictures of `size` (h, w): 0, or 1 + the number in `OUTLINE_PARTS` of the nearest part."""
    solid = solid_of(body)
    lines = np.zeros((len(OUTLINE_PARTS), ROW, size[0] * size[1]), np.float32)
    lines[:, 1], lines[:, 0] = np.indices(size).reshape(2, -1)
    labels = np.zeros((len(poses), *size), np.uint8)
    shapes, bounds = (np.zeros((len(OUTLINE_PARTS), n), np.float32) for n in (NUMBERS, 4))
    for pose in range(len(poses)):
        put_body(
            poses.roots,
            poses.torsos,
            poses.necks,
            poses.arms,
            pose,
            solid.lengths,
            solid.torso,
            shapes,
            bounds,
        )
        depths = np.full((len(lines), lines.shape[2]), FAR, np.float32)
        for part in range(len(OUTLINE_PARTS)):
            fronts(shapes, part, solid.torso, np.float32(0), lines, depths, part)
        nearest = np.where(depths.min(axis=0) < FAR, 1 + depths.argmin(axis=0), 0)
        labels[pose] = nearest.reshape(size)
    return labels


class Silhouettes(NamedTuple):
    """Outlines of n bodies, m points each; `part` are numbers in `OUTLINE_PARTS`, `(m,)`."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    visible: NDArray[np.bool_]
    part: NDArray[np.intp]


def silhouettes(body: UpperBody, poses: BodyPoses) -> Silhouettes:
    """Outlines as the likelihood traces them."""
    solid, n = solid_of(body), len(poses)
    n_rows, n_parts = len(solid.counted), len(OUTLINE_PARTS)
    lines, least = np.zeros((n, n_rows, ROW, LANES), np.float32), np.zeros((n, n_rows, LANES), np.float32)
    shapes, bounds = np.zeros((n_parts, NUMBERS), np.float32), np.zeros((n_parts, 4), np.float32)
    for pose in range(n):
        trace(
            poses.roots, poses.torsos, poses.necks, poses.arms, pose, solid, shapes, bounds,
            lines[pose], least[pose],
        )  # fmt: skip
    rows, lanes = np.nonzero(solid.counted)
    found = lines[:, rows, :, lanes].swapaxes(0, 1)
    visible = least[:, rows, lanes] >= found[..., 2] - solid.tolerance
    part = np.searchsorted(solid.firsts, rows, side="right") - 1
    return Silhouettes(found[..., :2], found[..., 3:], visible, part)

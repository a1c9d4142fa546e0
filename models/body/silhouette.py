"""Outlines of upper bodies in the picture, many poses at once."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..numerics.threads import over_bands
from .kernels.silhouette import Solid, outlines
from .poses import BodyPoses
from .upper_body import UpperBody

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

OUTLINE_PARTS = (
    "head", "torso", "left_upper_arm", "left_forearm", "left_hand",
    "right_upper_arm", "right_forearm", "right_hand",
)  # fmt: skip
"""Parts that have outlines of their own."""

_COUNTS = {"head": 18, "torso": 24, "upper_arm": 12, "forearm": 12, "hand": 9}
"""Points of each part, so that they are about a quarter of a head apart."""

_HEAD_DEPTH = 0.85
"""Depth of a head over its height."""

_RIM = np.float32(0.06)
"""Share of a part's squared radius that hides nothing, so that ends that touch do not hide each other."""

_WORTH_THREADS = 500
"""Poses from which several threads are faster than one."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Outlines of the parts of `n` bodies, `m` points each.

    Parameters
    ----------
    points
        `(n, m, 2)` px, float32: x to the right, y down.
    normals
        `(n, m, 2)` float32: of unit length, out of the part.
    visible
        `(n, m)`: not hidden by another part; ends of limbs that are inside their neighbours are hidden too.
    part
        `(m,)`: number of the part in `OUTLINE_PARTS`, the same for all poses.
    """

    points: Floats
    normals: Floats
    visible: NDArray[np.bool_]
    part: NDArray[np.intp]


def silhouettes(body: UpperBody, poses: BodyPoses) -> Silhouettes:
    """Outlines of `poses`: ellipse of the head, tapered limbs, torso's sides and shoulders, round hands."""
    n = len(poses)
    solid = solid_of(body)
    m = len(solid.circles)
    points, normals = np.empty((n, m, 2), np.float32), np.empty((n, m, 2), np.float32)
    visible = np.empty((n, m), np.bool_)

    def trace(first: int, end: int) -> None:
        rows = slice(first, end)
        outlines(
            poses.roots[rows], poses.torsos[rows], poses.necks[rows], poses.arms[rows], solid,
            points[rows], normals[rows], visible[rows],
        )  # fmt: skip

    if n < _WORTH_THREADS:
        trace(0, n)
    else:
        over_bands(trace, n)
    part = np.repeat(np.arange(len(OUTLINE_PARTS)), np.diff(solid.firsts))
    return Silhouettes(points, normals, visible, part)


@lru_cache(maxsize=8)
def solid_of(body: UpperBody) -> Solid:
    """The body as compiled loops take it."""
    lengths = np.array(
        [
            body.neck,
            body.head_width / 2, body.head_height / 2, _HEAD_DEPTH * body.head_height / 2,
            body.shoulder_width, body.upper_arm, body.forearm, body.hand,
            body.upper_arm_width / 2, body.forearm_width / 2, body.wrist_width / 2,
            # the plane of the torso is a little behind the shoulders: arms that hang are seen whole
            0.1 * body.head_height,
        ]
    )  # fmt: skip
    # half widths from the chin down: neck, its foot, top of the shoulder, armpit, lower end
    neck, shoulder, thick = 0.3 * body.head_width, body.shoulder_width / 2, body.upper_arm_width
    knots = np.array(
        [
            [-body.neck, neck],
            [-min(0.75 * thick, 0.9 * body.neck), neck],
            [-min(0.5 * thick, 0.6 * body.neck), shoulder],
            [min(0.5 * thick, 0.5 * body.torso_height), shoulder - min(0.2 * thick, 0.5 * shoulder)],
            [body.torso_height, body.torso_width / 2],
        ]
    )
    drops, growth = np.diff(knots, axis=0).T
    pieces = np.column_stack([knots[:-1, 0], drops, knots[:-1, 1], growth / drops])
    points, normals = [], []
    for (top, narrow), (bottom, wide), count in ((knots[1], knots[2], 3), (knots[3], knots[4], 9)):
        share = (np.arange(count) + 0.5)[:, None] / count
        right = [narrow, top] + share * [wide - narrow, bottom - top]
        across = np.tile([bottom - top, narrow - wide], (count, 1)) / np.hypot(bottom - top, wide - narrow)
        points += [right, right * [-1, 1]]
        normals += [across, across * [-1, 1]]
    counts = [_COUNTS[name.removeprefix("left_").removeprefix("right_")] for name in OUTLINE_PARTS]
    turns = np.concatenate([2 * np.pi * (np.arange(count) + 0.5) / count for count in counts])
    return Solid(
        lengths,
        pieces.astype(np.float32),
        np.concatenate(points).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.stack([np.cos(turns), np.sin(turns)], axis=1).astype(np.float32),
        np.cumsum([0, *counts]),
        np.float32(0.02 * body.head_height),
        _RIM,
    )

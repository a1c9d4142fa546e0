"""Outlines of upper bodies in the picture, many poses at once."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from .kernels.silhouette import LANES, outlines
from .kernels.solids import Solid

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

OUTLINE_PARTS = (
    "head", "torso", "left_upper_arm", "left_forearm", "left_hand",
    "right_upper_arm", "right_forearm", "right_hand",
)  # fmt: skip
"""Parts that have outlines of their own."""

_COUNTS = {"head": 18, "torso": 24, "upper_arm": 12, "forearm": 12, "hand": 9}
"""Points of each part, so that they are about a quarter of a head apart."""

N_POINTS = (
    _COUNTS["head"] + _COUNTS["torso"] + 2 * (_COUNTS["upper_arm"] + _COUNTS["forearm"] + _COUNTS["hand"])
)
"""Of a whole outline."""

_HEAD_DEPTH = 0.85
"""Depth of a head over its height."""

_RIM = np.float32(0.06)
"""Share of a part's squared radius that hides nothing, so that ends that touch do not hide each other."""


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
    places = np.argwhere(solid.counted)
    m = len(places)
    points, normals = np.empty((n, m, 2), np.float32), np.empty((n, m, 2), np.float32)
    visible = np.empty((n, m), np.bool_)
    outlines(poses.roots, poses.torsos, poses.necks, poses.arms, solid, places, points, normals, visible)
    part = np.repeat(np.arange(len(OUTLINE_PARTS)), [_count(name) for name in OUTLINE_PARTS])
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
    counts = np.array([_count(name) for name in OUTLINE_PARTS])
    n_rows = -(-counts // LANES)
    firsts = np.cumsum([0, *n_rows])
    counted, circles = np.zeros((firsts[-1], LANES)), np.zeros((firsts[-1], 2, LANES))
    for part, count in enumerate(counts):
        place = np.arange(n_rows[part] * LANES).reshape(-1, LANES)
        turns = 2 * np.pi * (np.minimum(place, count - 1) + 0.5) / count
        rows = slice(firsts[part], firsts[part + 1])
        counted[rows], circles[rows, 0], circles[rows, 1] = place < count, np.cos(turns), np.sin(turns)
    half = _COUNTS["forearm"] // 2
    # one side from the limb's end to its beginning, and the other one back
    steps = np.minimum(np.arange(LANES), 2 * half - 1) - half + 0.5
    contour = np.concatenate([np.concatenate(points), np.concatenate(normals)], axis=1)
    contour = contour[np.minimum(np.arange(n_rows[1] * LANES), len(contour) - 1)]
    return Solid(
        lengths,
        pieces.astype(np.float32),
        contour.reshape(-1, LANES, 4).swapaxes(1, 2).astype(np.float32, order="C"),
        circles.astype(np.float32),
        np.array([np.abs(steps), np.sign(steps), np.full(LANES, half)], np.float32),
        firsts,
        counted.astype(np.float32),
        np.float32(0.02 * body.head_height),
        _RIM,
    )


def _count(name: str) -> int:
    """Points of a part's outline."""
    return _COUNTS[name.removeprefix("left_").removeprefix("right_")]

"""Points of persons that a detector of poses or hands has found in a frame."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .short_repr import short_repr

Array = NDArray[np.float64]

KEYPOINTS = (
    "head", "neck", "left_shoulder", "left_elbow", "left_hand", "right_shoulder", "right_elbow", "right_hand",
    "left_wrist", "right_wrist",
)  # fmt: skip
"""Points that count: the joints of `UpperBody`, then the wrists. Left is the person's own; head and hands are
centres, the neck is between the shoulders."""

EYES, EARS, NOSE = ("left_eye", "right_eye"), ("left_ear", "right_ear"), "nose"

POINTS = (*KEYPOINTS, NOSE, *EYES, *EARS)
"""What a detector may give: points of the face say where the head is."""

_UNUSED = (
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip

COCO = (
    NOSE, *EYES, *EARS, "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", *_UNUSED,
)  # fmt: skip
"""The 17 points of COCO, in their order."""

BODY_25 = (
    NOSE, "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
    "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
)  # fmt: skip
"""The 25 points of OpenPose's model BODY_25."""

MEDIAPIPE = (
    NOSE, "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
"""The 33 landmarks of MediaPipe's pose."""

SKELETONS: Mapping[int, tuple[str, ...]] = {
    len(names): names
    for names in (KEYPOINTS[:8], KEYPOINTS, COCO, (*BODY_25[:8], *BODY_25[9:19]), BODY_25, MEDIAPIPE)
}
"""Names of points, by how many there are: the 8 joints, these with the wrists, COCO's 17, OpenPose's 18 and
25, MediaPipe's 33."""

KNOWN = frozenset(POINTS).union(*SKELETONS.values())
"""All names of points; of those that are not among `POINTS`, nothing is made."""


@short_repr
@dataclass(frozen=True, eq=False)
class GivenKeypoints:
    """Points of persons that a detector has found in a frame: perhaps of nobody, but it did run.

    Parameters
    ----------
    positions
        `(n, 10, 2)` float64 px of n persons, in the order of `KEYPOINTS`; NaN where a point was not found.
    scores
        `(n, 10)` float64: how sure the detector is, 1 for wholly and more for nothing else; 0 where a point
        was not found.

    Raises
    ------
    ValueError
        if the shapes do not fit, or a point that was found has no finite place and score.
    """

    positions: Array
    scores: Array

    def __post_init__(self) -> None:
        n = len(self.positions)
        if self.positions.shape != (n, len(KEYPOINTS), 2) or self.scores.shape != (n, len(KEYPOINTS)):
            raise ValueError(
                f"keypoints: got positions {self.positions.shape} and scores {self.scores.shape}, expected "
                f"(n, {len(KEYPOINTS)}, 2) and (n, {len(KEYPOINTS)})"
            )
        found = self.scores > 0
        if not (np.isfinite(self.scores).all() and np.isfinite(self.positions[found]).all()):
            raise ValueError("keypoints: got a place or a score that is not finite, expected finite ones")
        if not np.isnan(self.positions[~found]).all():
            raise ValueError("keypoints: got places of points without a score, expected NaN")

    @classmethod
    def named(cls, points: Array) -> Self:
        """Points by all names that a detector may use: of the face's, the head's centre is made.

        Eyes and ears are at half the head's height: the head is taken to be between the middles of both. The
        nose is less exact, and counts where there is nothing else.

        Parameters
        ----------
        points
            `(n, 15, 3)`: x, y px and score of each of `POINTS`; what has no place or no score above 0 was not
            found.

        Raises
        ------
        ValueError
            if the shape does not fit, or a number is infinite.
        """
        if points.ndim != 3 or points.shape[1:] != (len(POINTS), 3):
            raise ValueError(f"keypoints: got {points.shape}, expected (n, {len(POINTS)}, 3): x, y, score")
        if np.isinf(points).any():
            raise ValueError("keypoints: got infinity, expected px and scores")
        known = np.isfinite(points).all(axis=2) & (points[..., 2] > 0)
        points = np.where(known[..., None], points, np.nan)
        eyes, ears = (_middle(points[:, [POINTS.index(name) for name in pair]]) for pair in (EYES, EARS))
        face = _middle(np.stack([eyes, ears], axis=1))
        places = points[:, : len(KEYPOINTS)].copy()
        for other in (face, points[:, POINTS.index(NOSE)]):
            places[:, 0] = np.where(np.isnan(places[:, 0]), other, places[:, 0])
        return cls(places[..., :2], np.nan_to_num(places[..., 2]))

    @classmethod
    def of(cls, found: Any) -> Self:
        """Take points as other libraries give them.

        Parameters
        ----------
        found
            anything with `xy` `(n, m, 2)` and perhaps `confidence` or `conf` `(n, m)`, as
            `supervision.KeyPoints` or the keypoints of Ultralytics; or an array `(n, m, 2)` or `(n, m, 3)`
            with scores, or of one person without the first axis; m points as in one of `SKELETONS`; or
            of one person a mapping of names to x, y and perhaps a score. Px from 0. Points at 0, 0 were not
            found, as these libraries have it. Nothing in it is nobody.

        Raises
        ------
        ValueError
            if it is none of these, or as for `GivenKeypoints`.
        """
        if isinstance(found, cls):
            return found
        if isinstance(found, Mapping):
            return cls.named(_points(tuple(found), [[_point(name, place) for name, place in found.items()]]))
        if hasattr(found, "xy"):
            scores = next(
                (s for s in (getattr(found, a, None) for a in ("confidence", "conf")) if s is not None), None
            )
            found = np.array(found.xy, np.float64)
            if scores is not None and found.size:
                found = np.concatenate([found, np.array(scores, np.float64)[..., None]], axis=-1)
        try:
            rows = np.array(found, np.float64)
        except (TypeError, ValueError):
            raise ValueError(
                f"keypoints: got {type(found).__name__}, expected an array, xy or names"
            ) from None
        if not rows.size:
            return cls.nobody()
        rows = rows[None] if rows.ndim == 2 else rows
        if rows.ndim != 3 or rows.shape[1] not in SKELETONS or rows.shape[2] not in (2, 3):
            counts = ", ".join(map(str, sorted(SKELETONS)))
            raise ValueError(
                f"keypoints: got {rows.shape}, expected (n, m, 2) or (n, m, 3), m among {counts}"
            )
        if rows.shape[2] == 2:
            rows = np.concatenate([rows, np.ones((*rows.shape[:2], 1))], axis=2)
        rows[(rows[..., :2] == 0).all(axis=2)] = np.nan
        return cls.named(_points(SKELETONS[rows.shape[1]], rows))

    @classmethod
    def nobody(cls) -> Self:
        """The detector ran, and found nobody."""
        return cls(np.zeros((0, len(KEYPOINTS), 2)), np.zeros((0, len(KEYPOINTS))))

    def __len__(self) -> int:
        return len(self.positions)


def _points(names: tuple[str, ...], rows: Any) -> Array:
    """`(n, 15, 3)` in the order of `POINTS`, of `(n, m, 3)` in that of m names; what is not there is NaN."""
    given = np.array(rows, np.float64)
    points = np.full((len(given), len(POINTS), 3), np.nan)
    for place, name in enumerate(names):
        if name in POINTS:
            points[:, POINTS.index(name)] = given[:, place]
    return points


def _point(name: object, place: Any) -> tuple[float, float, float]:
    """x, y and score of a point by its name."""
    if name not in KNOWN:
        raise ValueError(f"keypoints: got {str(name)[:60]!r}, expected names such as {', '.join(KEYPOINTS)}")
    try:
        x, y, *score = (float(number) for number in place)
        (certainty,) = score or (1.0,)
    except (TypeError, ValueError):
        raise ValueError(
            f"keypoints: got a {name} that is not x, y and perhaps a score, in numbers"
        ) from None
    return x, y, certainty


def _middle(points: Array) -> Array:
    """`(n, 3)`: the mean of those of `(n, m, 3)` that were found."""
    found = ~np.isnan(points[..., :1])
    with np.errstate(invalid="ignore"):
        middle: Array = np.where(found, points, 0.0).sum(axis=1) / found.sum(axis=1)
    return middle

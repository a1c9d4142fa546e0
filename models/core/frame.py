"""A frame: an image, detections in it, its time and its number."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from .checks import Shape, checked
from .short_repr import Rows, short_repr

Array = NDArray[np.float64]

KEYPOINTS = (
    "head", "neck", "left_shoulder", "left_elbow", "left_hand", "right_shoulder", "right_elbow", "right_hand",
    "left_wrist", "right_wrist",
)  # fmt: skip
"""Points that count: the joints of `UpperBody`, then the wrists. Left is the person's own; head and hands are
centres, the neck is between the shoulders."""

LARGEST_COORDINATE = 1e6
"""px: far beyond any image, so that a box that large is an error."""

LARGEST_SCORE = 1e100  # of a detector, whose square is a finite number, too

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
"""All names of points; those that are not among `POINTS` are ignored."""


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class GivenKeypoints:
    """Keypoints of persons in a frame from a detector that ran, possibly none.

    Parameters
    ----------
    positions
        `(n, 10, 2)` float64 px of n persons, in the order of `KEYPOINTS`; NaN where a point was not found.
    scores
        `(n, 10)` float64 scores from 0 (not found) to 1; higher ones count as 1.

    Raises
    ------
    ValueError
        if the shapes do not fit, or a point that was found has no finite place and score.
    """

    positions: Annotated[Array, Shape("n", len(KEYPOINTS), 2, finite=False)]
    scores: Annotated[Array, Shape("n", len(KEYPOINTS), finite=False)]

    def __post_init__(self) -> None:
        found = self.scores > 0
        if not (np.isfinite(self.scores).all() and np.isfinite(self.positions[found]).all()):
            raise ValueError("keypoints: got a place or a score that is not finite, expected finite ones")
        if not np.isnan(self.positions[~found]).all():
            raise ValueError("keypoints: got places of points without a score, expected NaN")

    @classmethod
    def named(cls, points: Array) -> Self:
        """Return keypoints from `(n, 15, 3)` x, y px and score of each of `POINTS`; score 0 is not detected.

        The centre of the head is computed from the points of the face: the middle between eyes and ears, or
        the less exact nose if there is nothing else.

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
    def of(cls, result: Any) -> Self:
        """Convert points from what other libraries give.

        Parameters
        ----------
        result
            anything with `xy` `(n, m, 2)` and perhaps `confidence` or `conf` `(n, m)`, as
            `supervision.KeyPoints` or the keypoints of Ultralytics; or an array `(n, m, 2)` or `(n, m, 3)`
            with scores, or of one person without the first axis; m points as in one of `SKELETONS`; or of one
            person a mapping of names to x, y and perhaps a score. Px from 0. Points at 0, 0 are not found, as
            in these libraries. An empty result has no person.

        Raises
        ------
        ValueError
            if it is none of these, or as for `GivenKeypoints`.
        """
        if isinstance(result, cls):
            return result
        if isinstance(result, Mapping):
            return cls.named(
                _points(tuple(result), [[_point(name, place) for name, place in result.items()]])
            )
        if hasattr(result, "xy"):
            scores, result = _attribute(result, "confidence", "conf"), np.array(result.xy, np.float64)
            if scores is not None and result.size:
                result = np.concatenate([result, scores.astype(np.float64)[..., None]], axis=-1)
        try:
            rows = np.array(result, np.float64)
        except (TypeError, ValueError):
            raise ValueError(
                f"keypoints: got {type(result).__name__}, expected an array, xy or names"
            ) from None
        if not rows.size:
            return cls.none()
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
    def none(cls) -> Self:
        """Return the points of a detector that ran and found no person."""
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


BoundingBox = tuple[float, float, float, float]
"""x, y of the top left corner, width and height, px."""


@short_repr
@dataclass(frozen=True, eq=False)
class GivenPoints(Rows):
    """Points in a frame, from another detector or tracker.

    Parameters
    ----------
    positions
        `(n, 2)` float64 px, columns and rows; NaN for one of them where only the other is known.
    identities
        `(n,)` int64, increasing: points of two frames with the same number belong to one track.

    Raises
    ------
    ValueError
        if the shapes do not fit, a position is not finite or missing, or the identities do not increase.
    """

    positions: Annotated[NDArray[np.float64], Shape("n", 2, finite=False)]
    identities: Annotated[NDArray[np.int64], Shape("n")]

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.identities), 2):
            raise ValueError(
                f"points: got positions {self.positions.shape} for {len(self.identities)} identities, "
                f"expected ({len(self.identities)}, 2)"
            )
        missing = np.isnan(self.positions)
        if np.isinf(self.positions).any() or missing.all(axis=1).any():
            raise ValueError("points: got a position that is not finite, expected finite ones")
        if (np.diff(self.identities) <= 0).any():
            raise ValueError("points: got identities that do not increase, expected each once, in order")


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class GivenBoxes:
    """Boxes of objects in a frame from a detector that ran, possibly none.

    Parameters
    ----------
    xyxy
        `(n, 4)` float64 px: left, top, right, bottom edges; 0 is the picture's left or top edge.
    confidence
        `(n,)` float64 scores on any scale, higher is better; by default all 1.
    classes
        `(n,)` names or numbers of the classes, if the detector has them.
    masks
        `(n, height, width)` bool over the picture, if the detector gives outlines.

    Raises
    ------
    ValueError
        if the shapes do not fit, a number is not finite or beyond 10^6 px (scores: 10^100), or a box is not
        wider and higher than 0.
    """

    xyxy: Annotated[NDArray[np.float64], Shape("n", 4, finite=False)]
    confidence: Annotated[NDArray[np.float64], Shape("n", finite=False)] | None = None
    classes: Annotated[NDArray[np.generic], Shape("n")] | None = None
    masks: Annotated[NDArray[np.bool_], Shape("n", "height", "width")] | None = None

    def __post_init__(self) -> None:
        for number, (left, top, right, bottom) in enumerate(self.xyxy.tolist()):
            near = np.abs(self.xyxy[number]).max() <= LARGEST_COORDINATE  # and no NaN
            if not (right - left > 0 and bottom - top > 0 and near):
                raise ValueError(
                    f"boxes: got {left:g}, {top:g}, {right:g}, {bottom:g} as box {number}, "
                    f"expected left < right and top < bottom, up to {LARGEST_COORDINATE:g} px"
                )
        if self.confidence is not None and not (np.abs(self.confidence) <= LARGEST_SCORE).all():
            raise ValueError(
                f"boxes: got a confidence beyond {LARGEST_SCORE:g}, or NaN, expected finite ones"
            )

    @classmethod
    def of(cls, result: Any) -> Self:
        """Convert boxes from what other libraries give.

        Parameters
        ----------
        result
            anything with `xyxy` and perhaps scores (`confidence` or `conf`), classes (`data["class_name"]`,
            `class_id` or `cls`) and `mask`, as `supervision.Detections` or the boxes of Ultralytics; or an
            array `(n, 4)`, `(n, 5)` or `(n, 6)`: left, top, right, bottom, score, number of the class;
            an empty one has no box. The values are copied.

        Raises
        ------
        ValueError
            if it is neither, or as for `GivenBoxes`.
        """
        if isinstance(result, cls):
            return result
        if hasattr(result, "xyxy"):
            data = getattr(result, "data", None)
            named = data.get("class_name") if isinstance(data, Mapping) else None
            classes = _attribute(result, "class_id", "cls") if named is None else np.array(named)
            confidence, masks = _attribute(result, "confidence", "conf"), _attribute(result, "mask")
            return cls(
                np.array(result.xyxy, np.float64).reshape(-1, 4),
                None if confidence is None else confidence.astype(np.float64),
                classes.astype(np.int64) if classes is not None and classes.dtype.kind == "f" else classes,
                None if masks is None else masks.astype(np.bool_),
            )
        try:
            rows = np.array(result, np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"boxes: got {type(result).__name__}, expected an array or xyxy") from None
        if not rows.size:
            rows = rows.reshape(0, 4)
        if rows.ndim != 2 or rows.shape[1] not in (4, 5, 6):
            raise ValueError(f"boxes: got {rows.shape}, expected (n, 4), (n, 5) or (n, 6)")
        if not np.isfinite(rows[:, 5:]).all():
            raise ValueError("boxes: got a class that is not finite, expected its number")
        score = rows[:, 4] if rows.shape[1] > 4 else None
        return cls(rows[:, :4], score, rows[:, 5].astype(np.int64) if rows.shape[1] > 5 else None)

    def __len__(self) -> int:
        return len(self.xyxy)


def _attribute(result: Any, *names: str) -> NDArray[Any] | None:
    """The first attribute that is there, as an array."""
    values = (getattr(result, name, None) for name in names)
    return next((np.array(each) for each in values if each is not None), None)


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a sequence, with its time and detections.

    Parameters
    ----------
    image
        `(height, width)` or `(height, width, 3)` uint8, BGR as OpenCV gives it; `None` for a frame that is
        missing or could not be read, or of which only points are known.
    time
        seconds since the start of the sequence.
    number
        1-based number of the frame in its source.
    points
        points in it, from another detector or tracker.
    boxes
        objects in it, from a detector; `None` where it did not run on this frame.
    keypoints
        points of persons in it, from a detector of poses or hands; `None` where it did not run.

    Raises
    ------
    ValueError
        if the image is empty or no such array, outlines of objects are of another size than it, the time is
        not finite, or the number is below 1.
    TypeError
        if one of them is of another type.
    """

    image: NDArray[np.uint8] | None
    time: float
    number: int
    points: GivenPoints | None = None
    boxes: GivenBoxes | None = None
    keypoints: GivenKeypoints | None = None

    def __post_init__(self) -> None:
        image = self.image
        if image is not None and not image.size:
            raise ValueError(f"image: got shape {image.shape} at frame {self.number}, expected pixels")
        if image is not None and (image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3)):
            raise ValueError(
                f"image: got {image.shape} {image.dtype} at frame {self.number}, "
                "expected (height, width) or (height, width, 3) uint8"
            )
        outlines = None if self.boxes is None else self.boxes.masks
        if image is not None and outlines is not None and outlines.shape[1:] != image.shape[:2]:
            raise ValueError(
                f"boxes: got masks {outlines.shape[1:]} at frame {self.number}, expected {image.shape[:2]}"
            )
        if self.number < 1:
            raise ValueError(f"number: got {self.number}, expected 1 or more (frames count from 1)")

    def required_image(self) -> NDArray[np.uint8]:
        """Return the image, without which a chain cannot start.

        Raises
        ------
        ValueError
            if there is none.
        """
        if self.image is None:
            raise ValueError(f"frame {self.number}: got no image, expected one to start from")
        return self.image

    @property
    def missing(self) -> bool:
        """Whether it has neither image nor detections."""
        given = self.image, self.points, self.boxes, self.keypoints
        return all(each is None for each in given)

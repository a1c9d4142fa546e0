"""A frame: an image, and what somebody else has found in it, with its time and its number."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .keypoints import GivenKeypoints
from .short_repr import short_repr

BoundingBox = tuple[float, float, float, float]
"""x, y of the top left corner, width and height, px."""


@short_repr
@dataclass(frozen=True, eq=False)
class GivenPoints:
    """Points that another detector or tracker has found in a frame.

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

    positions: NDArray[np.float64]
    identities: NDArray[np.int64]

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


@short_repr
@dataclass(frozen=True, eq=False)
class GivenBoxes:
    """Boxes of objects that a detector has found in a frame: perhaps none, but it did run.

    Parameters
    ----------
    xyxy
        `(n, 4)` float64 px: left, top, right, bottom edges; 0 is the picture's left or top edge.
    confidence
        `(n,)` float64 scores on any scale, the surer the higher; all 1 where they are left out.
    classes
        `(n,)` names or numbers of what the objects are, if the detector tells.
    masks
        `(n, height, width)` bool over the picture, if the detector gives outlines.

    Raises
    ------
    ValueError
        if the shapes do not fit, a number is not finite, or a box is not wider and higher than 0.
    """

    xyxy: NDArray[np.float64]
    confidence: NDArray[np.float64] | None = None
    classes: NDArray[np.str_] | NDArray[np.int64] | None = None
    masks: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        if self.xyxy.ndim != 2 or self.xyxy.shape[1] != 4:
            raise ValueError(f"boxes: got {self.xyxy.shape}, expected (n, 4): left, top, right, bottom")
        n_boxes = len(self.xyxy)
        for name in ("confidence", "classes", "masks"):
            values = getattr(self, name)
            if values is not None and (
                len(values) != n_boxes or values.ndim != (3 if name == "masks" else 1)
            ):
                raise ValueError(f"boxes: got {name} {values.shape} for {n_boxes} boxes")
        for number, (left, top, right, bottom) in enumerate(self.xyxy.tolist()):
            if not (right - left > 0 and bottom - top > 0 and np.isfinite(self.xyxy[number]).all()):
                raise ValueError(
                    f"boxes: got {left:g}, {top:g}, {right:g}, {bottom:g} as box {number}, "
                    "expected left < right and top < bottom, all finite"
                )
        if self.confidence is not None and not np.isfinite(self.confidence).all():
            raise ValueError("boxes: got a confidence that is not finite, expected finite ones")

    @classmethod
    def of(cls, found: Any) -> Self:
        """Take boxes as other libraries give them.

        Parameters
        ----------
        found
            anything with `xyxy` and perhaps scores (`confidence` or `conf`), classes (`data["class_name"]`,
            `class_id` or `cls`) and `mask`, as `supervision.Detections` or the boxes of Ultralytics; or an
            array `(n, 4)`, `(n, 5)` or `(n, 6)`: left, top, right, bottom, score, number of the class;
            nothing in it is no box. The values are copied.

        Raises
        ------
        ValueError
            if it is neither, or as for `GivenBoxes`.
        """
        if isinstance(found, cls):
            return found
        if hasattr(found, "xyxy"):
            data = getattr(found, "data", None)
            named = data.get("class_name") if isinstance(data, Mapping) else None
            classes = _told(found, "class_id", "cls") if named is None else np.array(named)
            confidence, masks = _told(found, "confidence", "conf"), _told(found, "mask")
            return cls(
                np.array(found.xyxy, np.float64).reshape(-1, 4),
                None if confidence is None else confidence.astype(np.float64),
                classes.astype(np.int64) if classes is not None and classes.dtype.kind == "f" else classes,
                None if masks is None else masks.astype(np.bool_),
            )
        try:
            rows = np.array(found, np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"boxes: got {type(found).__name__}, expected an array or xyxy") from None
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


def _told(found: Any, *names: str) -> NDArray[Any] | None:
    """The first of some attributes that is there, as an array."""
    values = (getattr(found, name, None) for name in names)
    return next((np.array(each) for each in values if each is not None), None)


@short_repr
@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a sequence.

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
        points that somebody else has found in it.
    boxes
        objects that a detector has found in it; `None` where it did not run on this frame.
    keypoints
        points of persons that a detector of poses or hands has found in it; `None` where it did not run.

    Raises
    ------
    ValueError
        if the image is neither `None` nor such an array, outlines of objects are of another size than it, or
        the number is below 1.
    """

    image: NDArray[np.uint8] | None
    time: float
    number: int
    points: GivenPoints | None = None
    boxes: GivenBoxes | None = None
    keypoints: GivenKeypoints | None = None

    def __post_init__(self) -> None:
        image = self.image
        if image is not None and (
            image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3)
        ):
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
        """Whether there is nothing to see in it."""
        given = self.image, self.points, self.boxes, self.keypoints
        return all(each is None for each in given)

"""Boxes that a detector has found in the frames of a film, by frame."""

from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame, GivenBoxes
from ....models.core.short_repr import short_repr
from ....models.files import LAST_FRAME
from ...options.complaints import meant
from ..point_files import FARTHEST

SHOWN_CLASSES = 10  # in a message


@short_repr
@dataclass(frozen=True, eq=False)
class Detections:
    """What a detector has found in the frames of a film; called with a frame, the boxes for it.

    Parameters
    ----------
    path
        of the file.
    frame
        `(n,)` int64, 1-based, ascending.
    xyxy
        `(n, 4)` float64 px from 0: left, top, right, bottom.
    confidence
        `(n,)` float64; `None` if the file tells none.
    class_index, class_names
        `(n,)` int32 into the names, and `(n_classes,)` text; `None` and none if the file tells none.
    place
        `(n,)` int64: where each stands in the file, in units of
    unit
        for instance "line".
    looked
        the frames on which the detector ran, whether it found something there or not.
    """

    path: Path
    frame: NDArray[np.int64]
    xyxy: NDArray[np.float64]
    confidence: NDArray[np.float64] | None
    class_index: NDArray[np.int32] | None
    class_names: NDArray[np.str_]
    place: NDArray[np.int64]
    unit: str
    looked: range | frozenset[int]

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> GivenBoxes | None:
        """The boxes of frame `number`, perhaps none; `None` where the detector did not run."""
        if number not in self.looked:
            return None
        rows = slice(*np.searchsorted(self.frame, [number, number + 1]))
        confidence = None if self.confidence is None else self.confidence[rows]
        classes = None if self.class_index is None else self.class_names[self.class_index[rows]]
        return GivenBoxes(self.xyxy[rows], confidence, classes)

    def __call__(self, frame: Frame) -> GivenBoxes | None:
        """The boxes of a frame, by its number."""
        return self.at(frame.number)

    def of_classes(self, names: Sequence[str]) -> "Detections":
        """Only the boxes of some classes; the detector ran where it did.

        Raises
        ------
        ValueError
            naming what there is, if there is no class of a name.
        """
        if self.class_index is None:
            raise ValueError(f"--classes: got {','.join(names)!r}, but {self.path} tells no classes")
        known = self.class_names.tolist()
        for name in names:
            if name not in known:
                there = ", ".join(known[:SHOWN_CLASSES]) + (", …" if len(known) > SHOWN_CLASSES else "")
                raise ValueError(f"--classes: got {name!r}, but {self.path} has {there}{meant(name, known)}")
        kept = np.isin(self.class_index, [known.index(name) for name in names])
        return replace(
            self,
            frame=self.frame[kept],
            xyxy=self.xyxy[kept],
            confidence=None if self.confidence is None else self.confidence[kept],
            class_index=self.class_index[kept],
            place=self.place[kept],
        )

    def counted(self, numbers: Collection[int]) -> dict[str, int]:
        """How many boxes there are in the frames of these numbers, and in how many it looked."""
        looked = [number for number in numbers if number in self.looked]
        return {"boxes": int(np.isin(self.frame, looked).sum()), "frames": len(looked)}

    def check(self, film: str, size: tuple[int, int], last: int | None) -> None:
        """Make sure that the boxes can be of a film.

        Parameters
        ----------
        film
            its name.
        size
            `(width, height)` px.
        last
            number of its last frame; `None` if that is not known.

        Raises
        ------
        ValueError
            if a frame comes after the last one, or a box lies beyond the picture.
        """
        end = self.looked[-1] if isinstance(self.looked, range) else max(self.looked)
        if last is not None and end > last:
            first = int(np.searchsorted(self.frame, last + 1))
            place = f", {self.unit} {self.place[first]}" if first < len(self) else ""
            number = self.frame[first] if place else end
            raise ValueError(f"{self.path}{place}: got frame {number}, but {film} has {last} frames")
        left, top, right, bottom = self.xyxy.T
        beyond = np.flatnonzero((right <= 0) | (bottom <= 0) | (left >= size[0]) | (top >= size[1]))
        if beyond.size:
            box = int(beyond[0])
            corners = ", ".join(f"{edge:g}" for edge in self.xyxy[box])
            raise ValueError(
                f"{self.path}, {self.unit} {self.place[box]}: got a box from {corners} (left, top, right, "
                f"bottom) in frame {self.frame[box]}, outside of the picture of {size[0]}x{size[1]} px"
            )


@dataclass(eq=False)
class Columns:
    """The rows of a file of detections, gathered one by one and checked.

    Parameters
    ----------
    path
        of the file.
    unit
        of places in it.
    """

    path: Path
    unit: str
    _frame: "array[int]" = field(default_factory=lambda: array("q"))
    _xyxy: "array[float]" = field(default_factory=lambda: array("d"))
    _confidence: "array[float]" = field(default_factory=lambda: array("d"))
    _class: "array[int]" = field(default_factory=lambda: array("i"))
    _place: "array[int]" = field(default_factory=lambda: array("q"))
    _classes: dict[str, int] = field(default_factory=dict)

    def add(
        self,
        place: int,
        frame: int,
        xyxy: tuple[float, float, float, float],
        confidence: float | None,
        class_name: str | None,
    ) -> None:
        """Append a detection.

        Raises
        ------
        ValueError
            naming the place, if a number is out of range, or some rows have a score or a class and others
            not.
        """
        left, top, right, bottom = xyxy
        if not (right > left and bottom > top):
            raise self.wrong(
                place, f"a box of {right - left:g} x {bottom - top:g} px", "a width and height above 0"
            )
        if not (min(left, top) >= -FARTHEST and max(right, bottom) <= FARTHEST):
            raise self.wrong(place, f"a box at {left:g}, {top:g}", f"px up to {FARTHEST:g}")
        if confidence is not None and not abs(confidence) < np.inf:
            raise self.wrong(place, f"a score of {confidence:g}", "a finite one")
        self._frame.append(frame)
        self._xyxy.extend(xyxy)
        self._place.append(place)
        if confidence is not None:
            self._confidence.append(confidence)
        if class_name is not None:
            self._class.append(self._classes.setdefault(class_name, len(self._classes)))
        if len(self._confidence) not in (0, len(self._frame)) or len(self._class) not in (
            0,
            len(self._frame),
        ):
            raise self.wrong(place, "scores or classes for some boxes only", "them for each or for none")

    def wrong(self, place: int, got: str, expected: str) -> ValueError:
        """What to raise for something wrong at a place."""
        return ValueError(f"{self.path}, {self.unit} {place}: got {got}, expected {expected}")

    def table(
        self,
        looked: frozenset[int] | None = None,
        frame_of: Callable[[int], int] | None = None,
        categories: Mapping[str, str] | None = None,
    ) -> Detections:
        """All of it, sorted by frame.

        Parameters
        ----------
        looked
            the frames on which the detector ran; `None`: as far as the rows tell (see `frames_looked_at`).
        frame_of
            makes 1-based numbers of frames of what stands in the rows, if those are something else.
        categories
            names of what stands in the rows as class, those that never occur among them.
        """
        keys = np.array(self._frame, np.int64)
        if frame_of is not None:
            distinct, inverse = np.unique(keys, return_inverse=True)
            keys = np.array([frame_of(int(key)) for key in distinct], np.int64)[inverse]
        order = np.argsort(keys, kind="stable")
        categories = categories or {}
        own = [categories.get(each, each) for each in self._classes]
        names = list(dict.fromkeys([*categories.values(), *own]))
        index = np.array([names.index(each) for each in own], np.int32)[np.array(self._class, np.int32)]
        return Detections(
            self.path,
            keys[order],
            np.array(self._xyxy, np.float64).reshape(-1, 4)[order],
            np.array(self._confidence, np.float64)[order] if self._confidence else None,
            index[order] if len(index) or not len(keys) else None,
            np.array(names, np.str_),
            np.array(self._place, np.int64)[order],
            self.unit,
            frames_looked_at(keys) if looked is None else looked,
        )


def frames_looked_at(found: NDArray[np.int64]) -> range | frozenset[int]:
    """The frames on which a detector ran, as far as those tell in which it found something.

    A file of boxes does not say where the detector ran and found nothing. It is taken to have run on every
    n-th frame from the first to the last that are listed, n being the least distance of two of them. Where
    that does not meet all of them, it ran irregularly, and on those that are listed. Before the first and
    after the last nothing is known. So a frame is taken for empty only between frames in which something was
    found at the same regular distance.

    Parameters
    ----------
    found
        `(n,)` numbers of frames, any order, repeated.
    """
    listed = np.unique(found)
    if len(listed) < 2:
        return frozenset(listed.tolist())
    steps = np.diff(listed)
    stride = int(steps.min())
    if (steps % stride).any():
        return frozenset(listed.tolist())
    return range(int(listed[0]), int(listed[-1]) + 1, stride)


def whole_frame(value: float) -> bool:
    """Whether a number is one of a frame."""
    return 1 <= value <= LAST_FRAME and value % 1 == 0

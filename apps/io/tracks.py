"""Tracks of objects as boxes in the frames of a film: `tracks.csv`, and files in MOT format."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any, Protocol, TextIO, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.core.frame import BoundingBox
from ...models.files import LAST_FRAME
from .files import LineWriter
from .point_files import MAX_COORDINATE
from .tables import Row, is_frame, lines_of

TABLE = "tracks.csv"

PICTURES = "img1"
"""MOTChallenge's folder of a sequence has its pictures in a folder of this name."""

COLUMNS: dict[str, type] = {
    "frame": np.int64,
    "time": np.float64,
    "id": np.int64,
    "x": np.float64,
    "y": np.float64,
    "width": np.float64,
    "height": np.float64,
    "confidence": np.float64,
    "vx": np.float64,
    "vy": np.float64,
    "seen": np.bool_,
}
"""Frames and identities count from 1; times are in s, places and sizes in px from 0, velocities in px/s."""

HEADER = ",".join(COLUMNS)

OF_OBJECTS = tuple(COLUMNS)[2:]
"""Columns that are an object's own."""

LAST_IDENTITY = 1 << 53
"""Whole numbers up to it are exact among those that are read."""

TRACK_FIELDS = np.dtype(
    [("frame", np.int64), ("id", np.int64), ("box", np.float64, (4,)), ("confidence", np.float64)]
)


@runtime_checkable
class TrackedObject(Protocol):
    """What is reported of a track in a frame."""

    @property
    def identity(self) -> int:
        """The number that stays with the object."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """X and y of the upper left corner (0-based), width and height, px."""

    @property
    def confidence(self) -> float:
        """How sure the tracker is of it, 0 to 1."""

    @property
    def velocity(self) -> tuple[float, float]:
        """To the right and down, px/s; NaN where that is not known."""

    @property
    def seen(self) -> bool:
        """Whether the frame shows it, or it is only predicted."""

    @property
    def position_covariance(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Of the middle of the box along x and y, px^2; NaN where that is not known."""


@dataclass(frozen=True)
class TrackedBox:
    """A tracked object of which perhaps nothing else is known; fields as of `TrackedObject`."""

    identity: int
    box: BoundingBox
    confidence: float = 1.0
    velocity: tuple[float, float] = (math.nan, math.nan)
    seen: bool = True
    position_covariance: tuple[tuple[float, float], tuple[float, float]] = ((math.nan,) * 2,) * 2


def mot_line(number: int, track: TrackedObject) -> str:
    """A box (0-based px) in MOT format: frame, id, x, y, width, height, confidence, -1, -1, -1.

    Frames and pixels count from 1 in MOT: the upper left corner of a box at (0, 0) is written as 1, 1.
    """
    x, y, width, height = track.box
    box = f"{x + 1:.2f},{y + 1:.2f},{width:.2f},{height:.2f}"
    return f"{number},{track.identity},{box},{track.confidence:.4f},-1,-1,-1"


class TrackWriter(LineWriter):
    """`tracks.txt` in MOT format."""

    def write(self, number: int, tracks: Sequence[TrackedObject]) -> None:
        """Append the boxes (0-based px) of a frame."""
        self.append(mot_line(number, track) for track in tracks)


def columns_of(tracks: Sequence[TrackedObject]) -> dict[str, NDArray[Any]]:
    """The columns of `COLUMNS` but frame and time, `(n,)` an object."""
    rows = [(track.identity, *track.box, track.confidence, *track.velocity, track.seen) for track in tracks]
    return {
        name: np.array(values, COLUMNS[name])
        for name, values in zip(OF_OBJECTS, zip(*rows, strict=True) if rows else repeat(()), strict=False)
    }


def table_lines(number: int, time: float, objects: Mapping[str, NDArray[Any]]) -> list[str]:
    """Lines of `tracks.csv` of a frame, whose objects, if any, have these columns."""
    rows = zip(*(objects[name].tolist() for name in OF_OBJECTS), strict=True) if objects else ()
    return [
        f"{number},{time:.6f},{identity},{x:.2f},{y:.2f},{width:.2f},{height:.2f},{confidence:.4f},"
        f"{_optional(vx)},{_optional(vy)},{seen:d}"
        for identity, x, y, width, height, confidence, vx, vy, seen in rows
    ]


def mot_lines(number: int, _time: float, objects: Mapping[str, NDArray[Any]]) -> list[str]:
    """Lines of `tracks.txt` (see `TrackWriter`) of a frame, whose objects, if any, have these columns."""
    rows = zip(*(objects[name].tolist() for name in OF_OBJECTS[:6]), strict=True) if objects else ()
    return [
        f"{number},{identity},{x + 1:.2f},{y + 1:.2f},{width:.2f},{height:.2f},{confidence:.4f},-1,-1,-1"
        for identity, x, y, width, height, confidence in rows
    ]


def _optional(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


@checked
def read_tracks(path: str | Path) -> NDArray[np.void]:
    """Read boxes in MOT format: results, detections or ground truth.

    Returns
    -------
    NDArray[np.void]
        one element a line, in the file's order, with the fields of `TRACK_FIELDS`: `frame` (1-based), `id`,
        `box` (x, y, width, height in px with 0-based x and y, so MOT's minus 1) and `confidence` (1 where the
        line ends before it; ground truth has 0 for boxes not to be judged).

    Raises
    ------
    ValueError
        naming file and line, if a line is no such box.
    """
    rows = []
    for _, (frame, identity, x, y, w, h, *others) in mot_rows(Path(path)):
        rows.append((int(frame), int(identity), (x - 1, y - 1, w, h), others[0] if others else 1.0))
    return np.array(rows, dtype=TRACK_FIELDS)


def mot_rows(path: Path) -> Iterator[tuple[Row, list[float]]]:
    """Lines of a file in MOT format, separated by commas or blanks: where each stands, and its numbers.

    These are frame, identity, x, y, width and height as they are there (px from 1), and whatever follows.
    Blank lines are left out; a line that is no such box is a ValueError that names it.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        yield from mot_rows_of(file, str(path))


def mot_rows_of(file: TextIO, name: str) -> Iterator[tuple[Row, list[float]]]:
    """What `mot_rows` reads, of a text that is open and is called `name` in messages."""
    for place, line in enumerate(lines_of(file), start=1):
        if "\0" in line:
            raise ValueError(f"{name}: got binary data, expected MOT boxes")
        if line.strip():
            row = Row(name, "line", place, {})
            try:
                numbers = [float(field) for field in line.replace(",", " ").split()]
            except ValueError:
                numbers = []
            if len(numbers) < 6 or not math.isfinite(sum(numbers[:6])):
                raise row.wrong(
                    f"{line.strip()[:60]!r}",
                    "frame,identity,left,top,width,height[,flag or confidence [,class,visibility]]",
                )
            check_box(row, "identity", numbers[0], numbers[1], numbers[2:6])
            yield row, numbers


def check_box(row: Row, name: str, frame: float, identity: float, box: Sequence[float]) -> None:
    """Make sure that numbers of a row are a frame, an identity and a box (x, y, width, height, px).

    Raises
    ------
    ValueError
        naming the place, and the identity by its `name` there, if they are none.
    """
    left, top, width, height = box
    if not is_frame(frame) or identity % 1 or abs(identity) > LAST_IDENTITY:
        raise row.wrong(
            f"frame {frame:g}, {name} {identity:g}", f"whole numbers, frames from 1 to {LAST_FRAME}"
        )
    if min(width, height) < 0 or max(map(abs, box)) > MAX_COORDINATE:
        raise row.wrong(
            f"a box of {width:g} x {height:g} pixels at {left:g}, {top:g}",
            f"a size that is not negative and px up to {MAX_COORDINATE:g}",
        )

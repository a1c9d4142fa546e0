"""`tracks.csv`: all that is reported of tracked objects, one row an object and frame."""

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.files import LAST_FRAME
from ..io.mot import LineWriter, TrackedObject, check_box
from ..io.tables import Row, lines_of

TABLE = "tracks.csv"

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


class TrackTableWriter(LineWriter):
    """`tracks.csv`, with the columns of `COLUMNS`; seen is 1 or 0, a velocity that is not known is empty.

    Parameters
    ----------
    path
        of the file.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(self, path: str | Path, resume_after: int = 0) -> None:
        super().__init__(path, HEADER, resume_after)

    def write(self, number: int, time: float, tracks: Sequence[TrackedObject]) -> None:
        """Append the objects of frame `number` (from 1) at `time` (s)."""
        self.append(table_lines(number, time, columns_of(tracks)))


def columns_of(tracks: Sequence[TrackedObject]) -> dict[str, NDArray[Any]]:
    """The columns of `COLUMNS` but frame and time, `(n,)` an object."""
    rows = [(track.identity, *track.box, track.confidence, *track.velocity, track.seen) for track in tracks]
    return {
        name: np.array(values, COLUMNS[name])
        for name, values in zip(OF_OBJECTS, zip(*rows, strict=True) if rows else repeat(()), strict=False)
    }


def table_lines(number: int, time: float, objects: Mapping[str, NDArray[Any]]) -> list[str]:
    """Lines of `tracks.csv` of a frame, whose objects have these columns."""
    rows = zip(*(objects[name].tolist() for name in OF_OBJECTS), strict=True)
    return [
        f"{number},{time:.6f},{identity},{x:.2f},{y:.2f},{width:.2f},{height:.2f},{confidence:.4f},"
        f"{_known(vx)},{_known(vy)},{seen:d}"
        for identity, x, y, width, height, confidence, vx, vy, seen in rows
    ]


def mot_lines(number: int, objects: Mapping[str, NDArray[Any]]) -> list[str]:
    """Lines of `tracks.txt` (see `TrackWriter`) of a frame, whose objects have these columns."""
    rows = zip(*(objects[name].tolist() for name in OF_OBJECTS[:6]), strict=True)
    return [
        f"{number},{identity},{x + 1:.2f},{y + 1:.2f},{width:.2f},{height:.2f},{confidence:.4f},-1,-1,-1"
        for identity, x, y, width, height, confidence in rows
    ]


def _known(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def read_tracks_table(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read `tracks.csv` as columns, of which `pandas.DataFrame` and `polars.DataFrame` make a table.

    Parameters
    ----------
    path
        of the file, or of the folder of a run that holds it.

    Returns
    -------
    dict
        `(n_rows,)` arrays by the names and of the types of `COLUMNS`, in the order of the file.

    Raises
    ------
    ValueError
        naming file and line, if it is no such table.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    numbers = array("d")
    for row in table_rows(path / TABLE if path.is_dir() else path):
        numbers.extend(row)
    table = np.frombuffer(numbers, np.float64).reshape(-1, len(COLUMNS))
    return {name: table[:, k].astype(kind) for k, (name, kind) in enumerate(COLUMNS.items())}


def table_rows(path: Path) -> Iterator[list[float]]:
    """Rows of `tracks.csv` one by one, with the values of `COLUMNS`; raises as `read_tracks_table`."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = lines_of(file)
        header = next(lines, "").strip()
        if header != HEADER:
            raise ValueError(f"{path}, line 1: got {header[:60]!r}, expected {HEADER}")
        last_frame, last_time = 0.0, -math.inf
        for place, line in enumerate(lines, start=2):
            row = Row(path, "line", place, {})
            try:
                values = [float(field or math.nan) for field in line.rstrip("\n").split(",")]
            except ValueError:
                values = []
            if len(values) != len(COLUMNS) or not math.isfinite(sum(values[:8])):  # velocities may be unknown
                raise row.wrong(f"{line.strip()[:60]!r}", f"numbers {HEADER}")
            frame, time, identity, seen = *values[:3], values[-1]
            check_box(row, "id", frame, identity, values[3:7])
            if abs(time) > LAST_FRAME:
                raise row.wrong(f"time {time:g}", f"s up to {LAST_FRAME}")
            if seen not in (0, 1):
                raise row.wrong(f"seen {seen:g}", "0 or 1")
            if frame < last_frame or time < last_time:
                raise row.wrong(
                    f"frame {frame:.0f} at {time:g} s after frame {last_frame:.0f} at {last_time:g} s",
                    "frames and times that ascend",
                )
            last_frame, last_time = frame, time
            yield values

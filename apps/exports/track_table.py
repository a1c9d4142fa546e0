"""`tracks.csv`: all that is reported of tracked objects, one row an object and frame."""

import math
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.files import LAST_FRAME
from ..io.mot import LAST_IDENTITY, LONGEST_LINE, LineWriter, TrackedObject, box_columns
from ..io.point_files import FARTHEST

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
        self.append(
            f"{number},{time:.6f},{track.identity},{box_columns(track)},{track.confidence:.4f},"
            f"{_known(track.velocity[0])},{_known(track.velocity[1])},{track.seen:d}"
            for track in tracks
        )


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
        header = file.readline(LONGEST_LINE).strip()
        if header != HEADER:
            raise ValueError(f"{path}, line 1: got {header[:60]!r}, expected {HEADER}")
        last = [0.0, -math.inf]
        for place, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), start=2):
            try:
                row = _parse_line(line)
                if row[0] < last[0] or row[1] < last[1]:
                    raise ValueError(
                        f"got frame {row[0]:.0f} at {row[1]:g} s after frame {last[0]:.0f} at {last[1]:g} s, "
                        "expected frames and times that ascend"
                    )
            except ValueError as error:
                raise ValueError(f"{path}, line {place}: {error}") from None
            last = row
            yield row


def _parse_line(line: str) -> list[float]:
    try:
        values = [float(field or math.nan) for field in line.rstrip("\n").split(",")]
    except ValueError:
        values = []
    if len(values) != len(COLUMNS) or not math.isfinite(sum(values[:8])):  # velocities may be unknown
        raise ValueError(f"got {line.strip()[:60]!r}, expected numbers {HEADER}")
    frame, identity, seen = values[0], values[2], values[-1]
    if not 1 <= frame <= LAST_FRAME or frame % 1 or identity % 1 or abs(identity) > LAST_IDENTITY:
        raise ValueError(
            f"got frame {frame:g}, id {identity:g}, expected whole numbers, frames from 1 to {LAST_FRAME}"
        )
    if min(values[5:7]) < 0 or max(map(abs, values[3:7])) > FARTHEST or abs(values[1]) > LAST_FRAME:
        raise ValueError(
            f"got a box {line.strip()[:60]!r}, expected a size that is not negative, px up to {FARTHEST:g} "
            f"and s up to {LAST_FRAME}"
        )
    if seen not in (0, 1):
        raise ValueError(f"got seen {seen:g}, expected 0 or 1")
    return values

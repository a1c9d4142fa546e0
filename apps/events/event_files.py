"""`events.csv`: one row an event, written as they come and read back."""

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ...models.files.atomic_files import naming
from ..exports.track_table import read_tracks_table
from ..io.mot import LineWriter, TrackedObject
from .watch import Event, Kind, Moment, Sighting, Watch
from .zones import Zones

EVENTS = "events.csv"

COLUMNS = ("time", "frame", "event", "zone", "id", "x", "y", "duration", "direction")
"""s, from 1, kind, name of the zone or line, identity, foot in px, s or empty, direction or empty."""


class EventWriter(LineWriter):
    """`events.csv`, with the columns of `COLUMNS`, in the order in which events are known.

    Those of a run that goes on are found again from its table of tracks: nothing is saved.

    Parameters
    ----------
    path
        of the file.
    zones
        to look after.
    tracks
        `tracks.csv` of the same run.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(self, path: Path, zones: Zones, tracks: Path, resume_after: int = 0) -> None:
        super().__init__(path, ",".join(COLUMNS))
        self._watch = Watch(zones)
        self._last = resume_after
        if resume_after:
            for time, number, sightings in sightings_of(read_tracks_table(tracks), resume_after):
                self.append(map(line_of, self._watch.take_in(time, number, sightings)))

    def write(self, number: int, time: float, tracks: Sequence[TrackedObject]) -> list[Event]:
        """Append what happens in a frame, which is returned; who reads along sees it at once."""
        self._last = number
        found = self._watch.take_in(round(time, 6), number, map(sighting, tracks))
        if found:
            self.append(map(line_of, found))
            with naming(self._path):
                self._file.flush()
        return found

    def close(self) -> None:
        """Complete the file with what ends with the last frame; a run that goes on drops that again."""
        try:
            self.append(map(line_of, self._watch.end(self._last)))
        finally:
            super().close()


def sighting(track: TrackedObject) -> Sighting:
    """Foot and height of an object, rounded as in `tracks.csv`, so that both give the same events."""
    x, y, width, height = (round(float(value), 2) for value in track.box)
    return Sighting(track.identity, x + width / 2, y + height, height, bool(track.seen))


def sightings_of(
    table: dict[str, Any], last: int | None = None
) -> Iterator[tuple[float, int, list[Sighting]]]:
    """Time, number and who is there, of every frame of a table with somebody, up to frame `last`."""
    frames = table["frame"]
    if last is not None:
        table = {
            name: column[: np.searchsorted(frames, last, side="right")] for name, column in table.items()
        }
        frames = table["frame"]
    edges = np.flatnonzero(np.diff(frames, prepend=-1, append=-1)).tolist() if len(frames) else []
    columns = [table[name] for name in ("id", "x", "y", "width", "height", "seen")]
    for start, stop in pairwise(edges):
        rows = zip(*(column[start:stop].tolist() for column in columns), strict=True)
        sightings = [Sighting(who, x + w / 2, y + h, h, seen) for who, x, y, w, h, seen in rows]
        yield float(table["time"][start]), int(frames[start]), sightings


def line_of(event: Event) -> str:
    """An event as a line of the file."""
    time, frame, x, y = event.moment
    written = io.StringIO()
    csv.writer(written, lineterminator="").writerow(
        (
            f"{time:.3f}",
            frame,
            event.kind,
            event.zone,
            event.identity,
            f"{x:.2f}",
            f"{y:.2f}",
            "" if event.duration is None else f"{event.duration:.3f}",
            event.direction,
        )
    )
    return written.getvalue()


def read_events(path: str | Path) -> list[Event]:
    """Read what `EventWriter` wrote.

    Raises
    ------
    ValueError
        naming file and line, if it is no such file.
    OSError
        if it cannot be read.
    """
    path, found = Path(path), []
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        if tuple(next(rows, ())) != COLUMNS:
            raise ValueError(f"{path}: got another header, expected {','.join(COLUMNS)}")
        for row in rows:
            try:
                time, frame, kind, zone, identity, x, y, duration, direction = row
                moment = Moment(float(time), int(frame), float(x), float(y))
                lasted = float(duration) if duration else None
                found.append(Event(moment, Kind(kind), zone, int(identity), lasted, direction))
            except ValueError:
                got, where = ",".join(row)[:60], f"{path}, line {rows.line_num}"
                raise ValueError(f"{where}: got {got!r}, expected an event") from None
    return found

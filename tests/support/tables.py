"""Tables of tracks as a run writes them."""

from collections.abc import Sequence
from pathlib import Path

from rsmcm.apps.io.files import LineWriter
from rsmcm.apps.io.tracks import HEADER, TrackedObject, columns_of, table_lines


class TrackTableWriter(LineWriter):
    """`tracks.csv`, frame after frame."""

    def __init__(self, path: str | Path, resume_after: int = 0) -> None:
        super().__init__(path, HEADER, resume_after)

    def write(self, number: int, time: float, tracks: Sequence[TrackedObject]) -> None:
        self.append(table_lines(number, time, columns_of(tracks)))

"""Tables of tracks as a run writes them."""

from collections.abc import Sequence
from pathlib import Path

from rsmcm.apps.io.files import LineWriter
from rsmcm.apps.io.tracks import HEADER, TrackedObject, columns_of, table_lines


class TrackTableWriter(LineWriter):
    """`tracks.csv`, frame after frame."""

    def __init__(self, path: str | Path, resume_after: int = 0) -> None:
        there = Path(path).read_text().splitlines()[1:] if resume_after else []
        super().__init__(path, [HEADER, *(line for line in there if int(line.split(",")[0]) <= resume_after)])

    def write(self, number: int, time: float, tracks: Sequence[TrackedObject]) -> None:
        self.append(table_lines(number, time, columns_of(tracks)))

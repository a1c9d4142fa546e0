"""Folders of finished runs, read again."""

import errno
import json
import math
import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.files import LAST_FRAME, read_text
from ..io.sources.images import images_among, read_grey
from ..io.tables import Row, lines_of
from ..io.tracks import COLUMNS, HEADER, TABLE, TrackedBox, check_box
from ..runs.output_folder import application_of

SUMMARY = "summary.json"


class RunFrame(NamedTuple):
    """Frame of a background run: its number from 1, and its objects, whose covariances are NaN.

    `foreground` is `(height, width)` uint8, 0 or 255; `None` without a mask.
    """

    number: int
    tracks: list[TrackedBox]
    foreground: NDArray[np.uint8] | None


@dataclass(frozen=True)
class FinishedRun:
    """Finished run of an application: its folder and the content of `summary.json`."""

    folder: Path
    application: str
    summary: dict[str, Any]

    @classmethod
    @checked
    def of(cls, folder: str | Path, *applications: str) -> "FinishedRun":
        """Open a folder of results, of one of these applications if any are named.

        Raises
        ------
        ValueError
            if no such run has finished in it.
        OSError
            if there is no such folder, or it cannot be read.
        """
        folder = Path(folder)
        if not folder.exists():
            raise FileNotFoundError(
                errno.ENOENT, "no such folder, expected the folder of a finished run", str(folder)
            )
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "expected the folder of a finished run", str(folder))
        application, path = application_of(folder), folder / SUMMARY
        if application is None or not path.exists():
            raise ValueError(f"{folder}: holds no results of a finished run of rsmcm")
        if applications and application not in applications:
            raise ValueError(
                f"{folder}: got results of rsmcm {application}, expected rsmcm {' or '.join(applications)}"
            )
        try:
            summary = json.loads(read_text(path, "expected a summary"))
        except (ValueError, RecursionError):
            summary = None
        if not isinstance(summary, dict):
            raise ValueError(f"{path}: got something else than JSON of a run's summary")
        return cls(folder, application, summary)

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)` px of the pictures."""
        size = self.summary.get("size")
        if not (isinstance(size, list) and len(size) == 2 and all(map(_is_count, size))):
            raise self._wrong("size", "two numbers of px")
        return size[0], size[1]

    @property
    def source_rate(self) -> float:
        """Frames a second of the source."""
        rate = self.summary.get("rate")
        if not isinstance(rate, int | float) or not 1e-6 < rate < 1e6:
            raise self._wrong("rate", "frames a second")
        return rate

    @property
    def rate(self) -> float:
        """Frames a second that were processed."""
        return self.source_rate / self.numbers.step

    @property
    def numbers(self) -> range:
        """Numbers of the processed frames; of a live stream, of dropped ones as well."""
        first, last = self.summary.get("first_frame", 0), self.summary.get("last_frame", 0)
        parameters = self.summary.get("parameters")
        step = parameters.get("step", 0) if isinstance(parameters, dict) else 0
        for value in (first, last, step):
            if not _is_count(value):
                raise self._wrong("first_frame, last_frame and parameters.step", "whole numbers from 1")
        numbers = range(int(first), int(last) + 1, int(step))
        if self.summary.get("stream") is None and self.summary.get("frames") != len(numbers):
            raise self._wrong("frames", f"{len(numbers)} from {first} to {last} in steps of {step}")
        return numbers

    @property
    def source(self) -> str:
        """Source of the run, as the user gave it."""
        return str(self.summary.get("source"))

    @property
    def picture_names(self) -> list[str]:
        """Names of the image files of the source, in order; empty unless it is an existing folder."""
        if not os.path.isdir(self.source):  # which asks for any text, unlike `Path.is_dir`
            return []
        return [path.name for path in images_among(Path(self.source).iterdir())]

    def frames(self, masks: bool = True) -> Iterator[RunFrame]:
        """Yield the frames of a background run, optionally with masks.

        Raises
        ------
        ValueError, OSError
            if tracks or masks are missing or damaged.
        """
        numbers, path = self.numbers, self.folder / TABLE
        pictures = self._masks(numbers) if masks else (None for _ in numbers)
        groups = groupby(table_rows(path), key=lambda row: int(row[0]))
        following = next(groups, None)
        for number, foreground in zip(numbers, pictures, strict=True):
            tracks = []
            if following is not None and following[0] == number:
                tracks = [_tracked(row) for row in following[1]]
                following = next(groups, None)
            yield RunFrame(number, tracks, foreground)
        if following is not None:
            raise ValueError(f"{path}: got objects of frame {following[0]}, which is none of the run's")

    def _masks(self, numbers: range) -> Iterator[NDArray[np.uint8] | None]:
        folder, video = self.folder / "foreground", self.folder / "foreground.mkv"
        if folder.is_dir():
            for number in numbers:
                path = folder / f"bin{number:06d}.png"
                yield self._checked(path, read_grey(path)) if path.exists() else None
        elif video.exists():
            if self.summary.get("frames") != len(numbers):
                raise ValueError(
                    f"{video}: which frames its pictures show is not known, since the stream has dropped "
                    "some; --masks png numbers them"
                )
            count = 0
            try:
                with av.open(str(video)) as container:
                    for picture in islice(container.decode(video=0), len(numbers) + 1):
                        count += 1
                        if count <= len(numbers):
                            yield self._checked(video, picture.to_ndarray(format="gray"))
            except av.FFmpegError as error:
                raise ValueError(f"{video}: got a damaged video ({error.strerror})") from None
            if count != len(numbers):
                got = "more" if count > len(numbers) else f"{count}"
                raise ValueError(f"{video}: got {got} pictures, expected {len(numbers)}, one a frame")
        else:
            yield from (None for _ in numbers)

    def _checked(self, path: Path, mask: NDArray[Any] | None) -> NDArray[np.uint8]:
        width, height = self.size
        if mask is None or mask.shape != (height, width):
            got = "no picture" if mask is None else f"{mask.shape[1]}x{mask.shape[0]} px"
            raise ValueError(f"{path}: got {got}, expected a mask of {width}x{height} px")
        return np.asarray(mask, np.uint8)

    def _wrong(self, name: str, expected: str) -> ValueError:
        return ValueError(
            f"{self.folder / SUMMARY}: got no {name} ({expected}), expected the summary of rsmcm "
            f"{self.application}"
        )


@checked
def read_tracks_table(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read `tracks.csv` as columns, from which `pandas.DataFrame` and `polars.DataFrame` make a table.

    Parameters
    ----------
    path
        of the file, or of the folder of a run.

    Returns
    -------
    dict
        `(n_rows,)` arrays by the names and of the types of `COLUMNS`, in the order of the file.

    Raises
    ------
    ValueError
        naming file and line, if it is no such table.
    """
    path = Path(path)
    numbers = array("d")
    for row in table_rows(path / TABLE if path.is_dir() else path):
        numbers.extend(row)
    table = np.frombuffer(numbers, np.float64).reshape(-1, len(COLUMNS))
    return {name: table[:, k].astype(kind) for k, (name, kind) in enumerate(COLUMNS.items())}


def table_rows(path: Path) -> Iterator[list[float]]:
    """Yield the rows of `tracks.csv`, with the values of `COLUMNS`; raises as `read_tracks_table`."""
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


def _is_count(value: object) -> bool:
    return isinstance(value, int) and 0 < value <= LAST_FRAME


def _tracked(row: list[float]) -> TrackedBox:
    _, _, identity, x, y, width, height, confidence, vx, vy, seen = row
    return TrackedBox(int(identity), (x, y, width, height), confidence, (vx, vy), bool(seen))

"""Segments: complete parts of a file that grows with the frames, named by their last frame."""

from collections.abc import Callable, Sequence
from pathlib import Path

from ...models.files import write_atomically


def segment_name(path: Path, last: int) -> Path:
    """Name of the segment of the file `path` whose last frame has that number."""
    return path.with_name(f"{path.stem}.part{last:09d}{path.suffix}")


def segments_of(path: Path, behind: int = 0) -> list[Path]:
    """The segments of the file `path` in order of time, of those that end behind a frame."""
    found = sorted(path.parent.glob(segment_pattern(path.name)))
    return [segment for segment in found if int(segment.stem.rpartition("part")[2]) > behind]


def segment_pattern(name: str) -> str:
    """What the segments of a file are called, as a pattern of `glob`."""
    path = Path(name)
    return f"{path.stem}.part[0-9]*{path.suffix}"


def drop_segments(path: Path, behind: int = 0) -> None:
    """Remove the segments of the file `path` that end behind a frame."""
    for segment in segments_of(path, behind):
        segment.unlink()


def join_segments(path: Path, join: Callable[[Sequence[Path], Path], None], *, finished: bool) -> None:
    """Write the whole file, by what joins its segments, if any; when the run is finished, remove them.

    Raises
    ------
    OSError
        if the file cannot be written; it is then as before.
    """
    segments = segments_of(path)
    if segments:
        with write_atomically(path) as unfinished:
            join(segments, unfinished)
    if finished:
        drop_segments(path)

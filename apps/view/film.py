"""The film behind `view.html`: small, without drawings, and what is to be drawn on each of its frames."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.array_files import Arrays, read_arrays, require_fields
from ...models.core.checks import MOST_PIXELS, NONE_NEGATIVE, Bound, Shape
from ...models.core.frame import Frame
from ...models.files import fitting, sync, write_atomically
from ..io.files import (
    PLAYABLE,
    SegmentedVideo,
    Worker,
    drop_segments,
    join_segments,
    segment_name,
    segments_of,
)

Image = NDArray[np.uint8]
Row = Mapping[str, NDArray[Any]]
"""What is drawn on a frame: arrays whose first axis may have another length in every frame."""

FILM, ROWS = "film.mp4", "view.npz"

EXPECTED = "expected the film of a run"
SIZES = Bound(
    lambda sizes: (sizes > 0).all() and 0 < sizes.prod(axis=1, dtype=float).max(initial=0) <= MOST_PIXELS,
    f"sizes of pictures of up to {MOST_PIXELS} px",
)
OF_FRAMES = {
    "number": Annotated[NDArray[np.int64], Shape("n_frames")],
    "time": Annotated[NDArray[np.float64], Shape("n_frames")],
    "size": Annotated[NDArray[np.int32], Shape("n_frames", 2), SIZES],
}
"""Arrays of `view.npz` with a value a frame."""
OF_COUNT = Annotated[NDArray[np.int64], Shape("n_frames"), NONE_NEGATIVE]

LONGEST_SIDE = 640  # px of the film
MOST_BYTES = 24 << 20
"""Of film and rows together, a third more in the page: beyond, the film's beginning goes."""

SEGMENT = 250  # pictures: as many as libx264 has between pictures that stand for themselves
AHEAD = 8  # frames that wait to be written while a run saves its state

SMALL = replace(PLAYABLE, options={**PLAYABLE.options, "crf": "28"})


class FilmWriter:
    """`film.mp4` and `view.npz`, of the last part of a run if it is long.

    Both grow by segments as `SegmentedVideo` does. Whenever they take more than `MOST_BYTES`, the oldest go,
    so that a stream may last for ever. A frame without image shows the one before.
    """

    def __init__(self, folder: Path, rate: float, resume_after: int | None = None) -> None:
        self._film, self._rows = folder / FILM, folder / ROWS
        self._video = SegmentedVideo(self._film, rate, SMALL, resume_after)
        self._stay = resume_after is not None
        drop_segments(self._rows, behind=resume_after or 0)
        self._drop_unpaired()
        self._worker = Worker("film", AHEAD)
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._image: Image | None = None
        self._size = np.zeros((1, 2), np.int32)  # of the source, px
        self._n_pictures = 0  # since the last segment
        self._last = 0  # number of the last frame

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._worker.stop()
        finally:
            self._cut()
            self._video.close()
            join_segments(self._rows, _join, stay=self._stay)

    def add(self, frame: Frame, view_row: Callable[[], Row]) -> None:
        """Append a frame, which must not change any more; `view_row` is called in a thread.

        An OSError, if it cannot be written, may come with a later frame.
        """
        self._worker.submit(self._add, frame, view_row)

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        self._worker.wait()
        self._cut()

    def _add(self, frame: Frame, view_row: Callable[[], Row]) -> None:
        if frame.image is not None:
            self._image = _small(frame.image)
            self._size = np.array([frame.image.shape[1::-1]], np.int32)
        if self._image is None:
            return  # nothing seen yet, not even the size
        self._video.write(self._image, frame.number, frame.time)
        self._columns.setdefault("number", []).append(np.array([frame.number]))
        self._columns.setdefault("time", []).append(np.array([frame.time]))
        self._columns.setdefault("size", []).append(self._size)
        for name, values in view_row().items():
            self._columns.setdefault(name, []).append(values)
        self._n_pictures, self._last = self._n_pictures + 1, frame.number
        if self._n_pictures == SEGMENT:
            self._cut()

    def _cut(self) -> None:
        """Complete a segment of both files, and drop the oldest if they have become too large."""
        if not self._n_pictures:
            return
        self._video.checkpoint()
        segment = segment_name(self._rows, self._last)
        arrays = {name: np.concatenate(values) for name, values in self._columns.items()}
        counts = {f"{name}.count": [len(each) for each in values] for name, values in self._columns.items()}
        with write_atomically(segment) as unfinished:
            np.savez(unfinished, allow_pickle=False, **arrays, **counts)
        sync(segment)
        self._columns, self._n_pictures = {}, 0
        pairs = list(zip(segments_of(self._film), segments_of(self._rows), strict=True))
        sizes = [sum(path.stat().st_size for path in pair) for pair in pairs]
        while sum(sizes) > MOST_BYTES and len(pairs) > 1:
            del sizes[0]
            for path in pairs.pop(0):
                path.unlink()

    def _drop_unpaired(self) -> None:
        """Of a kill between two files of a pair."""
        films, rows = (
            {path.stem.rpartition("part")[2] for path in segments_of(of)} for of in (self._film, self._rows)
        )
        for last in films ^ rows:
            for of in (self._film, self._rows):
                segment_name(of, int(last)).unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class Film:
    """What was written of a film.

    Parameters
    ----------
    path
        of the video; `None` where there are no pictures.
    size
        `(width, height)` px of the source.
    numbers, times
        of its frames, 1-based, and s of the source.
    moments
        `(n_frames,)` at which each is shown, s of the video.
    columns
        what is drawn: by name, arrays of all frames after each other.
    counts
        by name, how many entries of the array are of each frame.
    """

    path: Path | None
    size: tuple[int, int]
    numbers: NDArray[np.int64]
    times: NDArray[np.float64]
    moments: NDArray[np.float64]
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    counts: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    @cached_property
    def _ends(self) -> dict[str, NDArray[np.int64]]:
        return {name: np.cumsum(counts) for name, counts in self.counts.items()}

    def row(self, index: int) -> dict[str, NDArray[Any]]:
        """What is drawn on a frame, by its index."""
        return {
            name: values[self._ends[name][index] - self.counts[name][index] : self._ends[name][index]]
            for name, values in self.columns.items()
        }


def read_film(folder: Path) -> Film:
    """Read what `FilmWriter` has written; a `ValueError` names a file that is no such one."""
    video, path = folder / FILM, folder / ROWS
    arrays = _read_rows(path)
    names = [name for name in arrays if not name.endswith(".count") and name not in OF_FRAMES]
    columns = {name: arrays[name] for name in names}
    counts = {name: arrays[f"{name}.count"] for name in names}
    width, height = arrays["size"][-1].tolist()
    return Film(video, (width, height), arrays["number"], arrays["time"], _moments(video), columns, counts)


def _read_rows(path: Path) -> Arrays:
    """Arrays of a file of rows, checked as far as all applications have them."""
    arrays = read_arrays(path, EXPECTED, most=path.stat().st_size)
    names = {name for name in arrays if not name.endswith(".count")} | OF_FRAMES.keys()
    counts = {f"{name}.count": OF_COUNT for name in names}
    require_fields(path, EXPECTED, OF_FRAMES | counts, arrays)
    for name in names:
        values, total = arrays[name], arrays[f"{name}.count"].astype(float).sum()
        if not values.ndim or len(values) != total or values.dtype.kind not in "biuf":
            raise ValueError(f"{path}: {name}: got {values.shape} {values.dtype} for {total:g}, {EXPECTED}")
    return arrays


def _moments(path: Path) -> NDArray[np.float64]:
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            assert stream.time_base is not None
            ticks = [packet.pts for packet in container.demux(stream) if packet.pts is not None]
            return np.array(ticks, np.float64) * float(stream.time_base)  # closed, a stream has no memory
    except (av.FFmpegError, IndexError) as error:
        raise ValueError(f"{path}: got a damaged film ({error})") from None


def _small(image: Image) -> Image:
    """In colour, with sides of at most `LONGEST_SIDE`, which are even where it is shrunk."""
    if image.ndim == 2:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    height, width = image.shape[:2]
    scale = LONGEST_SIDE / max(height, width)
    if scale >= 1:
        return image
    sides = [max(2, 2 * round(side * scale / 2)) for side in (width, height)]
    # up to a half, means of four px do as well as those of an area, in a third of the time
    way = cv2.INTER_LINEAR if scale >= 0.5 else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, sides, interpolation=way), np.uint8)


def _join(segments: Sequence[Path], path: Path) -> None:
    parts: list[Arrays] = []
    for segment in segments:
        part = _read_rows(segment)
        with fitting(segment, EXPECTED):
            for name, values in parts[-1].items() if parts else ():
                if part[name].shape[1:] != values.shape[1:] or part[name].dtype != values.dtype:
                    raise ValueError(f"{name} unlike that of the frames before")
        parts.append(part)
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    np.savez(path, allow_pickle=False, **arrays)

"""Files of results: JSON and pictures, written whole; videos, lines and masks that grow with the frames."""

import errno
import json
import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self, cast

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.files import UNFINISHED, naming, sync, write_atomically, write_text


def write_json(path: Path, content: Any) -> None:
    """Write JSON, whole or not at all; numpy values are taken, and NaN and infinity become `null`."""
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def _plain(content: Any) -> Any:
    if isinstance(content, np.ndarray | np.generic):
        content = content.tolist()
    if isinstance(content, dict):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    if isinstance(content, Path):
        return str(content)
    return content


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an image `(height, width)` or `(height, width, 3)` BGR in the format of the suffix."""
    encoded, data = cv2.imencode(path.suffix, image)
    if not encoded:
        raise OSError(errno.EIO, "the image cannot be encoded", str(path))
    with write_atomically(path) as unfinished:
        unfinished.write_bytes(data.tobytes())


@dataclass(frozen=True)
class VideoForm:
    """How a video is encoded."""

    container: str
    codec: str
    pixels: Literal["yuv420p", "gray"]
    options: dict[str, str]
    container_options: dict[str, str]


# Without B frames, packets lie in the order of their time stamps, so segments join end to end; the file is a
# little larger. A picture has as many slices as there are threads: two on any machine, for the same bytes.
# `ultrafast` takes little more than half the time of the next preset, for the same error and a third more
# bytes (measured once). `faststart` lets a browser play before it has everything.
PLAYABLE = VideoForm(
    "mp4",
    "libx264",
    "yuv420p",
    {"preset": "ultrafast", "crf": "23", "bf": "0", "threads": "2"},
    {"movflags": "+faststart"},
)
PLAYABLE_SIDE = 16384  # px, the longest that libx264 encodes
# Masks are data: FFV1 gives back every 0 and 255 exactly, in every program built on FFmpeg (OpenCV too).
# Lossless H.264 uses a profile that most browsers do not play, so it would serve neither purpose.
LOSSLESS_GRAY = VideoForm("matroska", "ffv1", "gray", {"level": "3", "g": "1"}, {})


@dataclass
class _Segment:
    """A segment that is being written."""

    container: av.container.OutputContainer
    stream: av.VideoStream
    started: float  # time of its first picture
    last_tick: int = -1
    last_number: int = 0


class SegmentedVideo:
    """A video that survives the end of its process at any moment.

    Pictures go to a segment, `name.partNNNNNNNNN.suffix`, that is complete at each checkpoint and named by
    its last frame. Closing joins the segments without encoding anew into the whole video. Those of a run
    stay: it can go on after frame `resume_after` (0 for a new run) with those that do not end behind it;
    `None` where nothing will go on. Time stamps follow the frames' times in units of 1/rate, so that a
    picture missing in between does not shift others.
    """

    def __init__(self, path: Path, rate: float, form: VideoForm, resume_after: int | None = None) -> None:
        self._path = path
        self._form = form
        self._rate = Fraction(rate).limit_denominator(1001)
        self._segment: _Segment | None = None
        self._unfinished = path.with_name(f"{UNFINISHED}part-{path.name}")
        self._unfinished.unlink(missing_ok=True)
        self._stay = resume_after is not None
        drop_segments(path, behind=resume_after or 0)

    def write(self, picture: NDArray[np.uint8], number: int, time: float) -> None:
        """Append a picture, BGR or gray as the form demands, of the frame with this number and time."""
        if self._form is PLAYABLE:
            picture = _small_enough(picture)
        with _naming(self._path):
            if self._segment is None:
                self._segment = self._open(picture, time)
            segment = self._segment
            tick = max(segment.last_tick + 1, round((time - segment.started) * self._rate))
            frame = self._encodable(picture)
            frame.pts = tick
            frame.time_base = 1 / self._rate
            segment.container.mux(segment.stream.encode(frame))
        segment.last_tick = tick
        segment.last_number = number

    def checkpoint(self) -> None:
        """Complete what was written so far."""
        if self._segment is None:
            return
        segment, self._segment = self._segment, None
        try:
            with _naming(self._path):
                try:
                    segment.container.mux(segment.stream.encode(None))
                finally:
                    segment.container.close()
                sync(self._unfinished)
                os.replace(self._unfinished, segment_name(self._path, segment.last_number))
        except BaseException:
            self._unfinished.unlink(missing_ok=True)
            raise

    def close(self) -> None:
        """Write the whole video."""
        self.checkpoint()
        with _naming(self._path):
            join_segments(self._path, partial(_join, form=self._form), stay=self._stay)

    def _open(self, picture: NDArray[np.uint8], time: float) -> _Segment:
        height, width = picture.shape[:2]
        container = av.open(str(self._unfinished), "w", format=self._form.container)
        stream = cast(av.VideoStream, container.add_stream(self._form.codec, self._rate, self._form.options))
        stream.pix_fmt = self._form.pixels
        if self._form.pixels == "gray":
            stream.width, stream.height = width, height
        else:
            stream.width, stream.height = width + width % 2, height + height % 2
            # Says how `_encodable` converts (BT.601, television range); players would guess by the size.
            stream.codec_context.color_range = 1
            stream.codec_context.colorspace = 6
            stream.codec_context.color_primaries = 6
            stream.codec_context.color_trc = 6
        return _Segment(container, stream, time)

    def _encodable(self, picture: NDArray[np.uint8]) -> av.VideoFrame:
        if self._form.pixels == "gray":
            return av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
        height, width = picture.shape[:2]
        if height % 2 or width % 2:  # colour has half the resolution
            picture = np.asarray(
                cv2.copyMakeBorder(picture, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE), dtype=np.uint8
            )
        planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), dtype=np.uint8)
        return av.VideoFrame.from_ndarray(planes, format="yuv420p")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """`naming`, for errors of the encoder as well."""
    with naming(path):
        try:
            yield
        except av.FFmpegError as error:
            raise OSError(getattr(error, "errno", None) or errno.EIO, str(error)) from error


def _small_enough(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture, shrunk if it has a longer side than the encoder takes."""
    height, width = picture.shape[:2]
    scale = PLAYABLE_SIDE / max(height, width)
    if scale >= 1:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _join(segments: Sequence[Path], path: Path, form: VideoForm) -> None:
    """Write the packets of all segments, one after the other, to one file."""
    with av.open(str(path), "w", format=form.container, container_options=form.container_options) as whole:
        stream: av.VideoStream | None = None
        shape: tuple[int, int] | None = None
        offset = 0
        for segment in segments:
            with av.open(str(segment)) as part:
                source = part.streams.video[0]
                if stream is None:
                    stream = whole.add_stream_from_template(source)
                    shape = (source.width, source.height)
                if (source.width, source.height) != shape:
                    raise ValueError(f"{segment}: got {source.width}x{source.height} px, expected {shape}")
                end = offset
                for packet in part.demux(source):
                    if packet.dts is None or packet.pts is None:
                        continue
                    end = offset + packet.pts + (packet.duration or 1)
                    packet.pts += offset
                    packet.dts += offset
                    packet.stream = stream
                    whole.mux(packet)
                offset = end


PART = ".part"
"""In the names of segments, before the number of their last frame."""


def segment_name(path: Path, last: int) -> Path:
    """Name of the segment of the file `path` whose last frame has that number."""
    return path.with_name(f"{path.stem}{PART}{last:09d}{path.suffix}")


def segments_of(path: Path, behind: int = 0) -> list[Path]:
    """The segments of the file `path` in order of time, of those that end behind a frame."""
    found = sorted(path.parent.glob(segment_pattern(path.name)))
    return [segment for segment in found if int(segment.stem.rpartition(PART)[2]) > behind]


def segment_pattern(name: str) -> str:
    """What the segments of a file are called, as a pattern of `glob`."""
    path = Path(name)
    return f"{path.stem}{PART}[0-9]*{path.suffix}"


def drop_segments(path: Path, behind: int = 0) -> None:
    """Remove the segments of the file `path` that end behind a frame."""
    for segment in segments_of(path, behind):
        segment.unlink()


def join_segments(path: Path, join: Callable[[Sequence[Path], Path], None], *, stay: bool) -> None:
    """Write the whole file, by what joins its segments, if any, and remove them unless they `stay`."""
    segments = segments_of(path)
    if segments:
        with write_atomically(path) as unfinished:
            join(segments, unfinished)
    if not stay:
        drop_segments(path)


class Worker:
    """A thread that does jobs in order; what goes wrong there is raised at a later call here.

    At most `waiting` jobs wait before `submit` does.
    """

    def __init__(self, name: str, waiting: int = 8) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        self._waiting = waiting
        self._jobs: deque[Future[None]] = deque()

    def submit(self, job: Callable[..., None], *arguments: Any) -> None:
        """Have a function called with these arguments."""
        self._finish(but=self._waiting)
        self._jobs.append(self._thread.submit(job, *arguments))

    def wait(self) -> None:
        """Return when everything is done."""
        self._finish(but=0)

    def stop(self) -> None:
        """Finish everything, unless something has gone wrong, and end the thread."""
        try:
            self.wait()
        finally:
            self._thread.shutdown(cancel_futures=True)

    def _finish(self, but: int) -> None:
        while len(self._jobs) > but:
            self._jobs[0].result()  # stays there if it has gone wrong: nothing is done after it
            self._jobs.popleft()


class LineWriter:
    """A text file of lines that grows, and survives the end of its process; what is there is replaced.

    It begins with these lines: a header, and those that a run that goes on has from its log.
    """

    def __init__(self, path: str | Path, lines: Iterable[str] = ()) -> None:
        self._path = path = Path(path)
        write_text(path, "".join(f"{line}\n" for line in lines))
        with naming(path):
            self._file = path.open("a", encoding="utf-8", newline="\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, lines: Iterable[str]) -> None:
        """Append lines, of the frame after those before."""
        with naming(self._path):
            self._file.write("".join(f"{line}\n" for line in lines))

    def checkpoint(self) -> None:
        """Return when everything is on disk."""
        with naming(self._path):
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Complete the file; when the disk is full, up to the last whole line."""
        try:
            with naming(self._path):
                self._file.close()
        except OSError:
            os.truncate(self._path, self._path.read_bytes().rfind(b"\n") + 1)
            raise


class MaskWriter:
    """Foreground masks, 0 or 255: `foreground/bin000001.png` by frame number (CDnet), or `foreground.mkv`.

    Parameters
    ----------
    folder
        of the results; created if necessary.
    mode
        `"none"`, `"png"` (one image per frame) or `"video"`.
    rate
        frames per second of the video.
    resume_after
        see `SegmentedVideo`.
    """

    def __init__(
        self,
        folder: str | Path,
        mode: Literal["none", "png", "video"] = "png",
        rate: float = 25.0,
        resume_after: int | None = None,
    ) -> None:
        if mode not in ("none", "png", "video"):
            raise ValueError(f"masks: got {mode!r}, expected none, png or video")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder / "foreground"
        self._video: SegmentedVideo | None = None
        self._worker: Worker | None = None
        self._unsynced: list[Path] = []  # written since the last checkpoint
        if mode == "video":
            self._video = SegmentedVideo(folder / "foreground.mkv", rate, LOSSLESS_GRAY, resume_after)
        if mode == "png":
            self._folder.mkdir(exist_ok=True)
            for path in self._folder.glob("bin*.png"):
                digits = path.stem[3:]
                if digits.isdecimal() and int(digits) > (resume_after or 0):
                    path.unlink()
        if mode != "none":
            self._worker = Worker("masks")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._worker is not None:
                self._worker.stop()
        finally:
            if self._video is not None:
                self._video.close()

    def write(self, mask: NDArray[np.uint8], number: int, time: float) -> None:
        """Write the mask `(height, width)` of a frame; it is copied, encoding happens in a thread."""
        if self._worker is not None:
            job = self._write_png if self._video is None else self._video.write
            self._worker.submit(job, mask.copy(), number, time)

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        if self._worker is not None:
            self._worker.wait()
        if self._video is not None:
            self._video.checkpoint()
        # all at once: most have reached the disk by now
        for path in self._unsynced:
            sync(path)
        self._unsynced.clear()

    def _write_png(self, mask: NDArray[np.uint8], number: int, _time: float) -> None:
        # Eight bits a pixel: some programs read a PNG of one bit as 0 and 1, and CDnet's compare with 255.
        # OpenCV's default (fastest deflate, run lengths) is quicker and smaller here than level 1.
        path = self._folder / f"bin{number:06d}.png"
        write_image(path, mask)
        self._unsynced.append(path)

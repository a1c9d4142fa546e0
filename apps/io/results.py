"""What a run writes: whole files only, and nothing lost but the frames since the last saved state.

A run calls `checkpoint()` of every writer and then saves its state. Resumed at that state's frame, a writer
drops what lies behind it and goes on: the files end up as if the run had never been interrupted.
"""

import errno
import json
import math
import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, Protocol, Self, cast

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.core.limits import LAST_FRAME

LONGEST_LINE = 10_000  # of a file of boxes: beyond, it is none
UNFINISHED = ".unfinished-"  # how a file is called while it is written

TRACK_FIELDS = np.dtype(
    [("frame", np.int64), ("id", np.int64), ("box", np.float64, (4,)), ("confidence", np.float64)]
)


class TrackedObject(Protocol):
    """What is written of a track."""

    @property
    def identity(self) -> int:
        """The number that stays with the object."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """X and y of the upper left corner (0-based), width and height, px."""

    @property
    def confidence(self) -> float:
        """How sure the tracker is of it, 0 to 1."""


# --- whole files --------------------------------------------------------------------------------------------


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Give an error of the system the name of the file, which `write` leaves out (a full disk)."""
    try:
        yield
    except (OSError, av.FFmpegError) as error:
        code = error.errno if isinstance(error, OSError) and error.errno is not None else errno.EIO
        raise OSError(code, getattr(error, "strerror", None) or str(error), str(path)) from error


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """Yield the name of a file to write instead, which becomes `path` when all went well.

    The file lies in the same folder and has the same suffix. After an error it is gone, and `path` is as
    before.

    Raises
    ------
    OSError
        if the file cannot be written (no space, no permission); it names `path`.
    """
    unfinished = path.with_name(UNFINISHED + path.name)
    try:
        with naming(path):
            yield unfinished
            os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def sync(path: Path) -> None:
    """Return when a file has reached the disk, where it outlives a power cut."""
    with naming(path), path.open("rb+") as file:
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""
    with write_atomically(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8", newline="\n")


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


# --- segments -----------------------------------------------------------------------------------------------


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


class _Worker:
    """A thread that does jobs in order; what goes wrong there is raised at the next call here."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.Queue[tuple[Callable[..., None], tuple[Any, ...]] | None] = queue.Queue(8)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Callable[..., None], *arguments: Any) -> None:
        self._raise()
        self._jobs.put((job, arguments))

    def wait(self) -> None:
        """Return when everything is done."""
        self._jobs.join()
        self._raise()

    def stop(self) -> None:
        """Finish everything and end the thread."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()
        self._raise()

    def _work(self) -> None:
        while (item := self._jobs.get()) is not None:
            job, arguments = item
            try:
                if self._error is None:
                    job(*arguments)
            except BaseException as error:  # handed over to the thread that submits
                self._error = error
            finally:
                self._jobs.task_done()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error


# --- video --------------------------------------------------------------------------------------------------


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
# `faststart` lets a browser play before it has everything.
PLAYABLE = VideoForm(
    "mp4",
    "libx264",
    "yuv420p",
    {"preset": "superfast", "crf": "23", "bf": "0", "threads": "2"},
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
    its last frame. Closing joins the segments without encoding anew into the whole video. A resumed run drops
    segments behind its frame. Segments stay until a run is finished, since --resume needs them.

    Parameters
    ----------
    path
        of the whole video.
    rate
        pictures per second. Time stamps follow the frames' times in units of 1/rate, so that a picture
        missing in between does not shift the later ones.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(self, path: Path, rate: float, form: VideoForm, resume_after: int = 0) -> None:
        self._path = path
        self._form = form
        self._rate = Fraction(rate).limit_denominator(1001)
        self._segment: _Segment | None = None
        self._unfinished = path.with_name(f"{UNFINISHED}part-{path.name}")
        self._unfinished.unlink(missing_ok=True)
        for segment in segments_of(path, behind=resume_after):
            segment.unlink()

    def write(self, picture: NDArray[np.uint8], number: int, time: float) -> None:
        """Append a picture, BGR or gray as the form demands, of the frame with this number and time."""
        if self._form is PLAYABLE:
            picture = _small_enough(picture)
        with naming(self._path):
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
            with naming(self._path):
                try:
                    segment.container.mux(segment.stream.encode(None))
                finally:
                    segment.container.close()
                sync(self._unfinished)
                os.replace(self._unfinished, segment_name(self._path, segment.last_number))
        except BaseException:
            self._unfinished.unlink(missing_ok=True)
            raise

    def close(self, *, finished: bool) -> None:
        """Write the whole video; when the run is finished, remove the segments."""
        self.checkpoint()
        segments = segments_of(self._path)
        if segments:
            with write_atomically(self._path) as unfinished:
                _join(segments, unfinished, self._form)
        if finished:
            for segment in segments:
                segment.unlink()

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


# --- masks --------------------------------------------------------------------------------------------------


class MaskWriter:
    """Foreground masks, 0 or 255: `foreground/bin000001.png` by frame number (CDnet), or `foreground.mkv`.

    Parameters
    ----------
    folder
        of the run's results.
    mode
        `"none"`, `"png"` or `"video"`.
    rate
        pictures per second of the video.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(
        self, folder: Path, mode: Literal["none", "png", "video"], rate: float, resume_after: int = 0
    ) -> None:
        if mode not in ("none", "png", "video"):
            raise ValueError(f"masks: got {mode!r}, expected none, png or video")
        self._folder = folder / "foreground"
        self._mode = mode
        self._video: SegmentedVideo | None = None
        self._worker: _Worker | None = None
        self._unsynced: list[Path] = []  # written since the last checkpoint
        if mode == "video":
            self._video = SegmentedVideo(folder / "foreground.mkv", rate, LOSSLESS_GRAY, resume_after)
        if mode == "png":
            self._folder.mkdir(exist_ok=True)
            for path in self._folder.glob("bin*.png"):
                digits = path.stem[3:]
                if digits.isdecimal() and int(digits) > resume_after:
                    path.unlink()
        if mode != "none":
            self._worker = _Worker("masks")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(finished=kind is None)

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

    def close(self, *, finished: bool) -> None:
        """Complete the results; `finished` as in `SegmentedVideo.close`."""
        try:
            if self._worker is not None:
                self._worker.stop()
        finally:
            if self._video is not None:
                self._video.close(finished=finished)

    def _write_png(self, mask: NDArray[np.uint8], number: int, _time: float) -> None:
        # Eight bits a pixel: some programs read a PNG of one bit as 0 and 1, and CDnet's compare with 255.
        # OpenCV's default (fastest deflate, run lengths) is quicker and smaller here than level 1.
        path = self._folder / f"bin{number:06d}.png"
        write_image(path, mask)
        self._unsynced.append(path)


# --- overlay ------------------------------------------------------------------------------------------------

TRAIL_SECONDS = 2.0
# BGR, added to the picture (`Any`: OpenCV's stubs know no scalars)
MASK_TINT: Any = (-40.0, -40.0, 60.0, 0.0)
MASK_OUTLINE: Any = (-255.0, -255.0, 255.0, 0.0)


def identity_colour(identity: int) -> tuple[int, int, int]:
    """Return a BGR colour that is always the same for an identity and far from those of its neighbours."""
    # The golden angle never repeats, and spreads any run of numbers evenly over the hues.
    hue = (identity * 0.6180339887498949) % 1.0
    saturation = (0.9, 0.6, 0.75)[identity % 3]
    red, green, blue = (
        1 - saturation * min(1.0, max(0.0, 2 - abs((hue * 6 + shift) % 6 - 3))) for shift in (0, 4, 2)
    )
    return round(255 * blue), round(255 * green), round(255 * red)


def draw_overlay(
    image: NDArray[np.uint8],
    foreground: NDArray[np.uint8] | None,
    tracks: Sequence[TrackedObject],
    trails: dict[int, NDArray[np.float64]],
    caption: str,
) -> NDArray[np.uint8]:
    """Draw what was found on a copy of the frame.

    Parameters
    ----------
    image
        `(height, width)` or `(height, width, 3)` BGR.
    foreground
        `(height, width)`, 0 or 255: tinted, with an outline.
    tracks
        boxes (px) with their identities.
    trails
        foot points `(n, 2)` px by identity.
    caption
        text in the upper left corner.

    Returns
    -------
    NDArray[np.uint8]
        `(height, width, 3)` BGR.
    """
    picture: NDArray[Any] = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    unit = max(1.0, picture.shape[0] / 480)  # lines and letters grow with the picture
    thick = max(1, round(1.6 * unit))
    if foreground is not None:
        _tint(picture, foreground, max(1, round(unit)))
    for identity, points in trails.items():
        if len(points) > 1:
            cv2.polylines(
                picture,
                [np.rint(points).astype(np.int32)],
                False,
                identity_colour(identity),
                thick,
                cv2.LINE_AA,
            )
    for track in tracks:
        x, y, w, h = track.box
        colour = identity_colour(track.identity)
        corner = (round(x), round(y))
        cv2.rectangle(picture, corner, (round(x + w) - 1, round(y + h) - 1), colour, thick)
        _write_label(picture, str(track.identity), corner, colour, 0.42 * unit)
    _write_label(picture, caption, (0, 0), (32, 32, 32), 0.42 * unit)
    return cast(NDArray[np.uint8], picture)


def _tint(picture: NDArray[Any], foreground: NDArray[np.uint8], thickness: int) -> None:
    x, y, w, h = cv2.boundingRect(foreground)
    if w == 0:
        return
    part = picture[y : y + h, x : x + w]
    mask = np.ascontiguousarray(foreground[y : y + h, x : x + w])
    size = 2 * thickness + 1
    inner = cv2.erode(mask, np.ones((size, size), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=[0])
    # Masked saturating sums, in place: a fifth of the time of blending and boolean indexing.
    cv2.add(part, MASK_TINT, dst=part, mask=mask)
    cv2.add(part, MASK_OUTLINE, dst=part, mask=cv2.subtract(mask, inner))


def _write_label(
    picture: NDArray[Any], text: str, corner: tuple[int, int], colour: tuple[int, int, int], scale: float
) -> None:
    """Write text on a filled box that sits on `corner`, or below it at the upper edge."""
    thickness = max(1, round(2 * scale))
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    margin = 2 + thickness
    left = min(max(corner[0], 0), max(0, picture.shape[1] - width - 2 * margin))
    top = max(corner[1] - height - below - margin, 0)
    cv2.rectangle(
        picture, (left, top), (left + width + 2 * margin, top + height + below + margin), colour, cv2.FILLED
    )
    blue, green, red = colour
    ink = (0, 0, 0) if 0.114 * blue + 0.587 * green + 0.299 * red > 110 else (255, 255, 255)
    origin = (left + margin, top + height + margin - 1)
    cv2.putText(picture, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thickness, cv2.LINE_AA)


class OverlayWriter:
    """`overlay.mp4`: the frames with masks, boxes, identities and the trails of the last two seconds.

    Drawing and encoding happen in a thread. Parameters as of `SegmentedVideo`.
    """

    def __init__(self, path: Path, rate: float, resume_after: int = 0) -> None:
        self._video = SegmentedVideo(path, rate, PLAYABLE, resume_after)
        self._trails: dict[int, deque[tuple[float, float, float]]] = {}
        self._last_image: NDArray[np.uint8] | None = None
        self._worker = _Worker("overlay")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(finished=kind is None)

    def write(
        self, frame: Frame, foreground: NDArray[np.uint8] | None, tracks: Sequence[TrackedObject]
    ) -> None:
        """Append a frame with what was found in it; for a missing frame the one before is shown.

        The mask is copied; the frame's image and the tracks must not be changed afterwards.
        """
        mask = None if foreground is None else foreground.copy()
        self._worker.submit(self._draw_and_write, frame, mask, list(tracks))

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        self._worker.wait()
        self._video.checkpoint()

    def close(self, *, finished: bool) -> None:
        """Complete the video; `finished` as in `SegmentedVideo.close`."""
        try:
            self._worker.stop()
        finally:
            self._video.close(finished=finished)

    def _draw_and_write(
        self, frame: Frame, foreground: NDArray[np.uint8] | None, tracks: list[TrackedObject]
    ) -> None:
        for track in tracks:
            x, y, w, h = track.box
            self._trails.setdefault(track.identity, deque()).append((frame.time, x + w / 2, y + h))
        for identity in list(self._trails):
            trail = self._trails[identity]
            while trail and trail[0][0] < frame.time - TRAIL_SECONDS:
                trail.popleft()
            if not trail:
                del self._trails[identity]
        image = self._last_image if frame.image is None else frame.image
        if image is None:
            return  # nothing seen yet, not even the size
        self._last_image = image
        trails = {identity: np.array(trail)[:, 1:] for identity, trail in self._trails.items()}
        caption = f"frame {frame.number}" + (" (missing)" if frame.image is None else "")
        picture = draw_overlay(image, foreground, tracks, trails, caption)
        self._video.write(picture, frame.number, frame.time)


# --- tracks -------------------------------------------------------------------------------------------------


class TrackWriter:
    """`tracks.txt` in MOT format: frame, id, x, y, width, height, confidence, -1, -1, -1.

    Frames count from 1, and so do pixels, as MOT has it: the upper left corner of a box at (0, 0) is written
    as 1, 1.
    """

    def __init__(self, path: Path, resume_after: int = 0) -> None:
        self._path = path
        kept = _lines_until(path, resume_after) if resume_after and path.exists() else ""
        write_text(path, kept)
        with naming(path):
            self._file = path.open("a", encoding="utf-8", newline="\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, number: int, tracks: Sequence[TrackedObject]) -> None:
        """Append the boxes (0-based px) of a frame."""
        lines = []
        for track in tracks:
            x, y, w, h = track.box
            box = f"{x + 1:.2f},{y + 1:.2f},{w:.2f},{h:.2f}"
            lines.append(f"{number},{track.identity},{box},{track.confidence:.4f},-1,-1,-1\n")
        with naming(self._path):
            self._file.write("".join(lines))

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


def _lines_until(path: Path, number: int) -> str:
    """Return the whole lines up to a frame; frames ascend, and a last line may be cut off."""
    kept = []
    with path.open(encoding="utf-8", newline="\n") as file:
        for line in file:
            frame = line.partition(",")[0]
            if not line.endswith("\n") or not frame.isdecimal() or int(frame) > number:
                break
            kept.append(line)
    return "".join(kept)


def read_tracks(path: Path) -> NDArray[np.void]:
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
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = iter(lambda: file.readline(LONGEST_LINE), "")
        for line_number, line in enumerate(lines, start=1):
            fields = line.replace(",", " ").split()
            if fields:
                try:
                    rows.append(_parse_box([float(field) for field in fields[:7]]))
                except ValueError:
                    raise ValueError(
                        f"{path}, line {line_number}: got {line.strip()[:60]!r}, expected frame (from 1), "
                        "id, x, y, width, height (not negative), confidence"
                    ) from None
    return np.array(rows, dtype=TRACK_FIELDS)


def _parse_box(values: list[float]) -> tuple[int, int, tuple[float, float, float, float], float]:
    frame, identity, x, y, w, h, confidence = values if len(values) == 7 else (*values, 1.0)
    whole = frame.is_integer() and identity.is_integer() and abs(identity) < 1 << 53  # as floats are exact
    finite = math.isfinite(x + y + w + h + confidence)
    if not (whole and finite and 1 <= frame <= LAST_FRAME and w >= 0 and h >= 0):
        raise ValueError
    return int(frame), int(identity), (x - 1, y - 1, w, h), confidence

"""Where frames come from: video files, folders of images, cameras and network streams."""

import configparser
import glob
import hashlib
import itertools
import logging
import math
import os
import queue
import re
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol, Self
from urllib.parse import urlsplit, urlunsplit

import av
import av.logging
import cv2
import numpy as np
from numpy.typing import NDArray

from ..models.frame import Frame

_log = logging.getLogger(__name__)

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".jpg", ".jpeg", ".jp2", ".pbm", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"}
)
NETWORK_SCHEMES = frozenset({"http", "https", "rtsp", "rtsps"})
NETWORK_TIMEOUT = 10.0  # seconds
DEFAULT_RATE = 25.0  # frames per second, where nothing states one
DECODE_AHEAD = 4  # frames: smooths uneven processing, yet holds little memory at 4K

# What is damaged is told by exceptions, `skipped` and `truncated`; the libraries' own lines on standard error
# would only tear the progress bar.
av.logging.set_level(None)
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


@dataclass(frozen=True)
class Selection:
    """Which frames of the source are wanted (1-based, both ends included)."""

    start: int = 1
    stop: int | None = None
    step: int = 1
    after: int = 0

    def __post_init__(self) -> None:
        if self.start < 1:
            raise ValueError(f"start: got {self.start}, expected 1 or more (frames count from 1)")
        if self.step < 1:
            raise ValueError(f"step: got {self.step}, expected 1 or more")
        if self.stop is not None and self.stop < self.start:
            raise ValueError(f"stop: got {self.stop}, expected {self.start} (start) or more")

    def __contains__(self, number: int) -> bool:
        return (
            number >= self.start
            and number > self.after
            and not self.ended(number)
            and (number - self.start) % self.step == 0
        )

    def ended(self, number: int) -> bool:
        """Whether neither this frame nor any after it is wanted."""
        return self.stop is not None and number > self.stop

    def numbers(self, total: int) -> range:
        """Return the selected numbers of a source of `total` frames, those up to `after` included."""
        return range(self.start, (total if self.stop is None else min(total, self.stop)) + 1, self.step)


class _Reader(Protocol):
    """One kind of source: decodes the selected frames in order, in whichever thread iterates."""

    name: str
    kind: str
    live: bool
    rate: float
    total: int | None  # frames in the whole source as far as it is stated
    header_size: tuple[int, int]
    truncated: bool
    last_number: int  # of the last frame seen, also of those not selected

    def frames(self, selection: Selection) -> Iterator[Frame]: ...
    def fingerprint(self) -> dict[str, Any]: ...
    def close(self) -> None: ...


class Source:
    """Frames of a video file, images, a camera or a stream; an iterator and a context manager.

    A thread decodes a few frames ahead, so that decoding (libraries that release the interpreter lock)
    overlaps with processing. A live source never waits for a slow consumer: its oldest waiting frame is
    dropped, and the gap shows in `Frame.number` and `Frame.time`.

    Attributes
    ----------
    name
        the source as the user gave it, without user name and password of an address.
    kind
        `"video"`, `"images"`, `"camera"` or `"stream"`.
    live
        whether frames arrive in real time; such a source cannot be read again, so a run cannot be resumed.
    n_frames
        number of frames expected for start, stop and step, those up to `after` included (for video: as its
        header states); `None` when unknown.
    rate
        frames per second of the source, before `step`.
    size
        `(width, height)` px.
    skipped
        numbers of the frames so far that could not be read and came as `Frame(None, ...)`.
    truncated
        whether the source ended before the end that it announces (known once it has ended).
    """

    def __init__(self, reader: _Reader, selection: Selection) -> None:
        self._reader = reader
        self.name = reader.name
        self.kind = reader.kind
        self.live = reader.live
        self.rate = reader.rate
        self.size = reader.header_size
        self.skipped: list[int] = []
        self.truncated = False
        self.n_frames: int | None = None
        if reader.total is not None:
            self.n_frames = len(selection.numbers(reader.total))
        self._form: tuple[int, ...] | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._queue: queue.Queue[Frame | Exception | None] = queue.Queue(DECODE_AHEAD)
        self._ended = False
        self._frames = reader.frames(selection)
        # Decoding up to the first readable frame right away costs nothing in sum, and tells before any result
        # is written that a source is unreadable or ends before `start`.
        self._decoded: deque[Frame] = deque()
        for frame in self._frames:
            self._decoded.append(frame)
            if frame.image is not None:
                self.size = (frame.image.shape[1], frame.image.shape[0])
                return
        if selection.after >= selection.start:
            return  # the rest of a run that was resumed: nothing, or missing frames
        if self._decoded or reader.last_number == 0:
            raise ValueError(f"{self.name}: holds no readable frame")
        raise ValueError(
            f"start: got {selection.start}, but {self.name} has only {reader.last_number} frames"
        )

    def __iter__(self) -> Self:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __next__(self) -> Frame:
        if self._ended:
            raise StopIteration
        if self._decoded:
            return self._checked(self._decoded.popleft())
        if self._thread is None:
            self._thread = threading.Thread(target=self._decode_ahead, name="decode", daemon=True)
            self._thread.start()
        item = self._queue.get()
        if isinstance(item, Frame):
            return self._checked(item)
        self._ended = True
        self.truncated = self._reader.truncated
        self.close()
        if item is not None:
            raise item
        raise StopIteration

    def close(self) -> None:
        """Stop decoding and release the file or device."""
        self._ended = True
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(NETWORK_TIMEOUT)
            if self._thread.is_alive():
                return  # stuck in a device driver: closing under its feet would crash
        self._reader.close()

    def fingerprint(self) -> dict[str, Any]:
        """Return what identifies this source, as JSON: two equal ones hold the same frames."""
        return self._reader.fingerprint()

    def _checked(self, frame: Frame) -> Frame:
        """Note a missing frame; refuse one of another size or type than the first."""
        if frame.image is None:
            self.skipped.append(frame.number)
            _log.info("frame %d is missing or unreadable", frame.number)
            return frame
        form = frame.image.shape
        if self._form is None:
            self._form = form
        elif form != self._form:
            self.close()
            raise ValueError(
                f"{self.name}: frame {frame.number} is {_describe(form)}, "
                f"expected {_describe(self._form)} like the frames before"
            )
        return frame

    def _decode_ahead(self) -> None:
        outcome: Exception | None = None
        try:
            for frame in self._frames:
                if self.live:
                    self._put_newest(frame)
                else:
                    self._put(frame)
                if self._stopping.is_set():
                    return
        except Exception as error:  # handed over to the thread that iterates
            outcome = error
        self._put(outcome)

    def _put(self, item: Frame | Exception | None) -> None:
        while not self._stopping.is_set():
            try:
                self._queue.put(item, timeout=0.1)
                return
            except queue.Full:
                continue

    def _put_newest(self, frame: Frame) -> None:
        while True:
            try:
                self._queue.put_nowait(frame)
                return
            except queue.Full:
                try:
                    self._queue.get_nowait()
                except queue.Empty:
                    continue


def open_source(
    source: str,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    *,
    after: int = 0,
    image_rate: float | None = None,
) -> Source:
    """Open a source of frames.

    Parameters
    ----------
    source
        a video file, a folder or glob of images (sorted naturally: `frame2` before `frame10`), the number of
        a camera, or an rtsp or http(s) address.
    start, stop, step
        which frames: 1-based, both ends included. Frames before `start` are decoded and discarded, so that
        the selected ones are exactly those that reading from the beginning gives.
    after
        number of the last frame that an earlier run has processed; frames up to it are left out.
    image_rate
        frames per second of images, which have no time stamps; default: `frameRate` in a MOT `seqinfo.ini` in
        or above the folder, else 25.

    Raises
    ------
    ValueError
        if the selection is empty or lies beyond the end, or the file is not a video or image that can be
        read.
    FileNotFoundError
        if there is no such file, or no image in the folder or under the glob.
    OSError
        if a camera or address cannot be opened (after 10 s at most).
    """
    selection = Selection(start, stop, step, after)
    reader = _open_reader(source, image_rate)
    try:
        return Source(reader, selection)
    except BaseException:
        reader.close()
        raise


def _open_reader(source: str, image_rate: float | None) -> _Reader:
    scheme, separator, _ = source.partition("://")
    if separator:
        if scheme.lower() not in NETWORK_SCHEMES:
            schemes = ", ".join(sorted(NETWORK_SCHEMES))
            raise ValueError(f"{_public(source)}: expected an address of one of {schemes}")
        return _VideoReader(source, network=True)
    path = Path(source)
    if path.is_dir():
        files = _naturally_sorted(entry for entry in path.iterdir() if _is_image(entry))
        if not files:
            raise FileNotFoundError(f"{source}: the folder holds no images")
        return _ImageReader(source, path, files, image_rate)
    if path.is_file():
        if path.suffix.lower() in IMAGE_SUFFIXES:
            return _ImageReader(source, path.parent, [path], image_rate)
        return _VideoReader(source, network=False)
    if path.exists():
        raise ValueError(f"{source}: neither a file nor a folder")
    if source.isascii() and source.isdigit():
        return _CameraReader(int(source))
    if glob.has_magic(source):
        matches = (Path(match) for match in glob.glob(source, recursive=True))
        files = _naturally_sorted(match for match in matches if _is_image(match))
        if not files:
            raise FileNotFoundError(f"{source}: matches no images")
        return _ImageReader(source, files[0].parent, files, image_rate)
    raise FileNotFoundError(f"{source}: no such file or folder")


# --- images -------------------------------------------------------------------------------------------------


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()


def _naturally_sorted(paths: Iterator[Path]) -> list[Path]:
    def key(path: Path) -> tuple[tuple[str | int, ...], str]:
        parts = re.split(r"(\d+)", str(path))  # text and numbers alternate, so that equals meet equals
        return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), str(path)

    return sorted(paths, key=key)


class _ImageReader:
    """Images of one folder or glob, `rate` a second."""

    kind = "images"
    live = False
    truncated = False

    def __init__(self, source: str, folder: Path, files: list[Path], rate: float | None) -> None:
        self.name = source
        self.total: int | None = len(files)
        self.header_size = (0, 0)
        self.rate = _sequence_rate(folder) if rate is None else rate
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"{source}: got {self.rate} frames per second, expected more than 0")
        self.last_number = len(files)
        self._files = files

    def frames(self, selection: Selection) -> Iterator[Frame]:
        for number in selection.numbers(len(self._files)):
            if number in selection:
                image = _read_image(self._files[number - 1], number)
                yield Frame(image, (number - 1) / self.rate, number)

    def fingerprint(self) -> dict[str, Any]:
        digest = hashlib.sha256()
        for path in self._files:
            digest.update(f"{path.name}\0{path.stat().st_size}\n".encode("utf-8", "surrogateescape"))
        return {
            "kind": self.kind,
            "name": os.path.abspath(self.name),
            "count": len(self._files),
            "sha256": digest.hexdigest(),
        }

    def close(self) -> None:
        pass


def _sequence_rate(folder: Path) -> float:
    """Return the frame rate of a MOT sequence, or the default for images that are none."""
    for candidate in (folder / "seqinfo.ini", folder.absolute().parent / "seqinfo.ini"):
        if candidate.is_file():
            parser = configparser.ConfigParser()
            try:
                parser.read(candidate, encoding="utf-8")
                return parser.getfloat("Sequence", "frameRate", fallback=DEFAULT_RATE)
            except (configparser.Error, ValueError):
                raise ValueError(f"{candidate}: frameRate under [Sequence] cannot be read") from None
    return DEFAULT_RATE


def _read_image(path: Path, number: int) -> NDArray[np.uint8] | None:
    """Return the image, `None` when it is damaged.

    Raises
    ------
    ValueError
        if its values are no bytes.
    OSError
        if the file cannot be read at all.
    """
    data = path.read_bytes()
    if not _is_complete(data):
        return None
    try:
        image: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    if image is None:
        return None
    if image.dtype != np.uint8:
        raise ValueError(f"{path}: frame {number} has {image.dtype} values, expected 8 bits a channel")
    if image.ndim == 3 and image.shape[2] == 4:
        return np.ascontiguousarray(image[:, :, :3])
    return image


def _is_complete(data: bytes) -> bool:
    """Tell whether a JPEG or PNG has its end (and a PNG its check sums); other data pass.

    The decoders of some OpenCV versions fill up what a truncated file lacks, and report on standard error.
    """
    if data.startswith(b"\xff\xd8"):
        position = 2
        while data[position : position + 1] == b"\xff" and len(data) >= position + 4:
            # Walking the segments steps over thumbnails, which have an end marker of their own.
            if data[position + 1] == 0xDA:
                return data.find(b"\xff\xd9", position) >= 0
            position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        return False
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        position = 8
        while len(data) >= position + 12:
            length = int.from_bytes(data[position : position + 4], "big")
            kind_and_content = memoryview(data)[position + 4 : position + 8 + length]
            check_sum = data[position + 8 + length : position + 12 + length]
            if int.from_bytes(check_sum, "big") != zlib.crc32(kind_and_content) or len(check_sum) < 4:
                return False
            if bytes(kind_and_content[:4]) == b"IEND":
                return True
            position += 12 + length
        return False
    return len(data) > 0


# --- video files and addresses ------------------------------------------------------------------------------


class _VideoReader:
    """A video file, or an address: of a file (with an end) or live (without)."""

    def __init__(self, source: str, *, network: bool) -> None:
        self.name = _public(source)
        self.kind = "stream" if network else "video"
        self.truncated = False
        self.last_number = 0
        self._path = source
        try:
            self._container = (
                av.open(source, timeout=NETWORK_TIMEOUT, options={"rtsp_transport": "tcp"})
                if network
                else av.open(source, metadata_errors="replace")
            )
        except (PermissionError, IsADirectoryError) as error:
            raise type(error)(error.errno, error.strerror, self.name) from None
        except (av.FFmpegError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            if network:
                raise OSError(f"{self.name}: cannot be opened ({reason})") from None
            raise ValueError(f"{self.name}: not a video that can be read ({reason})") from None
        streams = [
            stream
            for stream in self._container.streams.video
            # a sound file's cover, and text, which FFmpeg draws as a picture of a terminal
            if not stream.disposition & av.stream.Disposition.attached_pic
            and stream.codec_context is not None
            and stream.codec_context.name != "ansi"
        ]
        if not streams:
            self._container.close()
            raise ValueError(f"{self.name}: not a video that can be read (no picture track)")
        self._stream = streams[0]
        # Frame threads would report a damaged packet late, at another packet; and decoding has a core of its
        # own anyway, since it runs ahead of processing.
        self._stream.thread_type = "SLICE"
        rate = self._stream.average_rate or self._stream.guessed_rate
        self.rate = float(rate) if rate else DEFAULT_RATE
        self.header_size = (self._stream.codec_context.width, self._stream.codec_context.height)
        self._seconds = self._stated_seconds()
        self._counted = self._stream.frames or None
        self.total = self._counted
        if self.total is None and self._seconds is not None:
            self.total = max(1, round(self._seconds * self.rate))
        self.live = network and self.total is None

    def _stated_seconds(self) -> float | None:
        """Return how long the pictures last as the file states, `None` if it does not."""
        stream = self._stream
        if stream.duration and stream.time_base:
            return float(stream.duration * stream.time_base)
        tag = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))  # Matroska
        if tag:
            return int(tag[1]) * 3600 + int(tag[2]) * 60 + float(tag[3])
        if self._container.duration and len(self._container.streams) == 1:
            return self._container.duration / 1e6
        return None

    def frames(self, selection: Selection) -> Iterator[Frame]:
        opened: float | None = None
        for number, (seconds, picture) in enumerate(self._pictures(), start=1):
            if selection.ended(number):
                return
            self.last_number = number
            if self.live:
                if opened is None:
                    opened = time.monotonic()
                seconds = time.monotonic() - opened
            if number in selection:
                yield Frame(None if picture is None else _to_bgr(picture), seconds, number)

    def _pictures(self) -> Iterator[tuple[float, av.VideoFrame | None]]:
        """Yield every picture with its time (seconds since the first), `None` for one that is damaged.

        A packet that cannot be decoded is remembered with its time stamp; the next good picture's time stamp
        tells how many are missing in between (a lost key picture takes those that depend on it along). What
        is missing at the end of a file that lacks its end has no position, and is left out.
        """
        interval = 1.0 / self.rate
        first: float | None = None
        last = -interval  # time of the last picture yielded
        damaged: list[float] = []  # times of damage that no good picture has followed yet
        filled = (-interval, -interval)  # times between which missing frames were yielded last
        cut_short: set[int] = set()  # time stamps of packets that the file ends in
        n_packets = 0
        for packet in self._packets():
            n_packets += packet is not None and packet.size > 0
            if packet is not None and packet.is_corrupt and packet.pts is not None:
                cut_short.add(packet.pts)
            try:
                pictures = self._stream.decode(packet)
            except av.FFmpegError:
                stamp = None if packet is None else packet.dts if packet.pts is None else packet.pts
                if stamp is not None and packet is not None and packet.size > 0:
                    damaged.append(self._time(stamp))
                continue
            for picture in pictures:
                moment = None if picture.pts is None else self._time(picture.pts)
                if picture.is_corrupt or picture.pts in cut_short:
                    damaged.append(math.inf if moment is None else moment)
                    continue
                if moment is None:
                    moment = (first or 0.0) + last + interval
                if first is None:
                    first = min([moment, *damaged])
                seconds = moment - first
                earlier = [other for other in damaged if other - first < seconds or other == math.inf]
                damaged = [other for other in damaged if other - first > seconds and other != math.inf]
                if earlier:
                    gap = round((seconds - last) / interval) - 1
                    # Damage behind the last picture belongs to a place that is already filled.
                    new = sum(other - first > last for other in earlier)
                    # A broken time stamp must not make up more frames than there are.
                    n_missing = max(new, min(gap, self.total or 0))
                    filled = (last, seconds)
                    for index in range(n_missing):
                        yield last + (seconds - last) * (index + 1) / (n_missing + 1), None
                elif filled[0] < seconds < filled[1]:
                    continue  # after damage, a decoder may give out a picture late: its place has gone by
                if seconds <= last:  # broken time stamps: frames still follow each other
                    seconds = last + interval
                yield seconds, picture
                last = seconds
        end = last + interval
        if self._counted is not None:
            self.truncated |= n_packets < self._counted
        elif self._seconds is not None:
            self.truncated |= end + max(0.5, 2 * interval) < self._seconds
        if damaged and first is not None:
            if self._counted is None:
                self.truncated = True
            elif not self.truncated:
                for index in range(len(damaged)):
                    yield end + index * interval, None

    def _packets(self) -> Iterator["av.Packet[av.VideoStream] | None"]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except (av.FFmpegError, OSError):
                self.truncated = True
                packet = None
            if packet is None or (packet.size == 0 and packet.dts is None):
                yield None  # has the decoder give out what it holds back
                return
            yield packet

    def _time(self, stamp: int) -> float:
        return float(stamp * (self._stream.time_base or Fraction(1)))

    def fingerprint(self) -> dict[str, Any]:
        if self.kind == "stream":
            return {"kind": self.kind, "name": self.name, "count": self.total}
        path = Path(self._path)
        return {
            "kind": self.kind,
            "name": str(path.resolve()),
            "bytes": path.stat().st_size,
            "sha256": _digest_of_ends(path),
        }

    def close(self) -> None:
        self._container.close()


def _digest_of_ends(path: Path) -> str:
    """Return the sha256 of the first and the last MiB."""
    mebibyte = 1 << 20
    with path.open("rb") as file:
        digest = hashlib.sha256(file.read(mebibyte))
        size = file.seek(0, os.SEEK_END)
        file.seek(max(mebibyte, size - mebibyte) if size > mebibyte else size)
        digest.update(file.read(mebibyte))
    return digest.hexdigest()


def _to_bgr(picture: av.VideoFrame) -> NDArray[np.uint8]:
    """Return the picture as BGR (gray stays gray), turned upright.

    OpenCV's conversion takes 0.15-0.3 ms at 768x576, FFmpeg's 0.8 ms (decoding alone: 0.28). So the common
    form of video goes through OpenCV; together that is as quick as `cv2.VideoCapture` (0.56 ms), which has
    neither exact time stamps nor a word about damage. OpenCV knows only the television range of BT.601, so
    full-range, BT.709 and all rarer forms are left to FFmpeg.
    """
    name = picture.format.name
    image: NDArray[Any]
    if name in ("gray", "gray8"):
        image = picture.to_ndarray()
    elif (
        name == "yuv420p"
        and picture.width % 2 == 0
        and picture.height % 2 == 0
        and picture.color_range != 2  # full range
        and picture.colorspace in (2, 5, 6)  # unspecified, BT.601 for 625 and for 525 lines
    ):
        image = cv2.cvtColor(picture.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    else:
        image = picture.to_ndarray(format="bgr24")
    quarter_turns = round(picture.rotation / 90) % 4  # counter-clockwise, as a phone notes how it was held
    if quarter_turns:
        image = np.ascontiguousarray(np.rot90(image, quarter_turns))
    return np.asarray(image, dtype=np.uint8)


# --- cameras ------------------------------------------------------------------------------------------------


class _CameraReader:
    """A camera of this machine."""

    kind = "camera"
    live = True
    total: int | None = None
    truncated = False

    def __init__(self, index: int) -> None:
        self.name = str(index)
        self.last_number = 0
        self._capture = cv2.VideoCapture(index)
        if not self._capture.isOpened():
            raise OSError(f"camera {index}: cannot be opened")
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = rate if math.isfinite(rate) and rate > 0 else DEFAULT_RATE
        self.header_size = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    def frames(self, selection: Selection) -> Iterator[Frame]:
        opened: float | None = None
        for number in itertools.count(1):
            if selection.ended(number):
                return
            arrived, image = self._capture.read()
            now = time.monotonic()
            if not arrived:
                return
            self.last_number = number
            opened = now if opened is None else opened
            if number in selection:
                yield Frame(np.asarray(image, dtype=np.uint8), now - opened, number)

    def fingerprint(self) -> dict[str, Any]:
        return {"kind": self.kind, "name": self.name}

    def close(self) -> None:
        self._capture.release()


# --- wording ------------------------------------------------------------------------------------------------


def _public(source: str) -> str:
    """Return an address without user name and password."""
    if "://" not in source:
        return source
    parts = urlsplit(source)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))


def _describe(shape: tuple[int, ...]) -> str:
    return f"{shape[1]}x{shape[0]} {'gray' if len(shape) == 2 else 'colour'}"

"""Where frames come from: video files, folders of images, cameras and network streams."""

import glob
import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....models.core.checks import checked
from ....models.core.frame import Frame
from .images import IMAGE_SUFFIXES, ImageReader, images_among
from .live_reader import Camera, LiveReader
from .reader import DEFAULT_RATE, Reader, Selection
from .video_reader import VideoReader, without_password

__all__ = ["DEFAULT_RATE", "Selection", "Source", "describe", "fingerprint", "open_source"]

_log = logging.getLogger(__name__)

NETWORK_SCHEMES = frozenset({"http", "https", "rtsp", "rtsps"})
DECODE_AHEAD = 4  # frames: smooths uneven processing, yet holds little memory at 4K
CLOSING_SECONDS = (
    2.0  # for which the end of a thread is waited for that may be stuck in a driver or connection
)
SHOWN_GAPS = 5  # in words; the summary has all


class Source:
    """Frames of a video file, images, a camera or a stream; an iterator and a context manager.

    A thread opens the source and decodes a few frames ahead, so that decoding overlaps with processing, and
    Ctrl-C works while a server is silent. A live source does not wait for a slow consumer: the oldest waiting
    frame is dropped, with a gap in `Frame.number` and `Frame.time`.

    Parameters
    ----------
    open_reader
        opens the reader of the frames.
    selection
        selected frames.
    fits
        is called with the source, once its size is known, and raises a ValueError if that is too large.

    Attributes
    ----------
    name
        the source as the user gave it, without user name and password of an address.
    kind
        `"video"`, `"images"`, `"camera"` or `"stream"`.
    live
        whether frames arrive in real time; such a source cannot be read again, so a run cannot be resumed.
    n_frames
        number of frames expected for start, stop and step, including those up to `after` (for video: from its
        header); `None` if unknown.
    counted
        whether `n_frames` comes from a count, not from a duration, which may be too short.
    rate
        frames per second of the source, before `step`.
    size
        `(width, height)` px.
    pictures
        names of the image files in order, for a folder or glob.
    skipped
        numbers of unreadable frames so far, which are `Frame(None, ...)`.
    truncated
        whether the source ended before its announced end (known when it has ended).
    lost
        why a camera or stream was lost permanently; otherwise `None`.
    """

    def __init__(
        self, open_reader: Callable[[], Reader], selection: Selection, fits: "Callable[[Source], None] | None"
    ) -> None:
        self.skipped: list[int] = []
        self.truncated = False
        self.lost: str | None = None
        self._form: tuple[int, ...] | None = None
        self._stopping = threading.Event()
        self._queue = FrameQueue(DECODE_AHEAD)
        self._ended = False
        self._fits = fits
        self._reader: Reader
        self._decoded: deque[Frame] = deque()
        self._thread = threading.Thread(
            target=self._decode, args=(open_reader, selection), name="decode", daemon=True
        )
        self._thread.start()
        try:
            self._begin(selection)
        except BaseException:
            self.close()
            raise

    def _begin(self, selection: Selection) -> None:
        """Wait for the first readable frame: what cannot be read, or ends before `start`, is told at once."""
        item = self._queue.get()
        if isinstance(item, Exception):
            raise item
        reader = self._reader
        while isinstance(item, Frame):
            self._decoded.append(item)
            if item.image is not None:
                self.size = (item.image.shape[1], item.image.shape[0])
                if self._fits is not None and math.prod(self.size) > math.prod(reader.header_size):
                    self._fits(self)
                return
            item = self._queue.get()
        if item is not None:
            raise item
        self._end()
        if self.lost is not None and reader.last_number == 0:
            raise OSError(f"{self.name}: no picture came from it ({self.lost})")
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
        if self._decoded and not self._stopping.is_set():
            return self._checked(self._decoded.popleft())
        if self._ended or self._stopping.is_set():
            raise StopIteration
        item = self._queue.get()
        if isinstance(item, Frame):
            return self._checked(item)
        self._end()
        self.close()
        if item is not None:
            raise item
        raise StopIteration

    @property
    def stream(self) -> dict[str, Any] | None:
        """Gaps and losses of a camera or stream so far, as JSON; `None` for files.

        `lost`; `gaps`, with the fields of `Gap`; `dropped_frames`: number of frames that were not processed
        in time.
        """
        if self.kind not in ("camera", "stream"):
            return None
        gaps = [asdict(gap) for gap in self._reader.gaps]
        return {"lost": self.lost, "gaps": gaps, "dropped_frames": self._queue.dropped}

    @property
    def notes(self) -> list[str]:
        """Warnings so far, one sentence each."""
        notes = [*self._reader.notes]
        gaps = self._reader.gaps
        if gaps:
            times = "once" if len(gaps) == 1 else f"{len(gaps)} times"
            listed = "; ".join(map(str, gaps[:SHOWN_GAPS])) + (" …" if len(gaps) > SHOWN_GAPS else "")
            notes.append(f"{self.name} was lost {times} and reconnected: {listed}.")
        dropped = self._queue.dropped
        if dropped:
            notes.append(
                f"{dropped} frames were dropped, since they arrived faster than they were processed."
            )
        return notes

    def close(self) -> None:
        """Stop decoding; the thread releases the file or device.

        The end of a picture's decoding is waited for: a thread in OpenCV that outlives Python aborts it.
        """
        self._ended = True
        self._stopping.set()
        self._queue.close()
        is_picture = isinstance(getattr(self, "_reader", None), ImageReader)
        self._thread.join(None if is_picture else CLOSING_SECONDS)

    def fingerprint(self) -> dict[str, Any]:
        """Return an identifier of this source as JSON: equal ones are assumed to have the same frames."""
        return self._reader.fingerprint()

    def _end(self) -> None:
        """Take note of how the frames have ended."""
        self._ended = True
        self.truncated = self._reader.truncated
        self.lost = self._reader.lost

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
                f"{self.name}: frame {frame.number} is {describe(form)}, "
                f"expected {describe(self._form)} like the frames before"
            )
        return frame

    def _describe(self, reader: Reader, selection: Selection) -> None:
        """Take over what is known before a picture is decoded, and refuse what would be too large."""
        self.name = reader.name
        self.kind = reader.kind
        self.live = reader.live
        self.rate = reader.rate
        self.size = reader.header_size
        self.pictures = reader.pictures
        self.counted = reader.counted
        self.n_frames = None if reader.total is None else len(selection.numbers(reader.total))
        if self._fits is not None and all(self.size):
            self._fits(self)

    def _decode(self, open_reader: Callable[[], Reader], selection: Selection) -> None:
        outcome: Exception | None = None
        try:
            self._reader = reader = open_reader()
            put = self._queue.put_newest if reader.live else self._queue.put
            try:
                self._describe(reader, selection)
                for frame in reader.frames(selection, self._stopping):
                    put(frame)
                    if self._stopping.is_set():
                        return
            finally:
                reader.close()
        except Exception as error:  # handed over to the thread that iterates
            outcome = error
        self._queue.put(outcome)


@checked
def open_source(
    source: str | Path,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    *,
    after: int = 0,
    reconnect: float | None = None,
    fits: Callable[[Source], None] | None = None,
) -> Source:
    """Open a source of frames.

    Parameters
    ----------
    source
        a video file, a folder or glob of images (sorted naturally: `frame2` before `frame10`), the number of
        a camera, or an rtsp or http(s) address.
    start, stop, step
        frames to read: 1-based, both ends included. Frames before `start` are decoded and discarded, so that
        the selection is exact. Images have no time stamps; their rate is `frameRate` of a MOT `seqinfo.ini`
        in or above the folder, or 25 a second.
    after
        number of the last frame that an earlier run has processed; frames up to it are omitted.
    reconnect
        seconds for which a lost camera or address is reconnected; default: not at all. A gap in a live source
        consists of missing frames; a file at an address loses nothing.
    fits
        is called with the source before its first picture is decoded if a header states the size, or else
        with that picture; what it raises is raised here. For checks of the memory that a run would need.

    Raises
    ------
    ValueError
        if the selection is empty or beyond the end, the file is not a readable video or image, or `reconnect`
        is given for a file.
    FileNotFoundError
        if there is no such file, or no image in the folder or under the glob.
    OSError
        if a camera or address cannot be opened or sends no image for 10 s.
    """
    selection, name = Selection(start, stop, step, after), str(source)
    if reconnect is not None and not 0 < reconnect < math.inf:
        raise ValueError(f"--reconnect: got {reconnect:g}, expected seconds, more than 0")
    return Source(lambda: _open_reader(name, reconnect), selection, fits)


def fingerprint(source: str) -> dict[str, Any]:
    """Return `Source.fingerprint` of a file or a folder or glob of images; no picture is decoded."""
    reader = _open_reader(source, None)
    try:
        return reader.fingerprint()
    finally:
        reader.close()


def _open_reader(source: str, reconnect: float | None) -> Reader:
    scheme, separator, _ = source.partition("://")
    if separator:
        if scheme.lower() not in NETWORK_SCHEMES:
            schemes = ", ".join(sorted(NETWORK_SCHEMES))
            raise ValueError(f"{without_password(source)}: expected an address of one of {schemes}")
        video = VideoReader(source, network=True, reconnect=reconnect)
        if video.total is not None:
            return video
        return LiveReader(video, lambda: VideoReader(source, network=True), reconnect)
    path = Path(source)
    if source.isascii() and source.isdigit() and not path.exists():
        return LiveReader(Camera(int(source)), lambda: Camera(int(source)), reconnect)
    if reconnect is not None:
        raise ValueError(f"--reconnect: got it for {source}, expected a camera or an address")
    return _open_path(source, path)


def _open_path(source: str, path: Path) -> Reader:
    if path.is_dir():
        files = images_among(path.iterdir())
        if not files:
            raise FileNotFoundError(f"{source}: the folder holds no images; rsmcm batch takes one of films")
        return ImageReader(source, path, files)
    if path.is_file():
        if path.suffix.lower() in IMAGE_SUFFIXES:
            return ImageReader(source, path.parent, [path])
        return VideoReader(source, network=False)
    if path.exists():
        raise ValueError(f"{source}: neither a file nor a folder")
    if glob.has_magic(source):
        files = images_among(Path(match) for match in glob.glob(source, recursive=True))
        if not files:
            raise FileNotFoundError(f"{source}: matches no images")
        return ImageReader(source, files[0].parent, files)
    raise FileNotFoundError(f"{source}: no such file or folder")


def describe(shape: tuple[int, ...]) -> str:
    """Size and kind of images of this shape, in words."""
    return f"{shape[1]}x{shape[0]} {'gray' if len(shape) == 2 else 'colour'}"


ROOM, ROOM_BYTES = 50, 1 << 25  # of the newest, so many images may wait if they are small
WAKE_EVERY = 0.5  # seconds: on Windows, a wait without a limit is deaf to Ctrl-C


class FrameQueue:
    """A few frames that wait, and in the end `None`, or by what error it came to the end.

    `dropped` counts the images that `put_newest` has thrown away.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._items: deque[Frame | Exception | None] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self.dropped = 0

    def put(self, item: Frame | Exception | None) -> None:
        """Append an item, when there is room for it or the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or len(self._items) < self._size)
            self._append(item)

    def put_newest(self, frame: Frame) -> None:
        """Append a frame at once; where there is no room for its image, the oldest one goes.

        Small images have room for more of them: a stream begins with all that came while it was opened.
        """
        with self._changed:
            waiting = [item for item in self._items if isinstance(item, Frame) and item.image is not None]
            if frame.image is not None and len(waiting) >= self._room(frame.image):
                self._items.remove(waiting[0])
                self.dropped += 1
            self._append(frame)

    def get(self) -> Frame | Exception | None:
        """Take the oldest item, when there is one."""
        with self._changed:
            while not self._items:
                self._changed.wait(WAKE_EVERY)
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Let nobody wait any longer who puts."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _room(self, image: NDArray[np.uint8]) -> int:
        return max(self._size, min(ROOM_BYTES // image.nbytes, ROOM))

    def _append(self, item: Frame | Exception | None) -> None:
        self._items.append(item)
        self._changed.notify_all()

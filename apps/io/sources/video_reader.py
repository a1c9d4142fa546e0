"""Frames from a video file, or from an address: all of a file's, or those of a stream as they arrive."""

import errno
import hashlib
import math
import os
import re
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import av
import av.logging
import cv2
import numpy as np
from numpy.typing import NDArray

from ....models.core.checks import MOST_PIXELS
from ....models.core.frame import Frame
from ....models.numerics.threads import thread_count
from .reader import DEFAULT_RATE, Reader, Selection

MOST_RATE = 1000  # frames a second: above, FFmpeg has guessed the ticks of a clock
NETWORK_TIMEOUT = 10.0  # seconds for which a server may be silent
NO_TIMESTAMPS = 0x80  # FFmpeg's AVFMT_NOTIMESTAMPS: Motion JPEG over http, say
_SILENT = "nothing came for {:g} s"

# Before version 19, titles and the like that are no UTF-8 are errors, unless this is said.
_DECODING: dict[str, Any] = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}

# What is damaged is told by exceptions and missing frames; FFmpeg's own lines on standard error would only
# tear the progress bar.
av.logging.set_level(None)


class VideoReader(Reader):
    """A video file, or an address: of a file (with an end) or a stream (without), whose `total` is `None`.

    For `reconnect` seconds a file's server may be gone: it is asked for the rest then; nothing is missing.
    """

    def __init__(self, source: str, *, network: bool, reconnect: float | None = None) -> None:
        self.name = without_password(source)
        self.kind = "stream" if network else "video"
        self._path = source
        self.opened_at = time.perf_counter()
        self._container = self._opened(reconnect) if network else self._opened_file()
        try:
            self._stream = self._pictures_track()
        except ValueError:
            self._container.close()
            raise
        # Frame threads would report a damaged packet late, at another packet; and decoding has a core of its
        # own anyway, since it runs ahead of processing.
        self._stream.thread_type = "SLICE"
        self._stream.codec_context.thread_count = thread_count()
        self.header_size = (self._stream.codec_context.width, self._stream.codec_context.height)
        rate = self._stream.average_rate or self._stream.guessed_rate
        self.rate = float(rate) if rate and rate <= MOST_RATE else DEFAULT_RATE
        self._seconds = self._stated_seconds()
        self._counted = self._stream.frames or None
        self.total = self._counted
        self.counted = self._counted is not None
        if self.total is None and self._seconds is not None:
            self.total = max(1, round(self._seconds * self.rate))

    def _opened_file(self) -> av.container.InputContainer:
        try:
            container: av.container.InputContainer = av.open(self._path, **_DECODING)
        except (PermissionError, IsADirectoryError) as error:
            raise type(error)(error.errno, error.strerror, self.name) from None
        except (av.FFmpegError, OSError) as error:
            raise ValueError(f"{self.name}: not a video that can be read ({_reason(error)})") from None
        return container

    def _opened(self, reconnect: float | None) -> av.container.InputContainer:
        options = {"rtsp_transport": "tcp"}
        patience = NETWORK_TIMEOUT
        if reconnect is not None and self._path.lower().startswith("http"):
            # FFmpeg goes on at the byte where it was, which only a file has; streams are opened anew instead,
            # since their time stamps would hide the gap.
            options |= {
                "reconnect": "1",
                "reconnect_delay_max": str(math.ceil(reconnect)),
                "rw_timeout": str(round(NETWORK_TIMEOUT * 1e6)),
            }
            patience += reconnect
        limits = (NETWORK_TIMEOUT, patience)  # for opening, and for reading
        try:
            container: av.container.InputContainer = av.open(
                self._path, timeout=limits, options=options, **_DECODING
            )
        except (av.FFmpegError, OSError) as error:
            silent = time.perf_counter() - self.opened_at >= NETWORK_TIMEOUT
            reason = _SILENT.format(NETWORK_TIMEOUT) if silent else _reason(error)
            raise OSError(f"{self.name}: cannot be opened ({reason})") from None
        return container

    def _pictures_track(self) -> av.VideoStream:
        """Return the track that holds pictures of a size that can be decoded."""
        streams = [
            stream
            for stream in self._container.streams.video
            # a sound file's cover, and text, which FFmpeg draws as a picture of a terminal
            if not stream.disposition & av.stream.Disposition.attached_pic
            and stream.codec_context is not None
            and stream.codec_context.name != "ansi"
        ]
        if not streams:
            raise ValueError(f"{self.name}: not a video that can be read (no picture track)")
        codec = streams[0].codec_context
        if codec.width * codec.height > MOST_PIXELS:
            raise ValueError(
                f"{self.name}: got pictures of {codec.width}x{codec.height} px, "
                f"expected {MOST_PIXELS} pixels at most"
            )
        codec.options = {"max_pixels": str(MOST_PIXELS)}  # pictures that grow later are damaged ones
        return streams[0]

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

    def frames(self, selection: Selection, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the selected frames; one that is damaged is a missing frame."""
        for number, (seconds, picture) in enumerate(self._pictures(), start=1):
            if stopping.is_set():
                return
            self.last_number = number
            if number in selection:
                yield Frame(None if picture is None else to_bgr(picture), seconds, number)
            if selection.ended(number + 1):
                return

    def images(self) -> Iterator[tuple[float | None, NDArray[np.uint8] | None]]:
        """Yield the images of a stream as they arrive until it is `lost`, as `Feed` has it."""
        timed = not self._container.format.flags & NO_TIMESTAMPS
        for seconds, picture in self._pictures():
            yield seconds if timed else None, None if picture is None else to_bgr(picture)
        self.lost = self.lost or "it ended"

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
        if self.truncated and self.kind == "stream":
            self.lost = self.lost or "it ended before its announced end"

    def _packets(self) -> Iterator["av.Packet[av.VideoStream] | None"]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except (av.FFmpegError, OSError) as error:
                self.truncated = True
                if self.kind == "stream":
                    self.lost = _reason(error)
                packet = None
            if packet is None or (packet.size == 0 and packet.dts is None):
                yield None  # has the decoder give out what it holds back
                return
            yield packet

    def _time(self, stamp: int) -> float:
        return float(stamp * (self._stream.time_base or Fraction(1)))

    def fingerprint(self) -> dict[str, Any]:
        """Return name, length and a hash of both ends of a file; of an address, what it is called."""
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
        """Close the file or connection."""
        self._container.close()


def _reason(error: Exception) -> str:
    """What an error of FFmpeg says; "immediate exit" is our time limit, "input/output error" an end."""
    if isinstance(error, av.ExitError | TimeoutError):
        return _SILENT.format(NETWORK_TIMEOUT)
    if getattr(error, "errno", None) == errno.EIO:
        return "it broke off"
    return getattr(error, "strerror", None) or str(error)


def without_password(source: str) -> str:
    """Return an address without user name and password; a path as it is."""
    if "://" not in source:
        return source
    parts = urlsplit(source)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))


def _digest_of_ends(path: Path) -> str:
    """Return the sha256 of the first and the last MiB."""
    mebibyte = 1 << 20
    with path.open("rb") as file:
        digest = hashlib.sha256(file.read(mebibyte))
        size = file.seek(0, os.SEEK_END)
        file.seek(max(mebibyte, size - mebibyte) if size > mebibyte else size)
        digest.update(file.read(mebibyte))
    return digest.hexdigest()


def to_bgr(picture: av.VideoFrame) -> NDArray[np.uint8]:
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

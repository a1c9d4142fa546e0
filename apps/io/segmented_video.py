"""Videos that survive the end of their process at any moment: masks as data, overlays to look at."""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Literal, cast

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.files import UNFINISHED, naming, sync
from .segments import drop_segments, join_segments, segment_name


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
        drop_segments(path, behind=resume_after)

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

    def close(self, *, finished: bool) -> None:
        """Write the whole video; when the run is finished, remove the segments."""
        self.checkpoint()
        with _naming(self._path):
            join_segments(self._path, partial(_join, form=self._form), finished=finished)

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

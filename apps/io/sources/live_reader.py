"""Frames of a camera or stream as they arrive, also over losses of the connection."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from .reader import DEFAULT_RATE, Gap, Reader, Selection
from .video_reader import VideoReader

RETRY_EVERY = 0.5  # seconds between two attempts to connect

FILLED_SECONDS = 5.0
"""Of a gap that are filled with missing frames, which chains predict through one by one: they let go of what
they have not seen for three seconds. A longer gap ends in one large step."""

USUAL_STEPS = 9  # of which the median is the usual time between two pictures
MOST_DELAY = 20.0  # seconds from the time that a stream states for a picture to its arrival; HLS takes ten
LEAST_STEP = 1e-3  # seconds between two pictures, whatever is stated
STALL = 1.0  # seconds without a picture, in a connection that goes on, that are a gap as well


class Camera:
    """A connection to a camera, by its number."""

    kind = "camera"
    lost: str | None = None  # why there are no more images, once they have ended

    def __init__(self, index: int) -> None:
        self.name = str(index)
        self.opened_at = time.perf_counter()
        self._capture = cv2.VideoCapture(index)
        if not self._capture.isOpened():
            raise OSError(f"camera {index}: cannot be opened")
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = rate if math.isfinite(rate) and rate > 0 else DEFAULT_RATE
        self.header_size = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    def images(self) -> Iterator[tuple[None, NDArray[np.uint8]]]:
        """Yield images as they arrive, until the camera is gone; it does not say when it took them."""
        while True:
            arrived, image = self._capture.read()
            if not arrived:
                self.lost = "no more pictures come"
                return
            yield None, np.asarray(image, dtype=np.uint8)

    def fingerprint(self) -> dict[str, Any]:
        """Return its number."""
        return {"kind": self.kind, "name": self.name}

    def close(self) -> None:
        """Release the device."""
        self._capture.release()


class _Clock:
    """When pictures were taken, in seconds since the first.

    The time that a stream states is better than that of arrival: FFmpeg has held back a second of pictures
    when it gives out the first. But it counts within a connection only, and a stream's clock may be wrong.
    """

    def __init__(self) -> None:
        self._first: float | None = None
        self._latest = -math.inf
        self._began = 0.0  # what a stream counts from; all by `time.perf_counter`, which is monotonic

    def connected(self, opened_at: float) -> None:
        """A connection was made."""
        self._began = opened_at

    def time_of(self, stated: float | None) -> float:
        """Return the time of a picture that has just arrived, later than that of the one before."""
        now = time.perf_counter()
        if stated is None or not now - MOST_DELAY < self._began + stated <= now:
            self._began = now - (stated or 0.0)
        self._latest = max(self._began + (stated or 0.0), self._latest + LEAST_STEP)
        if self._first is None:
            self._first = self._latest
        return self._latest - self._first


class LiveReader(Reader):
    """What a camera or stream sends, with real times.

    When the connection is lost, a new one is made by `connect` as soon as there is somebody to connect to,
    for up to `reconnect` seconds (`None`: not at all). The gap is missing frames: numbers go on in step with
    time at the source's rate.
    """

    live = True

    def __init__(
        self, feed: VideoReader | Camera, connect: Callable[[], VideoReader | Camera], reconnect: float | None
    ) -> None:
        self.name = feed.name
        self.kind = feed.kind
        self.rate = feed.rate
        self.header_size = feed.header_size
        self.gaps: list[Gap] = []
        self._fingerprint = feed.fingerprint()
        self._feed = feed
        self._connect = connect
        self._reconnect = reconnect

    def frames(self, selection: Selection, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the selected frames until the connection is lost permanently."""
        for moment, image in self._arriving(stopping):
            self.last_number += 1
            if self.last_number in selection:
                yield Frame(image, moment, self.last_number)
            if selection.ended(self.last_number + 1):
                self.lost = None
                return

    def _arriving(self, stopping: threading.Event) -> Iterator[tuple[float, NDArray[np.uint8] | None]]:
        """Yield every image with its time (seconds since the first), `None` for one that is missing."""
        clock = _Clock()
        last: float | None = None  # time of the last image
        steps: deque[float] = deque(maxlen=USUAL_STEPS)  # s, between the latest images
        give_up: float | None = None  # when trying to connect ends, as long as there is no picture
        while True:
            clock.connected(self._feed.opened_at)
            for stated, image in self._feed.images():
                if stopping.is_set():
                    return
                moment = clock.time_of(stated)
                if last is not None:
                    step = moment - last
                    # a camera may send less often than it states
                    if self.lost or step > max(STALL, 5 / self.rate, 3 * median(steps or [0.0])):
                        yield from self._fill(last, moment, self.lost or "nothing came")
                    steps.append(step)
                self.lost = give_up = None
                yield moment, image
                last = moment
            self.lost = self.lost or self._feed.lost
            if self._reconnect is None or last is None:
                return
            now = time.perf_counter()
            give_up = now + self._reconnect if give_up is None else give_up
            if now > give_up or not self._connected_again(give_up, stopping):
                return

    def _fill(self, last: float, moment: float, reason: str) -> Iterator[tuple[float, None]]:
        """Note a gap, and yield the frames that are missing in it."""
        n_steps = max(1, round((moment - last) * self.rate))
        self.gaps.append(Gap(last, moment - last, n_steps - 1, reason))
        n_filled = min(n_steps - 1, round(FILLED_SECONDS * self.rate))
        for step in range(1, n_filled + 1):
            yield last + step * (moment - last) / n_steps, None
        self.last_number += n_steps - 1 - n_filled

    def _connected_again(self, give_up: float, stopping: threading.Event) -> bool:
        self._feed.close()
        while not stopping.wait(RETRY_EVERY):
            try:
                self._feed = self._connect()
            except (OSError, ValueError):  # it is not there, or something else is
                if time.perf_counter() > give_up:
                    break
            else:
                return True
        return False

    def fingerprint(self) -> dict[str, Any]:
        """Return what it is called."""
        return self._fingerprint

    def close(self) -> None:
        """Close the connection."""
        self._feed.close()

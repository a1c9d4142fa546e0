"""What a run tells of itself while it goes on, for threads that ask for what is newest."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame

Image = NDArray[np.uint8]
State = Literal["starting", "running", "finishing", "ended", "failed"]
"""Waits for its first frame; takes in frames; writes results; has written them; could not."""

LONGEST_SIDE = 1280  # px
QUALITY = 80  # of JPEG
INTERVAL = 0.04  # s between two pictures: a film may be processed faster than anybody looks
RECENT = 50  # frames over which their rate is taken
SHOWN_EVENTS = 20


class Picture(NamedTuple):
    """A JPEG of a picture, which counts from 1."""

    number: int
    data: bytes


class Running:
    """A run as it is just now.

    The run calls `begin`, `show`, `take_in`, `finish` and `end`, none of which waits for anybody; other
    threads call the rest.

    Parameters
    ----------
    out
        folder of the results.
    """

    def __init__(self, out: Path) -> None:
        self._changed = threading.Condition()
        self._encoding = threading.Lock()
        self._state: State = "starting"
        self._title = ""
        self._out = out
        self._n_frames: int | None = None
        self._stream: Callable[[], Mapping[str, Any] | None] = lambda: None
        self._frame: tuple[int, float, bool] | None = None  # number, time, whether it is missing
        self._facts: Mapping[str, object] = {}
        self._events: deque[str] = deque(maxlen=SHOWN_EVENTS)
        self._moments: deque[float] = deque(maxlen=RECENT)
        self._words: Sequence[str] = ()
        self._picture: Image | None = None
        self._number = 0  # of the picture
        self._encoded = Picture(0, b"")
        self._encoded_at = -INTERVAL

    # --- told by the run ---

    def begin(self, title: str, n_frames: int | None, stream: Callable[[], Mapping[str, Any] | None]) -> None:
        """Say what runs: how many frames are expected, if that is known, and what becomes of the stream."""
        with self._changed:
            self._title, self._n_frames, self._stream = title, n_frames, stream

    def take_in(self, frame: Frame, facts: Mapping[str, object], events: Sequence[str]) -> None:
        """A frame is done: what there is to say of it, and what has happened."""
        with self._changed:
            self._state = "running"
            self._frame, self._facts = (frame.number, frame.time, frame.missing), facts
            self._events.extend(events)
            self._moments.append(time.monotonic())

    def show(self, picture: Image) -> None:
        """Make this the picture, BGR; it must not change any more."""
        with self._changed:
            self._picture, self._number = picture, self._number + 1
            self._changed.notify_all()

    def finish(self) -> None:
        """All frames are done, and results are being completed."""
        with self._changed:
            self._state = "finishing"

    def end(self, words: Sequence[str] | None) -> None:
        """The run has ended, as these lines say; without complete results if there are none."""
        with self._changed:
            if not self.ended:
                self._state, self._words = ("failed", ()) if words is None else ("ended", words)
            self._changed.notify_all()

    # --- asked by others ---

    @property
    def ended(self) -> bool:
        """Whether nothing will change any more."""
        return self._state in ("ended", "failed")

    def wait_for_end(self, seconds: float) -> bool:
        """Return when the run has ended, or after so many seconds; whether it has."""
        with self._changed:
            return self._changed.wait_for(lambda: self.ended, seconds)

    def status(self) -> dict[str, Any]:
        """What there is to say, as JSON; times in s."""
        with self._changed:
            number, seconds, missing = self._frame or (None, None, False)
            moments = self._moments
            span = moments[-1] - moments[0] if moments else 0.0
            return {
                "state": self._state,
                "title": self._title,
                "frame": number,
                "frames": self._n_frames,
                "time": seconds,
                "missing": missing,
                "frames_per_second": (len(moments) - 1) / span if span else None,
                "seconds_since": time.monotonic() - moments[-1] if moments else None,
                "facts": dict(self._facts),
                "stream": self._stream(),
                "events": list(self._events),
                "results": str(self._out),
                "words": list(self._words),
            }

    def picture(self, after: int | None = None, seconds: float = 0.0) -> Picture | None:
        """The newest picture, if one behind number `after` (or any) is there within so many seconds.

        All who look share one encoding, and there is none more often than once in `INTERVAL`.
        """
        with self._changed:
            if after is None:
                after = max(self._number - 1, 0)
            if not self._changed.wait_for(lambda: self._number > after or self.ended, seconds):
                return None
        with self._encoding:
            if self._encoded.number <= after:
                time.sleep(max(0.0, self._encoded_at + INTERVAL - time.monotonic()))
                with self._changed:
                    picture, number = self._picture, self._number
                if picture is None or number <= after:
                    return None
                self._encoded_at = time.monotonic()
                self._encoded = Picture(number, _jpeg(picture))
            return self._encoded


def _jpeg(picture: Image) -> bytes:
    scale = LONGEST_SIDE / max(picture.shape[:2])
    if scale < 1:
        picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()

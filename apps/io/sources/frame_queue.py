"""Frames on their way from the thread that decodes them to the one that works on them."""

import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame

ROOM, ROOM_BYTES = 50, 1 << 25  # of the newest, so many images may wait if they are small
WAKE_EVERY = 0.5  # seconds: on Windows, a wait without a limit is deaf to Ctrl-C


class FrameQueue:
    """A few frames that wait, and in the end `None`, or by what error it came to the end.

    Parameters
    ----------
    size
        how many frames may wait that are put; of the newest, as many images at least.

    Attributes
    ----------
    dropped
        how many images `put_newest` has thrown away.
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

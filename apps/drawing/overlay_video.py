"""`overlay.mp4` of a run: what was made of every frame, drawn and encoded in a thread."""

from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..io.segmented_video import PLAYABLE, SegmentedVideo
from ..io.worker import Worker

Image = NDArray[np.uint8]

LONGEST_SIDE = 4096  # px: H.264 takes four times as many


class OverlayVideo:
    """A video of pictures that are drawn in a thread.

    Parameters
    ----------
    path
        of the video.
    rate
        pictures per second.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    ahead
        frames that may wait to be drawn.
    show
        is given each picture, in that thread.
    """

    def __init__(
        self,
        path: Path,
        rate: float,
        resume_after: int = 0,
        ahead: int = 1,
        show: Callable[[Image], None] | None = None,
    ) -> None:
        self._video = SegmentedVideo(path, rate, PLAYABLE, resume_after)
        self._worker = Worker("overlay", ahead)
        self._show = show

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._worker.stop()
        finally:
            self._video.close(finished=kind is None)

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        self._worker.wait()
        self._video.checkpoint()

    def write(self, frame: Frame, draw: Callable[[], Image | None]) -> None:
        """Append the picture of a frame, which `draw` makes, if any; what it uses must not change any more.

        Raises
        ------
        OSError
            if the video cannot be written; it may come with a later frame.
        """
        self._worker.submit(self._draw, frame, draw)

    def _draw(self, frame: Frame, draw: Callable[[], Image | None]) -> None:
        picture = draw()
        if picture is not None:
            self._video.write(picture, frame.number, frame.time)
            if self._show is not None:
                self._show(picture)


def enlargement(image: Image, least: int) -> int:
    """By which whole number a picture is enlarged to `least` lines; no side goes beyond `LONGEST_SIDE`."""
    height, width = (int(side) for side in image.shape[:2])
    return max(1, min(-(-least // height), LONGEST_SIDE // max(height, width)))


def caption(frame: Frame) -> str:
    """What is written above a frame."""
    return f"frame {frame.number}" + (" (missing)" if frame.missing else "")

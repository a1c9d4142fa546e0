"""Foreground masks as files."""

from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from ...models.files import sync
from .files import write_image
from .segmented_video import LOSSLESS_GRAY, SegmentedVideo
from .worker import Worker


class MaskWriter:
    """Foreground masks, 0 or 255: `foreground/bin000001.png` by frame number (CDnet), or `foreground.mkv`.

    Parameters
    ----------
    folder
        of the results; made where it is not there.
    mode
        `"none"`, `"png"` or `"video"`.
    rate
        pictures per second of the video.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(
        self,
        folder: str | Path,
        mode: Literal["none", "png", "video"] = "png",
        rate: float = 25.0,
        resume_after: int = 0,
    ) -> None:
        if mode not in ("none", "png", "video"):
            raise ValueError(f"masks: got {mode!r}, expected none, png or video")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder / "foreground"
        self._mode = mode
        self._video: SegmentedVideo | None = None
        self._worker: Worker | None = None
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
            self._worker = Worker("masks")

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

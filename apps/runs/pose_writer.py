"""What grows with the frames of a run that follows poses: arrays, and a video."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.overlay_video import OverlayVideo
from ..io.row_writer import RowWriter

Image = NDArray[np.uint8]


class PoseWriter:
    """`poses.npz` with a row a frame, and `overlay.mp4`.

    Parameters
    ----------
    folder
        of the results.
    size
        `(width, height)` px of the frames.
    rate
        frames per second.
    after
        number of the frame after which this run goes on; 0 for a new one.
    constants
        arrays that are written once.
    show
        is given each picture of the video, in another thread.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        rate: float,
        after: int,
        constants: Mapping[str, Any],
        show: Callable[[Image], None] | None = None,
    ) -> None:
        self._rows = RowWriter(folder / "poses.npz", constants, after)
        self._video = OverlayVideo(folder / "overlay.mp4", rate, after, show=show)
        self._open = ExitStack()
        self._image: Image = np.zeros((size[1], size[0], 3), np.uint8)  # the last one

    def __enter__(self) -> Self:
        self._open.enter_context(self._rows)
        self._open.enter_context(self._video)
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        self._rows.checkpoint()
        self._video.checkpoint()

    def write(
        self, frame: Frame, row: Mapping[str, Any], draw: Callable[[Image], Image]
    ) -> Callable[[], Image]:
        """Append a frame; `draw` draws on its image, or on the last one where it is missing.

        Returned is what makes the picture.
        """
        self._rows.append(frame.number, row)
        if frame.image is not None:
            self._image = frame.image
        image = self._image

        def drawn() -> Image:
            return draw(image)

        self._video.write(frame, drawn)
        return drawn

"""Frames that show nothing: black, saturated, or otherwise without contrast."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from ....models.core.grey import grey_of

LEAST_CONTRAST = 8
"""Grey levels between the darker and the brighter part of a frame, below which nothing is seen in it."""


def is_blank(image: NDArray[np.uint8]) -> bool:
    """Whether a frame is black, saturated or otherwise without contrast, so that nothing is seen in it."""
    darker, brighter = np.percentile(grey_of(image[::4, ::4]), (2, 98))
    return bool(brighter - darker < LEAST_CONTRAST)


class SeenFrames:
    """The frames of a source until it ends, or breaks, with blank ones as missing.

    Parameters
    ----------
    frames
        of the source.
    blank_is_missing
        if not, blank frames come as they are.

    Attributes
    ----------
    blank
        numbers of the frames so far that were blank.
    error
        by which the source broke in the middle, if it did: told when the results until there are complete.
    """

    def __init__(self, frames: Iterator[Frame], *, blank_is_missing: bool = True) -> None:
        self._frames = frames
        self._blank_is_missing = blank_is_missing
        self.blank: list[int] = []
        self.error: Exception | None = None

    def __iter__(self) -> Iterator[Frame]:
        try:
            for frame in self._frames:
                if self._blank_is_missing and frame.image is not None and is_blank(frame.image):
                    self.blank.append(frame.number)
                    yield replace(frame, image=None, keypoints=None)  # of what is not seen
                else:
                    yield frame
        except (ValueError, OSError) as error:
            self.error = error

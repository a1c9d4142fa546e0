"""A frame: an image with its time and its number."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a sequence.

    Parameters
    ----------
    image
        `(height, width)` or `(height, width, 3)` uint8, BGR as OpenCV gives it; `None` for a frame that is
        missing or could not be read.
    time
        seconds since the start of the sequence.
    number
        1-based number of the frame in its source.

    Raises
    ------
    ValueError
        if the image is neither `None` nor such an array, or the number is below 1.
    """

    image: NDArray[np.uint8] | None
    time: float
    number: int

    def __post_init__(self) -> None:
        image = self.image
        if image is not None and (
            image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3)
        ):
            raise ValueError(
                f"image: got {image.shape} {image.dtype} at frame {self.number}, "
                "expected (height, width) or (height, width, 3) uint8"
            )
        if self.number < 1:
            raise ValueError(f"number: got {self.number}, expected 1 or more (frames count from 1)")

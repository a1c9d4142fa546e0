"""Pictures without colour."""

import cv2
import numpy as np
from numpy.typing import NDArray


def grey_of(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """`(height, width)` uint8, rows contiguous, of a grey or a BGR picture `(height, width, 3)`."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return np.ascontiguousarray(grey)

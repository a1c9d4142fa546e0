"""Grey levels of pictures."""

import cv2
import numpy as np
from numpy.typing import NDArray


def grey_of(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the grey picture `(height, width)` uint8, rows contiguous, of a grey or BGR one."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return np.ascontiguousarray(grey)

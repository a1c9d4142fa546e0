"""A camera of this machine."""

import math
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .reader import DEFAULT_RATE


class Camera:
    """A connection to a camera, by its number."""

    kind = "camera"

    def __init__(self, index: int) -> None:
        self.name = str(index)
        self.lost: str | None = None
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

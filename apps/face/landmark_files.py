"""Landmarks that are given to the face application."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GivenLandmarks:
    """Landmarks from a file, of one frame or of many.

    Parameters
    ----------
    rows
        `(n_rows, n_landmarks, 2)` px, NaN where missing.
    pairs
        `(n_pairs, 2)`: index of a landmark, from 0, and its number in the model's list, from 1; `None` where
        the landmarks are in the model's own order.
    start, step
        which frames of the source the rows belong to: `start`, `start + step`, ...
    """

    rows: Array
    pairs: NDArray[np.int64] | None = None
    start: int = 1
    step: int = 1

    def of_frame(self, number: int) -> Array | None:
        """`(n_landmarks, 2)` px of the frame with this number; `None` if there are none."""
        row = (number - self.start) // self.step
        return self.rows[row] if 0 <= row < len(self.rows) else None

    def error(self, number: int, landmarks: Array) -> float:
        """Mean distance of a frame's landmarks `(n_landmarks, 2)` from the given ones, px.

        NaN where none is given for this frame, or only those of one frame are: they are where the track
        starts and say nothing about it.
        """
        given = self.of_frame(number)
        if given is None or len(self.rows) == 1:
            return np.nan
        distances = np.linalg.norm(landmarks - given, axis=1)
        known = np.isfinite(distances)
        return float(distances[known].mean()) if known.any() else np.nan

    @property
    def size(self) -> float:
        """Px: root of the area of the box round the first landmarks."""
        return float(np.sqrt(np.prod(np.nanmax(self.rows[0], axis=0) - np.nanmin(self.rows[0], axis=0))))

"""Landmarks that are given to the face application."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .track_files import FARTHEST

Array = NDArray[np.float64]

EXPECTED = "expected (n_frames, n_landmarks, 2) px, NaN where missing"


def read_landmarks(path: Path) -> Array:
    """Read landmarks of one or more frames from an `.npy` file.

    Parameters
    ----------
    path
        holds `(n_frames, n_landmarks, 2)` or `(n_landmarks, 2)` px, any real type, NaN where a landmark is
        missing.

    Returns
    -------
    NDArray[np.float64]
        `(n_frames, n_landmarks, 2)` px.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array, holds no landmark, infinities
        or landmarks of which one coordinate is missing.
    OSError
        if the file cannot be read.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except (zipfile.BadZipFile, EOFError, ValueError) as error:
        reason = "an array of objects" if "pickle=False" in str(error) else "no readable .npy file"
        raise ValueError(f"{path}: got {reason}, {EXPECTED}") from None
    if not isinstance(array, np.ndarray):
        array.close()
        raise ValueError(f"{path}: got an .npz file, {EXPECTED} in an .npy file")
    if array.ndim not in (2, 3) or array.shape[-1] != 2 or array.dtype.kind not in "iuf" or not array.size:
        raise ValueError(f"{path}: got {array.shape} {array.dtype}, {EXPECTED}")
    landmarks = array.astype(np.float64).reshape(-1, *array.shape[-2:])
    for wrong, what in (
        (np.abs(landmarks) > FARTHEST, f"expected finite px up to {FARTHEST:g}, NaN where missing"),
        (np.isnan(landmarks[..., :1]) != np.isnan(landmarks), "expected both coordinates or none"),
    ):
        if wrong.any():
            frame, point = np.argwhere(wrong.any(axis=2))[0]
            place = f"landmark {point} of frame {frame}"
            raise ValueError(f"{path}: got {landmarks[frame, point].tolist()} at {place} (from 0), {what}")
    return landmarks


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

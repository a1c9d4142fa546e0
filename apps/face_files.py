"""Files of the face application: landmarks that are given, and arrays that grow by a row a frame."""

import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from .results import naming, write_atomically
from .track_files import FARTHEST

Array = NDArray[np.float64]

EXPECTED = "expected (n_frames, n_landmarks, 2) px, NaN where missing"
CHUNK = 1 << 24
"""Bytes that are copied at a time."""


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


class RowWriter:
    """An `.npz` file whose arrays grow by a row a frame, of which one row at a time is in memory.

    Rows are collected in nameless files beside it, which vanish with the process. Nothing is compressed:
    numbers of a tracker hardly shrink.

    Parameters
    ----------
    path
        of the file, which appears when `finish` is called.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._columns: dict[str, tuple[IO[bytes], NDArray[Any]]] = {}
        self._n_rows = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file, _first in self._columns.values():
            file.close()

    def append(self, row: Mapping[str, Any]) -> None:
        """Append an entry to every array.

        Raises
        ------
        ValueError
            if it has other names, shapes or types than the first row.
        OSError
            if it cannot be written.
        """
        entries = {name: np.asarray(value) for name, value in row.items()}
        with naming(self._path):
            if not self._columns:
                for name, entry in entries.items():
                    self._columns[name] = (tempfile.TemporaryFile(dir=self._path.parent), entry)  # noqa: SIM115
            if entries.keys() != self._columns.keys():
                raise ValueError(f"row: got {', '.join(entries)}, expected {', '.join(self._columns)}")
            for name, entry in entries.items():
                file, first = self._columns[name]
                if (entry.shape, entry.dtype) != (first.shape, first.dtype):
                    raise ValueError(
                        f"{name}: got {entry.shape} {entry.dtype}, expected {first.shape} {first.dtype} "
                        "like the rows before"
                    )
                file.write(entry.tobytes())
        self._n_rows += 1

    def finish(self, constants: Mapping[str, Any]) -> None:
        """Write the file, whole or not at all: the arrays that grew, and others that did not.

        Raises
        ------
        OSError
            if it cannot be written.
        """
        with (
            write_atomically(self._path) as unfinished,
            zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as archive,
        ):
            for name, value in constants.items():
                with archive.open(f"{name}.npy", "w") as entry:
                    np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)
            for name, (file, first) in self._columns.items():
                header = {
                    "descr": np.lib.format.dtype_to_descr(first.dtype),
                    "fortran_order": False,
                    "shape": (self._n_rows, *first.shape),
                }
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array_header_1_0(entry, header)
                    file.seek(0)
                    shutil.copyfileobj(file, entry, CHUNK)
                file.close()  # gives its space back at once

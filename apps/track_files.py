"""Track files: tracks that somebody else has made, as frames without images."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.frame import Frame, GivenPoints
from .sources import DEFAULT_RATE, Selection

KEY = "tracks"
EXPECTED = f"expected {KEY!r} (n_frames, n_points, 2) px, NaN where missing"
FARTHEST = 1e7
"""px: coordinates beyond are taken for damage; their squares would drown everything else."""


def read_track_file(path: Path, selection: Selection) -> tuple[NDArray[np.float64], range]:
    """Read the array `tracks` of an `.npz` file.

    Parameters
    ----------
    path
        holds `tracks (n_frames, n_points, 2)` px, any real type, NaN where a point is missing.
    selection
        which of its frames.

    Returns
    -------
    tuple
        tracks `(n_selected, n_points, 2)` float64 and the 1-based numbers of the selected frames.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array, holds infinities or points of
        which one coordinate is missing, or the selection lies beyond its end.
    OSError
        if the file cannot be read.
    """
    array = _read_array(path)
    if array.ndim != 3 or array.shape[2] != 2 or array.dtype.kind not in "iuf":
        raise ValueError(f"{path}: got {KEY} {array.shape} {array.dtype}, {EXPECTED}")
    numbers = selection.numbers(len(array))
    if len(array) and not numbers:
        raise ValueError(f"start: got {selection.start}, but {path} has only {len(array)} frames")
    tracks = array[[number - 1 for number in numbers]].astype(np.float64)
    for wrong, what in (
        (np.abs(tracks) > FARTHEST, f"expected finite px up to {FARTHEST:g}, NaN where missing"),
        (np.isnan(tracks[..., :1]) != np.isnan(tracks), "expected both coordinates or none"),
    ):
        if wrong.any():
            frame, point = np.argwhere(wrong.any(axis=2))[0]
            place = f"frame {numbers[frame]}, point {point}"
            raise ValueError(f"{path}: got {tracks[frame, point].tolist()} at {place}, {what}")
    return tracks, numbers


def _read_array(path: Path) -> NDArray[Any]:
    names: list[str] | None = None
    try:
        content = np.load(path, allow_pickle=False)
        if isinstance(content, np.lib.npyio.NpzFile):
            with content:
                names = content.files
                if KEY in names:
                    array: NDArray[Any] = content[KEY]
                    return array
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError) as error:
        reason = "an array of objects" if "pickle" in str(error) and names else "no readable .npz file"
        raise ValueError(f"{path}: got {reason}, {EXPECTED}") from None
    if names is None:
        raise ValueError(f"{path}: got a single array, {EXPECTED} in an .npz file")
    raise ValueError(f"{path}: got arrays {', '.join(map(repr, names)) or 'none'}, {EXPECTED}")


def frames_of_tracks(tracks: NDArray[np.float64], numbers: range | None = None) -> list[Frame]:
    """Frames that hold the points of tracks; identities are the tracks' columns.

    Parameters
    ----------
    tracks
        `(n_frames, n_tracks, 2)` px, NaN where missing.
    numbers
        1-based number of each frame; default: 1, 2, ...
    """
    frames = []
    for number, points in zip(numbers or range(1, len(tracks) + 1), tracks, strict=True):
        seen = np.flatnonzero(~np.isnan(points[:, 0])).astype(np.int64)
        frames.append(Frame(None, (number - 1) / DEFAULT_RATE, number, GivenPoints(points[seen], seen)))
    return frames

"""Track files: tracks that somebody else has made, as frames without images."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame, GivenPoints
from .point_files import read_points
from .sources.open_source import DEFAULT_RATE, Selection


def read_track_file(
    path: Path, selection: Selection, *, half: bool = False
) -> tuple[NDArray[np.float64], range]:
    """Read some frames of a file of tracks.

    Parameters
    ----------
    path, half
        as for `read_points`.
    selection
        which of its frames.

    Returns
    -------
    tuple
        tracks `(n_selected, n_points, 2)` float64 and the 1-based numbers of the selected frames.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file, or the selection lies beyond its end.
    OSError
        if the file cannot be read.
    """
    tracks = read_points(path, half=half)
    numbers = selection.numbers(len(tracks))
    if not numbers:
        raise ValueError(f"start: got {selection.start}, but {path} has only {len(tracks)} frames")
    return tracks[[number - 1 for number in numbers]], numbers


def frames_of_tracks(tracks: NDArray[np.float64], numbers: range | None = None) -> list[Frame]:
    """Frames that hold the points of tracks; identities are the tracks' columns.

    Parameters
    ----------
    tracks
        `(n_frames, n_tracks, 2)` px, NaN where missing; one coordinate may be.
    numbers
        1-based number of each frame; default: 1, 2, ...
    """
    frames = []
    for number, points in zip(numbers or range(1, len(tracks) + 1), tracks, strict=True):
        seen = np.flatnonzero(~np.isnan(points).all(axis=1)).astype(np.int64)
        frames.append(Frame(None, (number - 1) / DEFAULT_RATE, number, GivenPoints(points[seen], seen)))
    return frames

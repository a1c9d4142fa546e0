"""Files of points over time, which are given as tracks or as landmarks: ours, and those of point trackers."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.files.array_files import SINGLE, Arrays, read_arrays
from ...models.points.point_arrays import FARTHEST, check_points

__all__ = ["FARTHEST", "read_points"]

KEY = "tracks"
EXPECTED = "expected (n_frames, n_points, 2) px, NaN where missing"

VISIBLE = 0.5
"""Probability of being visible, or occluded, above which a point is taken to be so."""

VIDEO = "video"
"""The array of a TAP-Vid file that tells the size of the pictures; only its shape is read."""


class Layout(NamedTuple):
    """How a point tracker names and orders its arrays.

    Parameters
    ----------
    points, flags
        names of the array of places, and of that which says which of them are seen.
    occluded
        whether the flags say which are *not* seen; then points are the first axis, frames the second, and
        places go from 0 to 1 (TAP-Vid); else frames are the first, and places are in px (CoTracker).
    """

    points: str
    flags: str
    occluded: bool


LAYOUTS = (
    Layout("tracks", "visibility", False),
    Layout("pred_tracks", "pred_visibility", False),
    Layout("points", "occluded", True),
)


def read_points(path: str | Path) -> NDArray[np.float64]:
    """Read points over time.

    Parameters
    ----------
    path
        `.npy`, or `.npz` with an array `tracks` or a single one: `(n_frames, n_points, 2)` px, or
        `(n_points, 2)` of one frame, any real type, NaN where a point is missing. Or an `.npz` of a point
        tracker: CoTracker's `tracks (n_frames, n_points, 2)` px and `visibility (n_frames, n_points)`, bool
        or probability (`pred_tracks` and `pred_visibility` are the same); TAP-Vid's `points (n_points,
        n_frames, 2)`, from 0 at the left and upper edge of the picture to 1 at the others, `occluded
        (n_points, n_frames)`, and `video (n_frames, height, width, 3)`. A leading axis of length 1 goes.

    Returns
    -------
    NDArray[np.float64]
        `(n_frames, n_points, 2)` px, NaN where a point is missing or not seen.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array, holds no point, infinities or
        points of which one coordinate is missing.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    arrays = read_arrays(path, EXPECTED, shape_only=(VIDEO,))
    layout = next((each for each in LAYOUTS if {each.points, each.flags} <= arrays.keys()), None)
    if layout is not None:
        points = _of_tracker(path, arrays, layout)
    else:
        key = KEY if KEY in arrays or len(arrays) != 1 else next(iter(arrays))
        if key not in arrays:
            listed = ", ".join(map(repr, arrays))[:60] or "none"
            raise ValueError(f"{path}: got arrays {listed}, expected {KEY!r} or a single one, {EXPECTED[9:]}")
        array = _single_film(arrays[key], 3)
        if array.ndim not in (2, 3) or not _are_places(array):
            raise _wrong(path, key, array, EXPECTED)
        points = _as_floats(array)
        points = points.reshape(-1, *points.shape[-2:])
    check_points(str(path), points)
    return points


def _of_tracker(path: Path, arrays: Arrays, layout: Layout) -> NDArray[np.float64]:
    """Points of a point tracker's file, NaN where they are not seen."""
    order = "(n_points, n_frames" if layout.occluded else "(n_frames, n_points"
    places, flags = _single_film(arrays[layout.points], 3), arrays[layout.flags]
    if places.ndim != 3 or not _are_places(places):
        raise _wrong(path, layout.points, arrays[layout.points], f"expected {order}, 2)")
    shape = places.shape[:2]
    if _longer(flags.shape) != _longer(shape) or flags.dtype.kind not in "biuf":
        raise _wrong(path, layout.flags, flags, f"expected {shape} {order})")
    points = _as_floats(places)
    points[(flags.reshape(shape) > VISIBLE) == layout.occluded] = np.nan
    if not layout.occluded:
        return points
    width, height = _video_size(path, arrays, points)
    return points.swapaxes(0, 1) * (width, height) - 0.5  # pixels' middles are at whole numbers


def _video_size(path: Path, arrays: Arrays, points: NDArray[np.float64]) -> tuple[int, int]:
    """`(width, height)` px of the pictures in which points go from 0 to 1."""
    if (np.abs(points - 0.5) > 1).any():
        raise ValueError(f"{path}: got points beyond 0 to 1, expected TAP-Vid's, as shares of the picture")
    if VIDEO not in arrays:
        raise ValueError(
            f"{path}: got points from 0 to 1 without {VIDEO!r}, expected it too, (n_frames, height, width, "
            "3), for the size of its pictures"
        )
    video = _single_film(arrays[VIDEO], 4)
    if video.ndim != 4 or len(video) != points.shape[1] or 0 in video.shape:
        raise _wrong(path, VIDEO, arrays[VIDEO], f"expected ({points.shape[1]}, height, width, 3)")
    return video.shape[2], video.shape[1]


def _single_film(array: NDArray[Any], axes: int) -> NDArray[Any]:
    """An array without the axis over films that point trackers put first, if there is one film."""
    return array[0] if array.ndim > axes and len(array) == 1 else array


def _longer(shape: tuple[int, ...]) -> list[int]:
    """A shape without axes of length 1, which point trackers add in front and behind."""
    return [length for length in shape if length != 1]


def _are_places(array: NDArray[Any]) -> bool:
    return bool(array.shape[-1] == 2 and array.dtype.kind in "iuf" and array.size)


def _as_floats(array: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore", over="ignore"):  # damage, which `check_points` finds
        return array.astype(np.float64)


def _wrong(path: Path, key: str, array: NDArray[Any], expected: str) -> ValueError:
    named = f"{key} " if key != SINGLE else ""
    return ValueError(f"{path}: got {named[:60]}{array.shape} {array.dtype}, {expected}")

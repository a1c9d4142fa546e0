"""Files of points over time, given as tracks or as landmarks: ours, those of point trackers, their frames."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.array_files import SINGLE, Arrays, read_arrays
from ...models.core.checks import checked
from ...models.points.point_tracks import MAX_COORDINATE, check_points, frames_of_tracks
from .sources.open_source import Selection

__all__ = ["MAX_COORDINATE", "frames_of_tracks", "read_points", "read_shapes"]

KEY = "tracks"
EXPECTED = "expected (n_frames, n_points, 2) px, NaN where missing"
SHAPES = "shapes"
EXPECTED_SHAPES = "expected (n_frames, n_points, 3)"

AXES_FIRST, AXES_BELOW = "X", "P3_gt"
"""Arrays of motion capture in MATLAB's files: (3, n_points, n_frames), and (3 n_frames, n_points) with all x
before all y before all z."""

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


@checked
def read_points(path: str | Path, *, allow_single: bool = False) -> NDArray[np.float64]:
    """Read points over time.

    Parameters
    ----------
    path
        `.npy`, or `.npz` with an array `tracks` or a single one: `(n_frames, n_points, 2)` px, or
        `(n_points, 2)` of one frame, any real type, NaN where a point is missing. Or an `.npz` of a point
        tracker: CoTracker's `tracks (n_frames, n_points, 2)` px and `visibility (n_frames, n_points)`, bool
        or probability (`pred_tracks` and `pred_visibility` are the same); TAP-Vid's `points (n_points,
        n_frames, 2)`, from 0 at the left and upper edge of the picture to 1 at the others, `occluded
        (n_points, n_frames)`, and `video (n_frames, height, width, 3)`. A leading axis of length 1 goes. Or
        motion capture as of `read_shapes`, of which x and y are taken: as seen from far away.
    allow_single
        whether a single coordinate of a point may be missing.

    Returns
    -------
    NDArray[np.float64]
        `(n_frames, n_points, 2)` px, NaN where a point is missing or not seen.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array, holds no point, infinities or,
        unless they may be there, points of which one coordinate is missing.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    arrays = read_arrays(path, EXPECTED, shape_only=(VIDEO,))
    layout = next((each for each in LAYOUTS if {each.points, each.flags} <= arrays.keys()), None)
    captured = _motion_capture(arrays)
    if layout is not None:
        points = _of_tracker(path, arrays, layout)
    elif captured is not None:
        points = captured[..., :2]
    else:
        key = _named_or_single(path, arrays, KEY, f", {EXPECTED[9:]}")
        array = _single_film(arrays[key], 3)
        if array.ndim not in (2, 3) or not _are_places(array):
            raise _wrong(path, key, array, EXPECTED)
        points = _as_floats(array)
        points = points.reshape(-1, *points.shape[-2:])
    check_points(str(path), points, allow_single=allow_single)
    return points


@checked
def read_shapes(path: str | Path) -> NDArray[np.float64]:
    """Read shapes in space over time: where every point is in every frame, `(n_frames, n_points, 3)`, finite.

    Parameters
    ----------
    path
        `.npy`, or `.npz` with an array `shapes` or a single one, `(n_frames, n_points, 3)`; or motion capture
        in a `.mat` file: `X (3, n_points, n_frames)`, or `P3_gt (3 n_frames, n_points)`, all x before all y
        before all z.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array.
    """
    path = Path(path)
    arrays = read_arrays(path, EXPECTED_SHAPES)
    shapes = _motion_capture(arrays)
    if shapes is None:
        key = _named_or_single(path, arrays, SHAPES)
        array = arrays[key]
        if array.ndim != 3 or array.shape[2] != 3 or array.dtype.kind not in "iuf" or not array.size:
            raise _wrong(path, key, array, EXPECTED_SHAPES)
        shapes = _as_floats(array)
    if not np.isfinite(shapes).all():
        raise ValueError(f"{path}: got shapes that are not finite, {EXPECTED_SHAPES}")
    return shapes


def _named_or_single(path: Path, arrays: Arrays, name: str, form: str = "") -> str:
    """The array of that name, or else the only one; where there is none, what is expected has a `form`."""
    if name in arrays:
        return name
    if len(arrays) == 1:
        return next(iter(arrays))
    listed = ", ".join(map(repr, arrays))[:60] or "none"
    raise ValueError(f"{path}: got arrays {listed}, expected {name!r} or a single one{form}")


def _motion_capture(arrays: Arrays) -> NDArray[np.float64] | None:
    """`(n_frames, n_points, 3)` of arrays as motion capture is handed on; `None` of others."""
    first, below = arrays.get(AXES_FIRST), arrays.get(AXES_BELOW)
    if first is not None and first.ndim == 3 and len(first) == 3 and first.dtype.kind in "iuf":
        return _as_floats(first.transpose(2, 1, 0))
    if below is not None and below.ndim == 2 and len(below) % 3 == 0 and below.dtype.kind in "iuf":
        return _as_floats(np.stack(np.split(below, 3), axis=-1))
    return None


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


def read_track_file(
    path: Path, selection: Selection, *, allow_single: bool = False
) -> tuple[NDArray[np.float64], range]:
    """Read the selected frames of a file of tracks, `path` and `allow_single` as for `read_points`.

    Returns
    -------
    tuple
        tracks `(n_selected, n_points, 2)` float64 and the 1-based numbers of the selected frames.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file, or the selection lies beyond its end.
    """
    tracks = read_points(path, allow_single=allow_single)
    numbers = selection.numbers(len(tracks))
    if not numbers:
        raise ValueError(f"start: got {selection.start}, but {path} has only {len(tracks)} frames")
    return tracks[[number - 1 for number in numbers]], numbers

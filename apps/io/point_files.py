"""Files of points over time, which are given as tracks or as landmarks."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...models.files.array_files import SINGLE, read_arrays
from ...models.points.point_arrays import FARTHEST, check_points

__all__ = ["FARTHEST", "read_points"]

KEY = "tracks"
EXPECTED = "expected (n_frames, n_points, 2) px, NaN where missing"


def read_points(path: Path) -> NDArray[np.float64]:
    """Read points over time.

    Parameters
    ----------
    path
        `.npy`, or `.npz` with an array `tracks` or a single one: `(n_frames, n_points, 2)` px, or
        `(n_points, 2)` of one frame, any real type, NaN where a point is missing.

    Returns
    -------
    NDArray[np.float64]
        `(n_frames, n_points, 2)` px.

    Raises
    ------
    ValueError
        naming what came and what was expected, if it is no such file or array, holds no point, infinities or
        points of which one coordinate is missing.
    OSError
        if the file cannot be read.
    """
    arrays = read_arrays(path, EXPECTED)
    key = KEY if KEY in arrays or len(arrays) != 1 else next(iter(arrays))
    if key not in arrays:
        listed = ", ".join(map(repr, arrays))[:60] or "none"
        raise ValueError(f"{path}: got arrays {listed}, expected {KEY!r} or a single one, {EXPECTED[9:]}")
    array = arrays[key]
    if array.ndim not in (2, 3) or array.shape[-1] != 2 or array.dtype.kind not in "iuf" or not array.size:
        named = f"{key} " if key != SINGLE else ""
        raise ValueError(f"{path}: got {named[:60]}{array.shape} {array.dtype}, {EXPECTED}")
    with np.errstate(invalid="ignore", over="ignore"):  # damage, which the next lines find
        points = array.astype(np.float64).reshape(-1, *array.shape[-2:])
    check_points(str(path), points)
    return points

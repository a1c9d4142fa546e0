"""Tracks, bodies and faces as netCDF files of `movement`, which napari opens with its plugin."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...models.array_files import read_fields
from ...models.body.upper_body import PARTS
from ...models.core.checks import Shape, checked
from ...models.core.identities import places_of
from ...models.files import MOST_NUMBERS, fitting, write_atomically
from ..options.libraries import needed
from .finished_run import FinishedRun, read_tracks_table

if TYPE_CHECKING:
    import xarray

Numbers = NDArray[np.float64]

SPACE = ["x", "y"]

POSES = "poses.npz"
OF_FRAMES = Annotated[NDArray[np.float64], Shape("n_frames", finite=False)]
PLACES = Annotated[NDArray[np.floating], Shape("n_frames", "n_points", 2, finite=False)]
OF_BODY = {
    "times": OF_FRAMES,
    "joints_2d": PLACES,
    "seen_probability": Annotated[NDArray[np.float64], Shape("n_frames", len(PARTS), finite=False)],
    "joint_names": Annotated[NDArray[np.str_], Shape("n_points")],
}
OF_FACE = {
    "times": OF_FRAMES,
    "landmarks": PLACES,
    "fit": OF_FRAMES,
    "lost": Annotated[NDArray[np.bool_], Shape("n_frames")],
}
"""Arrays that are read of `poses.npz`; the others, which may be large, stay where they are."""


@checked
def to_movement(run: str | Path, out: str | Path) -> str:
    """Write the tracks of a run as a netCDF file of `movement`, whole or not at all.

    `run` is the folder of a background, body or face run. Returns a line on what was written.

    Raises
    ------
    ValueError
        if it is no such run, its files are damaged, nothing was tracked, or it is too large for one array.
    OSError
        if a file cannot be read or written.
    ImportError
        if `xarray` is not installed.
    """
    dataset = movement_dataset(run)
    with write_atomically(Path(out)) as unfinished:
        dataset.to_netcdf(unfinished, engine="scipy")  # netCDF 3, which every reader of netCDF takes
    sizes = ", ".join(f"{name} {size}" for name, size in dataset.sizes.items())
    return f"{dataset.attrs['ds_type']}, {sizes}"


@checked
def movement_dataset(run: str | Path) -> "xarray.Dataset":
    """Return the tracks of a run as a dataset of `movement` 0.17 or newer (older ones have plural dims).

    Of a background run bounding boxes: `position` (the middle, px from the left and upper edge of the
    picture), `shape` (width and height, px) and `confidence`. Of a body and a face poses: `position` (px, the
    first pixel's middle at 0) and `confidence`: of a body's head and hands 1 where they were seen and 0 where
    not, NaN of the joints in between, which no detector looks for; of a face its fit, the share of the
    picture under it that its texture explains, 0 where it is lost and NaN where it was only predicted. A
    face's points are its landmarks, or its vertices where there are none. Depth stays in `poses.npz`.

    Parameters
    ----------
    run
        folder of the run.

    Returns
    -------
    xarray.Dataset
        with dims `time` (s), `space`, `keypoint` of poses, and `individual`; NaN where there is nothing.

    Raises
    ------
    ValueError, ImportError, OSError
        as of `to_movement`.
    """
    finished = FinishedRun.of(run, "background", "body", "face")
    make = {"background": _boxes, "body": _body, "face": _face}[finished.application]
    return make(finished)


def _boxes(run: FinishedRun) -> "xarray.Dataset":
    table, numbers = read_tracks_table(run.folder), run.numbers
    names = np.unique(table["id"])
    if not len(names):
        raise ValueError(
            f"{run.folder}: got a run without objects, expected one at least (netCDF has no axis of length 0)"
        )
    shape = (len(numbers), 2, len(names))
    if 2 * np.prod(shape, dtype=float) > MOST_NUMBERS:
        raise ValueError(
            f"{run.folder}: got {len(names)} objects in {len(numbers)} frames, expected at most "
            f"{MOST_NUMBERS} numbers in movement's dense arrays; tracks.csv holds them row by row"
        )
    row, column = (table["frame"] - numbers.start) // numbers.step, places_of(names, table["id"])
    if not ((row >= 0) & (row < len(numbers))).all():
        raise ValueError(f"{run.folder}: got objects in frames that are none of the run's")
    position, size, confidence = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape[::2], np.nan)
    for axis, (start, side) in enumerate((("x", "width"), ("y", "height"))):
        position[row, axis, column] = table[start] + table[side] / 2
        size[row, axis, column] = table[side]
    confidence[row, column] = table["confidence"]
    variables = {
        "position": (("time", "space", "individual"), position),
        "shape": (("time", "space", "individual"), size),
        "confidence": (("time", "individual"), confidence),
    }
    coordinates = {
        "time": _times(numbers, table["frame"], table["time"], run.rate),
        "individual": [f"id_{name}" for name in names.tolist()],
    }
    return _dataset(run, "bboxes", variables, coordinates)


def _times(numbers: range, measured: NDArray[np.int64], times: Numbers, rate: float) -> Numbers:
    """`(n,)` s of all frames: between those that are known, with objects, even; beyond them at the rate."""
    frames = np.arange(len(numbers), dtype=np.float64)
    if not len(measured):
        return (numbers.start - 1 + frames * numbers.step) / (rate * numbers.step)
    rows, first = np.unique((measured - numbers.start) // numbers.step, return_index=True)
    times = times[first]
    beyond = np.minimum(frames - rows[0], 0) + np.maximum(frames - rows[-1], 0)
    return np.asarray(np.interp(frames, rows, times) + beyond / rate)


def _body(run: FinishedRun) -> "xarray.Dataset":
    poses = read_fields(run.folder / POSES, "expected the poses of a body", OF_BODY)
    joints = [str(name) for name in poses["joint_names"]]
    confidence = np.full(poses["joints_2d"].shape[:2], np.nan)
    with fitting(run.folder / POSES, f"expected joints {', '.join(PARTS)}"):
        confidence[:, [joints.index(part) for part in PARTS]] = poses["seen_probability"]
    return _poses(run, poses["times"], poses["joints_2d"], confidence, joints)


def _face(run: FinishedRun) -> "xarray.Dataset":
    path, expected = run.folder / POSES, "expected the poses of a face"
    poses = read_fields(path, expected, OF_FACE)
    points, kind = poses["landmarks"], "landmark"
    there = np.isfinite(points).all(axis=2).any(axis=0)
    if not there.any():
        kinds = {"times": OF_FACE["times"], "vertices_2d": PLACES}
        points, kind = read_fields(path, expected, kinds)["vertices_2d"], "vertex"
        there = np.ones(points.shape[1], bool)
    confidence = np.where(poses["lost"], 0.0, poses["fit"])[:, None] * np.ones(there.sum())
    names = [f"{kind}_{place}" for place in np.flatnonzero(there)]
    return _poses(run, poses["times"], points[:, there], confidence, names)


def _poses(
    run: FinishedRun, times: Numbers, points: NDArray[np.floating], confidence: Numbers, names: Sequence[str]
) -> "xarray.Dataset":
    """Poses of one individual: `points (n_frames, n_points, 2)` px, `confidence (n_frames, n_points)`."""
    variables = {
        "position": (("time", "space", "keypoint", "individual"), points.swapaxes(1, 2)[..., None]),
        "confidence": (("time", "keypoint", "individual"), confidence[..., None]),
    }
    return _dataset(run, "poses", variables, {"time": times, "keypoint": names, "individual": ["id_1"]})


def _dataset(
    run: FinishedRun, kind: str, variables: dict[str, Any], coordinates: dict[str, Any]
) -> "xarray.Dataset":
    attributes = {
        "source_software": "rsmcm",
        "ds_type": kind,
        "fps": run.rate,
        "time_unit": "seconds",
        "source_file": str(run.folder),
    }
    dataset: xarray.Dataset = needed("xarray").Dataset(variables, {"space": SPACE, **coordinates}, attributes)
    return dataset

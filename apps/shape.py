"""`rsmcm shape`: a deformable model of an object, learned from point tracks."""

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..inference.nonrigid_shape import NonrigidShape, learn_shape
from ..models.morphable_files import write_model
from .progress import Progress

KEY = "tracks"
EXPECTED = "expected (n_frames, n_points, 2) px, NaN where missing"
SUFFIX = ".npz"
ITERATIONS = 300


def run_shape(tracks: Path, bases: int, out: Path, *, overwrite: bool = False) -> NonrigidShape:
    """Learn a morphable model from tracks, and write it.

    Parameters
    ----------
    tracks
        `.npy`, or `.npz` with an array `tracks` or a single one: `(n_frames, n_points, 2)` px, NaN where
        missing.
    bases
        how many, with the mean shape.
    out
        `.npz` to write, for `rsmcm.models.morphable_files.read_model`.
    overwrite
        replace `out` if it is there.

    Raises
    ------
    ValueError
        if there are no such tracks in the file, they cannot be learned from (see `learn_shape`), or `out` has
        another suffix.
    OSError
        if `tracks` cannot be read, or `out` is there or cannot be written.
    """
    if out.suffix.lower() != SUFFIX:
        raise ValueError(f"out: got {out}, expected a name that ends with {SUFFIX}")
    if out.exists() and not overwrite:
        raise FileExistsError(f"{out}: is there already: use --overwrite")
    positions = read_tracks(tracks)
    with Progress("shape", None, unit="iterations") as progress:
        try:
            learned = learn_shape(positions, bases, iterations=ITERATIONS, on_iteration=progress.update)
            model = learned.model()
        except ValueError as error:
            raise ValueError(f"{tracks}: {error}") from error
    out.parent.mkdir(parents=True, exist_ok=True)
    write_model(model, out)
    return learned


def in_words(learned: NonrigidShape) -> list[str]:
    """What is reported of a shape, in lines."""
    n_bases, n_points, _ = learned.bases.shape
    unknown = int(np.count_nonzero(~learned.frame_determined))
    lines = [
        f"{len(learned.scales)} frames, {n_points} points, {n_bases} bases",
        f"reprojection error {learned.rmse:.3g} px, {learned.relative_error:.2%} of the object's size; "
        f"noise {learned.noise:.3g} px",
        f"log likelihood {learned.log_likelihood:.6g} nats",
    ]
    if unknown:
        lines.append(f"{unknown} frames show too few points for a pose, and were left out")
    if len(learned.history) == ITERATIONS:
        gain = learned.history[-1] - learned.history[-2]
        lines.append(f"after {ITERATIONS} iterations the last one still gained {gain:.2g} nats")
    return lines


def read_tracks(path: Path) -> NDArray[np.float64]:
    """The tracks in a file: `(n_frames, n_points, 2)` px, NaN where missing.

    Raises
    ------
    ValueError
        naming the file and what came, if there are none.
    OSError
        if the file cannot be read.
    """
    try:
        content = np.load(path, allow_pickle=False)
        if isinstance(content, np.lib.npyio.NpzFile):
            with content:
                array = content[_key(path, content.files)]
        else:
            array = content
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError(f"{path}: got a damaged file, {EXPECTED} ({error})") from None
    except ValueError as error:
        if str(error).startswith(str(path)):
            raise
        kind = "an array of objects" if "Object arrays" in str(error) else "neither .npy nor .npz"
        raise ValueError(f"{path}: got {kind}, {EXPECTED}") from None
    if array.ndim != 3 or array.shape[2] != 2 or array.dtype.kind not in "iuf":
        raise ValueError(f"{path}: got {array.shape} {array.dtype}, {EXPECTED}")
    tracks: NDArray[np.float64] = array.astype(np.float64)
    return tracks


def _key(path: Path, names: Sequence[str]) -> str:
    if KEY in names:
        return KEY
    if len(names) == 1:
        return names[0]
    listed = ", ".join(map(repr, names)) or "none"
    raise ValueError(f"{path}: got arrays {listed}, expected {KEY!r} or a single one, {EXPECTED[9:]}")

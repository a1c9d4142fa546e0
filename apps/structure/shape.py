"""`rsmcm shape`: a deformable model of an object, learned from point tracks."""

from pathlib import Path

import numpy as np

from ...inference.nonrigid.learning import learn_shape
from ...inference.nonrigid.shape import NonrigidShape
from ...models.face.model_files import write_model
from ..io.point_files import read_points
from ..runs.progress import Progress

SUFFIX = ".npz"
ITERATIONS = 300


def run_shape(tracks: Path, bases: int, out: Path, *, overwrite: bool = False) -> NonrigidShape:
    """Learn a morphable model from tracks, and write it.

    Parameters
    ----------
    tracks
        as for `read_points`.
    bases
        how many, with the mean shape.
    out
        `.npz` to write, for `rsmcm.models.face.model_files.read_model`.
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
    positions = read_points(tracks)
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

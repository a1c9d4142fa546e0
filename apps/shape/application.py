"""The shape application: from tracks of points to a thing that deforms, and its motion."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...inference.sfm.depth import motion_of
from ...inference.sfm.nonrigid.learning import choose_bases, learn_shape
from ...inference.sfm.nonrigid.shape import shape_error
from ...models.face.model_files import write_model
from ..io.files import write_json
from ..io.point_files import read_shapes, read_track_file
from ..io.sources.open_source import Selection
from ..runs.interruption import Interrupted, Outcome
from ..runs.progress import Progress
from ..runs.session import Session
from ..view.page import VIEW, shortened, write_page
from .job import AUTO, ShapeJob
from .page import MODEL, SHAPES, LearnedShape, Numbers, shape_page, write_shapes

NAME = "shape"


def run_shape(job: ShapeJob) -> Outcome:
    """Run the shape application; all results are in the job's folder afterwards.

    There is no saved state, since a run takes seconds. Errors are those of `run_film`.
    """
    session = Session(NAME, job, job.settings())
    with session.running():
        selection = Selection(job.start, job.stop, job.step)
        tracks, numbers = read_track_file(Path(job.source), selection)
        truth = None if job.truth is None else _read_truth(job.truth, tracks, numbers)
        results = list(session.interruption.items(_learned(job, tracks, numbers)))
        if not results:
            assert session.interruption.signal is not None  # or there would be one
            raise Interrupted(session.interruption.signal)
        session.begin_results((SHAPES, MODEL))
        summary = _written(session, results[0], truth)
        session.ended_early = session.interruption.signal is not None
        return session.outcome(summary, in_words(summary))


def _learned(job: ShapeJob, tracks: Numbers, numbers: range) -> Iterator[LearnedShape]:
    """Learn the shape, the only item: a signal before it ends the run, one after it keeps all results."""
    with Progress(NAME, None, unit="iterations") as progress:
        try:
            choice = choose_bases(tracks, on_iteration=progress.update) if job.bases == AUTO else None
            bases = choice.bases if choice is not None else int(job.bases)
            learned = learn_shape(tracks, bases, smooth=job.smooth, on_iteration=progress.update)
            yield LearnedShape(tracks, numbers, learned, choice)
        except ValueError as error:
            raise ValueError(f"{job.source}: {error}") from error


def _written(session: Session, result: LearnedShape, truth: Numbers | None) -> dict[str, Any]:
    """Write all results; return the content of `summary.json`."""
    folder, learned, notes = session.job.out, result.learned, _notes(result)
    write_shapes(folder / SHAPES, result)
    write_model(learned.model(), folder / MODEL)
    choice = result.choice
    facts = {
        "points": result.tracks.shape[1],
        "bases": len(learned.bases),
        "observations": int(np.count_nonzero(result.observed)),
        "reprojection_rmse_px_per_point": math.sqrt(2) * learned.rmse,
        "reprojection_rmse_px_per_coordinate": learned.rmse,
        "reprojection_of_size": learned.relative_error,
        "noise_px_per_coordinate": learned.noise,
        "log_likelihood": learned.log_likelihood,
        "iterations": len(learned.history),
        "e3d": None if truth is None else shape_error(result.shapes, truth),
        "rivals": [asdict(rival) for rival in learned.rivals],
        "held_out": None
        if choice is None
        else [
            {"bases": bases, "error_px_per_coordinate": error}
            for bases, error in zip(choice.candidates, choice.errors.tolist(), strict=True)
        ],
        "notes": notes,
        "seconds": session.seconds(),
    }
    summary = session.summary(session.job.source, result.numbers, [], facts)
    title = f"{Path(session.job.source).name}: a shape that deforms"
    write_page(folder / VIEW, shape_page(title, result, summary))
    write_json(folder / "summary.json", summary)
    return summary


def in_words(summary: Mapping[str, Any]) -> list[str]:
    """Describe the number of points and how well they fit."""
    return [
        f"{summary['frames']} frames, {summary['points']} points, {summary['bases']} bases",
        f"reprojection error {summary['reprojection_rmse_px_per_point']:.3g} px per point, "
        f"{summary['reprojection_rmse_px_per_coordinate']:.3g} px per coordinate, "
        f"{summary['reprojection_of_size']:.2%} of the object's size; "
        f"noise {summary['noise_px_per_coordinate']:.3g} px per coordinate",
        f"log likelihood {summary['log_likelihood']:.6g} nats",
        *([] if summary["e3d"] is None else [f"error in 3-D (e3D) {summary['e3d']:.4f}"]),
    ]


def _read_truth(path: Path, tracks: Numbers, numbers: range) -> Numbers:
    """Read the true shapes of the selected frames; ValueError if frames or points differ."""
    truth = read_shapes(path)
    if len(truth) <= numbers[-1] - 1 or truth.shape[1] != tracks.shape[1]:
        raise ValueError(
            f"{path}: got {len(truth)} frames of {truth.shape[1]} points, expected {numbers[-1]} or more "
            f"frames of {tracks.shape[1]} points, as the tracks have"
        )
    return truth[[number - 1 for number in numbers]]


def _notes(result: LearnedShape) -> list[str]:
    """Return the notes on a result, a sentence each."""
    notes, learned = [], result.learned
    if motion_of(result.tracks, 1.0).kind == "still":
        notes.append("Nothing moves but for noise: depth and deformation of the shape are not determined.")
    unknown = [
        number for number, known in zip(result.numbers, learned.frame_determined, strict=True) if not known
    ]
    if unknown:
        frames = "1 frame shows" if len(unknown) == 1 else f"{len(unknown)} frames show"
        notes.append(f"{frames} too few points for a pose: {shortened(unknown)}.")
    if learned.rivals:
        most = max(rival.disagreement for rival in learned.rivals)
        gap = min(rival.log_likelihood_gap for rival in learned.rivals)
        notes.append(
            f"{len(learned.rivals)} other shapes explain the tracks nearly as well ({gap:.3g} nats less) "
            f"and disagree in depth: points lie up to {most:.0%} of the shape's standard deviation away "
            "(e3D). "
            "The reprojection error does not see that."
        )
    if result.choice is not None:
        notes.append(
            f"{result.choice.bases} bases: the fewest that predict held-out positions as well as any, by one "
            "standard error."
        )
    return notes

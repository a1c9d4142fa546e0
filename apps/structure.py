"""The structure application: from a film or tracks of points to their shape and the motion of the camera."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.frame import Frame
from .interruption import Interruption, Outcome
from .memory import STRUCTURE, STRUCTURE_FRAME, check_memory
from .predictions import write_predictions
from .progress import Progress
from .reconstruction import (
    FEWEST_POINTS,
    MOST_ROUNDS,
    Association,
    Coherence,
    Reconstruction,
    reconstruction_of,
    solve,
)
from .results import check_output, write_json, write_together
from .sources import DEFAULT_RATE, Selection, open_source
from .structure_files import point_colours, write_cameras, write_ply, write_tracks
from .structure_report import write_structure_report
from .track_files import frames_of_tracks, read_track_file
from .track_overlay import write_overlay
from .versions import versions

FEWEST_FRAMES = 3
TRACK_FILES = (".npy", ".npz")


@dataclass(frozen=True)
class StructureJob:
    """What to do; `rsmcm structure --help` explains each field."""

    source: str
    out: Path
    coherence: Coherence = "second-order"
    association: Association = "dual-chain"
    start: int = 1
    stop: int | None = None
    step: int = 1
    overwrite: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source."""
        return {
            "coherence": self.coherence,
            "association": self.association,
            "start": self.start,
            "stop": self.stop,
            "step": self.step,
        }


@dataclass(frozen=True, eq=False)
class Film:
    """What was read from the source.

    Parameters
    ----------
    name
        the source.
    frames
        with images, or with the points of a track file.
    rate
        frames per second, of those that were selected.
    n_tracks
        columns of the track file; `None` where there are images.
    notes
        what is out of the ordinary, a sentence each.
    """

    name: str
    frames: Sequence[Frame]
    rate: float
    n_tracks: int | None
    notes: tuple[str, ...]


def run_structure(job: StructureJob) -> Outcome:
    """Run the structure application; all results are in `job.out` afterwards.

    SIGINT (Ctrl-C) and SIGTERM end the ascent with the results of the last whole round. Nothing is written
    before the end.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with the job, its source or its output.
    KeyboardInterrupt
        if a signal came before there was any result.
    """
    check_output(job.out, overwrite=job.overwrite)
    started = time.perf_counter()
    film = read_film(job)
    with Interruption() as interruption:
        found = _solved(job, film, interruption)
        n_tracks = len(found.point_of_track)
        if n_tracks < FEWEST_POINTS:
            raise ValueError(
                f"{film.name}: got {n_tracks} points that can be tracked, expected {FEWEST_POINTS} or more"
            )
        if not found.n_points:
            raise ValueError(f"{film.name}: got {n_tracks} tracks that belong to no point, expected points")
        with write_together(job.out, overwrite=job.overwrite) as folder:
            summary = _write(folder, job, film, found, interruption, started)
    return Outcome(summary, interruption.signal)


def read_film(job: StructureJob) -> Film:
    """Read all frames of the job's source, which is a track file or anything that `open_source` takes.

    Raises
    ------
    ValueError
        if there are fewer than 3 frames or 4 points, the source is live and has no end, or its frames or
        arrays are not what they should be.
    OSError
        if it cannot be read.
    """
    film = _tracks(job) if Path(job.source).suffix.lower() in TRACK_FILES else _images(job)
    n_present = sum(not frame.missing for frame in film.frames)
    if n_present < FEWEST_FRAMES:
        raise ValueError(f"{film.name}: got {n_present} frames, expected {FEWEST_FRAMES} or more")
    return film


def _tracks(job: StructureJob) -> Film:
    tracks, numbers = read_track_file(Path(job.source), Selection(job.start, job.stop, job.step))
    seen = ~np.isnan(tracks[:, :, 0])
    n_seen = int(np.count_nonzero(seen.any(axis=0)))
    if len(tracks) >= FEWEST_FRAMES and n_seen < FEWEST_POINTS:
        raise ValueError(
            f"{job.source}: got {n_seen} points with an observation in {len(tracks)} frames, "
            f"expected {FEWEST_POINTS} or more"
        )
    notes = []
    empty = [number for number, some in zip(numbers, seen, strict=True) if not some.any()]
    if empty:
        notes.append(f"No point is seen in {_listed('frame', empty)}; cameras there are only predicted.")
    frames = frames_of_tracks(tracks, numbers)
    return Film(job.source, frames, DEFAULT_RATE / job.step, tracks.shape[1], tuple(notes))


def _images(job: StructureJob) -> Film:
    with open_source(job.source, job.start, job.stop, job.step) as source:
        if source.live and job.stop is None:
            raise ValueError(f"{source.name}: has no end, expected one, or --stop")
        n_frames = source.n_frames or job.stop or 1
        check_memory(source.name, source.size, STRUCTURE + n_frames * STRUCTURE_FRAME)
        frames = []
        with Progress("reading", source.n_frames) as progress:
            for frame in source:
                frames.append(frame)
                progress.update()
        notes = []
        if source.skipped:
            notes.append(f"Missing or unreadable: {_listed('frame', source.skipped)}.")
        if source.truncated:
            notes.append("The source ends before its announced end.")
        return Film(source.name, frames, source.rate / job.step, None, tuple(notes))


def _solved(job: StructureJob, film: Film, interruption: Interruption) -> Reconstruction:
    """The best solution, when the ascent ends or a signal arrives."""
    best: Any = None
    rounds: Iterator[Any] = solve(film.frames, job.coherence, job.association)
    try:
        with Progress("structure", MOST_ROUNDS, unit="rounds") as progress:
            for solution in interruption.items(rounds):
                best = solution
                progress.update()
    except ValueError as error:
        reason = str(error).removeprefix("positions: ")
        raise ValueError(f"{film.name}: no shape can be found in what is followed: {reason}") from None
    if best is None:
        raise KeyboardInterrupt
    return reconstruction_of(best, film.n_tracks)


def _write(
    folder: Path,
    job: StructureJob,
    film: Film,
    found: Reconstruction,
    interruption: Interruption,
    started: float,
) -> dict[str, Any]:
    frames = film.frames
    notes = [*film.notes, *_notes(found, film.n_tracks is not None)]
    colours: NDArray[np.uint8] = point_colours(frames, found)
    if found.geometry != "none":
        write_ply(folder / "structure.ply", found, colours)
    write_cameras(folder / "cameras.json", found, frames)
    write_tracks(folder / "tracks.npz", found, frames)
    write_predictions(folder, found.predictions)
    if film.n_tracks is None:
        write_overlay(folder / "overlay.mp4", frames, found, film.rate)
    summary = {
        "source": film.name,
        "frames": len(frames),
        "first_frame": frames[0].number,
        "last_frame": frames[-1].number,
        "missing": [frame.number for frame in frames if frame.missing],
        "tracks": len(found.point_of_track),
        "rejected_tracks": int(np.count_nonzero(found.point_of_track < 0)),
        "points": found.n_points,
        "observations": found.n_observations,
        "reprojection_rmse_px": found.reprojection_error,
        "reprojection_rmse_px_per_coordinate": found.reprojection_error / np.sqrt(2),
        "noise_px": float(np.sqrt(found.noise_variance)),
        "shape": found.geometry,
        "shape_reason": found.reason or None,
        "rounds": len(found.objective),
        "converged": found.converged,
        "ended_early": interruption.signal is not None,
        "objective": list(found.objective),
        "notes": notes,
        "seconds": time.perf_counter() - started,
        "parameters": job.settings,
        "versions": versions(),
    }
    title = f"{Path(film.name).name}: structure from motion"
    write_structure_report(folder / "report.html", frames, found, colours, notes, job.settings, title)
    write_json(folder / "summary.json", summary)
    return summary


def _notes(found: Reconstruction, given: bool) -> list[str]:
    """What is to be said about the result, a sentence each; `given` tracks are named."""
    notes = []
    if found.geometry == "none":
        notes.append(f"The shape is undetermined, and none is given: {found.reason}.")
    elif found.geometry == "affine":
        notes.append(f"The shape is known up to an affine map only: {found.reason}.")
    rejected = np.flatnonzero(found.point_of_track < 0).tolist()
    if rejected:
        which = f": {_listed('track', rejected)}" if given else ""
        notes.append(f"{len(rejected)} of {len(found.point_of_track)} tracks belong to no point{which}.")
    if not found.converged:
        notes.append("The ascent was ended before it converged.")
    return notes


def _listed(thing: str, numbers: Sequence[int], most: int = 20) -> str:
    """For instance "frames 3, 4, 7"; long lists are cut short."""
    listed = ", ".join(map(str, numbers[:most])) + (", …" if len(numbers) > most else "")
    return f"{thing}{'s' if len(numbers) > 1 else ''} {listed}"

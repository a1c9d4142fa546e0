"""The structure application: from a film or tracks of points to their shape and the motion of the camera."""

import hashlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference import Solution
from ...models.core.frame import Frame
from ..evaluation.predictions import write_predictions
from ..io.files import write_json
from ..io.sources.open_source import DEFAULT_RATE, Selection, open_source
from ..io.track_files import frames_of_tracks, read_track_file
from ..runs.interruption import Interrupted, Interruption, Outcome
from ..runs.memory import STRUCTURE, STRUCTURE_FRAME, check_memory
from ..runs.output_folder import OutputFolder, output_folder
from ..runs.progress import Progress
from ..runs.saved_run import STATE, check_source, read_about, saying_how_to_go_on
from ..runs.versions import versions
from .files import point_colours, write_cameras, write_ply, write_tracks
from .reconstruction import (
    FEWEST_POINTS,
    MOST_ROUNDS,
    Association,
    Coherence,
    Reconstruction,
    engine_for,
    reconstruction_of,
)
from .report import write_structure_report
from .track_overlay import write_overlay

APPLICATION = "structure"
FILES = (
    STATE,
    "structure.ply",
    "cameras.json",
    "tracks.npz",
    "predictions.npz",
    "summary.json",
    "report.html",
    "overlay.mp4",
)
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
    resume: bool = False
    overwrite: bool = False
    reconnect: float | None = None

    def __post_init__(self) -> None:
        if self.resume and self.overwrite:
            raise ValueError("--resume and --overwrite: got both, expected one of them")

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
    fingerprint
        by which the source is known again.
    notes
        what is out of the ordinary, a sentence each.
    stream
        what became of a camera or stream, as of `Source`.
    """

    name: str
    frames: Sequence[Frame]
    rate: float
    n_tracks: int | None
    fingerprint: dict[str, Any]
    notes: tuple[str, ...]
    stream: dict[str, Any] | None = None


def run_structure(job: StructureJob) -> Outcome:
    """Run the structure application; all results are in `job.out` afterwards.

    The state is saved after every round of the ascent. SIGINT (Ctrl-C) and SIGTERM end it with the results of
    the last whole round.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with the job, its source or its output.
    Interrupted
        if a signal came before there was any result.
    """
    with (
        Interruption() as interruption,
        output_folder(job.out, APPLICATION, overwrite=job.overwrite, resume=job.resume) as folder,
    ):
        run = StructureRun(job, folder, interruption)
        with saying_how_to_go_on(run.way_on):
            return run.carry_out()


class StructureRun:
    """One run: the film, and how far the ascent has come."""

    def __init__(self, job: StructureJob, folder: OutputFolder, interruption: Interruption) -> None:
        self._job = job
        self._folder = folder
        self._interruption = interruption
        self._state = job.out / STATE
        self._earlier_seconds = 0.0  # of wall time, before the run was resumed
        self._started = time.perf_counter()
        self._is_saved = False
        self._begun = False

    def way_on(self) -> str | None:
        """How an interrupted run goes on; `None` if nothing of it is saved."""
        return f"--resume goes on with {self._job.out}" if self._is_saved else None

    def carry_out(self) -> Outcome:
        """Read, ascend, write."""
        job = self._job
        about = None
        if job.resume and self._state.exists():
            about = read_about(self._state, APPLICATION, job.settings)
            self._earlier_seconds = about["seconds"]
            self._is_saved = True
        self._film = film = read_film(job)
        if about is not None:
            check_source(about, film.fingerprint)
            if about["finished"]:
                return Outcome(about["finished"], None)
        self._engine = engine_for(film.frames, job.coherence, job.association)
        after = None if about is None else self._engine.load(self._state, film.frames)[0]
        solution = self._ascended(after)
        found = reconstruction_of(solution, film.n_tracks)
        try:
            _check_found(film.name, found)
        except ValueError:
            self._state.unlink()  # there is nothing to go on with
            raise
        summary = _write(job, film, found, self._interruption, self._seconds())
        if not summary["ended_early"]:
            self._save(solution, finished=summary)
        return Outcome(summary, self._interruption.signal if summary["ended_early"] else None)

    def _ascended(self, after: Solution | None) -> Solution:
        """The best solution, when the ascent ends or a signal arrives; saved after every round."""
        best = after
        done = 0 if after is None else len(after.rounds)
        rounds = self._engine.rounds(self._film.frames, after=after)
        try:
            with Progress(APPLICATION, MOST_ROUNDS, done, unit="rounds") as progress:
                for solution in self._interruption.items(rounds):
                    self._begin()
                    best = solution
                    self._save(best)
                    progress.update()
        except ValueError as error:
            reason = str(error).removeprefix("positions: ")
            raise ValueError(
                f"{self._film.name}: no shape can be found in what is followed: {reason}"
            ) from None
        if best is None:
            assert self._interruption.signal is not None  # or there would be a first round
            raise Interrupted(self._interruption.signal)
        self._begin()
        return best

    def _begin(self) -> None:
        """Make the folder ready, once: not before there is something to write."""
        if not self._begun:
            self._folder.begin(FILES, resume=self._job.resume)
            self._begun = True

    def _save(self, solution: Solution, finished: dict[str, Any] | None = None) -> None:
        about = {
            "application": APPLICATION,
            "settings": self._job.settings,
            "source": self._film.fingerprint,
            "seconds": self._seconds(),
            "finished": finished,
        }
        self._engine.save(self._state, solution, about)
        self._is_saved = True

    def _seconds(self) -> float:
        return self._earlier_seconds + time.perf_counter() - self._started


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
    digest = hashlib.sha256(Path(job.source).read_bytes()).hexdigest()
    fingerprint = {"kind": "tracks", "name": job.source, "sha256": digest}
    return Film(job.source, frames, DEFAULT_RATE / job.step, tracks.shape[1], fingerprint, tuple(notes))


def _images(job: StructureJob) -> Film:
    with open_source(job.source, job.start, job.stop, job.step, reconnect=job.reconnect) as source:
        if source.live and job.resume:
            raise ValueError(f"--resume: {source.name} is live and cannot be read again")
        if source.live and job.stop is None:
            raise ValueError(f"{source.name}: has no end, expected one, or --stop")
        n_frames = source.n_frames or job.stop or 1
        check_memory(source.name, source.size, STRUCTURE + n_frames * STRUCTURE_FRAME)
        frames = []
        with Progress("reading", source.n_frames) as progress:
            for frame in source:
                frames.append(frame)
                progress.update()
        notes = source.notes
        if source.skipped:
            notes.append(f"Missing or unreadable: {_listed('frame', source.skipped)}.")
        if source.truncated:
            notes.append("The source ends before its announced end.")
        rate, fingerprint = source.rate / job.step, source.fingerprint()
        return Film(source.name, frames, rate, None, fingerprint, tuple(notes), source.stream)


def _check_found(name: str, found: Reconstruction) -> None:
    n_tracks = len(found.point_of_track)
    if n_tracks < FEWEST_POINTS:
        raise ValueError(
            f"{name}: got {n_tracks} points that can be tracked, expected {FEWEST_POINTS} or more"
        )
    if not found.n_points:
        raise ValueError(f"{name}: got {n_tracks} tracks that belong to no point, expected points")


def _write(
    job: StructureJob, film: Film, found: Reconstruction, interruption: Interruption, seconds: float
) -> dict[str, Any]:
    """Write all results; return the content of `summary.json`."""
    folder, frames = job.out, film.frames
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
        "reprojection_rmse_px_per_coordinate": found.reprojection_error / math.sqrt(2),
        "noise_px": float(np.sqrt(found.noise_variance)),
        "shape": found.geometry,
        "shape_reason": found.reason or None,
        "rounds": len(found.objective),
        "converged": found.converged,
        "ended_early": interruption.signal is not None
        or (film.stream is not None and film.stream["lost"] is not None),
        "stream": film.stream,
        "objective": list(found.objective),
        "notes": notes,
        "seconds": seconds,
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

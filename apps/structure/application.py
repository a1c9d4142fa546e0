"""The structure application: from a film or tracks of points to their shape and the motion of the camera."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.reconstruction import (
    MOST_ROUNDS,
    NoStructureError,
    Reconstruction,
    reconstruction_of,
    structure_engine,
    track_points,
    tracks_of,
)
from ...inference import Solution
from ...inference.engine import checkpoint
from ...models.core.frame import Frame
from ..evaluation.predictions import PairRecord, write_predictions
from ..exports.colmap import FILES as COLMAP_FILES
from ..exports.colmap import write_colmap
from ..io.files import write_json
from ..io.point_files import frames_of_tracks, read_track_file
from ..io.sources.open_source import DEFAULT_RATE, Selection, Source, fingerprint, open_source
from ..runs.interruption import Interrupted, Outcome
from ..runs.loop import run_film
from ..runs.memory import STRUCTURE, STRUCTURE_FRAME, STRUCTURE_POINTS, check_memory
from ..runs.progress import Progress
from ..runs.saved_run import STATE, about_of, check_source, words_of
from ..runs.session import OVERLAY, Session
from ..view.overlay import OverlayVideo, PointsOverlay
from ..view.page import VIEW, listed, write_page
from .diagnosis import Diagnosis, no_points, no_shape, standing, too_little
from .files import point_colours, recorded_predictions, write_cameras, write_ply, write_tracks
from .job import StructureJob
from .page import (
    EDGE,
    facts_of,
    film_of_tracks,
    in_words,
    known_lens,
    nothing_page,
    structure_page,
    view_row,
    write_film,
)
from .recursive import RecursiveRun

COLMAP = "colmap"
"""Folder for the perspective structure as COLMAP has it."""
TRACK_FILES = (".npy", ".npz", ".mat")


@dataclass(frozen=True, eq=False)
class Film:
    """Frames with images, or with the points of a track file, as they were read from the source.

    Of a track file `n_tracks` is the number of its columns. `rate` is in frames per second of those that
    were selected, `notes` are sentences on what is out of the ordinary, `pictures` the files of the frames,
    where the source consists of such, and `stream` is what became of a camera or stream, as of `Source`.
    """

    name: str
    frames: Sequence[Frame]
    rate: float
    n_tracks: int | None
    fingerprint: dict[str, Any]
    notes: tuple[str, ...]
    pictures: tuple[Path, ...] = ()
    stream: dict[str, Any] | None = None


NAME = "structure"
FILES = (
    "structure.ply",
    "cameras.json",
    "tracks.npz",
    "predictions.npz",
    *(f"{COLMAP}/{name}" for name in COLMAP_FILES),
)


def run_structure(job: StructureJob) -> Outcome:
    """Run the structure application; all results are in the job's folder afterwards.

    The state is saved after every round of the ascent. A signal ends it after the current round, with
    complete results. There are no results if the source cannot be read to its end. Errors are those of
    `run_film`.
    """
    if job.engine == "recursive-bp":
        if _is_of_tracks(job.source):
            raise ValueError(f"--engine {job.engine}: got tracks, {job.source}, expected a film or a stream")
        return run_film(RecursiveRun(job))
    session = Session(NAME, job, job.settings())
    with session.running():
        return _StructureRun(job, session).run()


class _StructureRun:
    """One run: the film and the state of the ascent."""

    def __init__(self, job: StructureJob, session: Session) -> None:
        self.job, self._session = job, session
        self._state = job.out / STATE
        self._begun = False

    def run(self) -> Outcome:
        """Read the film, run coordinate ascent, and write the results."""
        job, session = self.job, self._session
        saved = about = None
        if job.resume and self._state.exists():
            saved = checkpoint.read(self._state)
            about = about_of(saved, NAME, session.settings)
            session.earlier_seconds = about["seconds"]
            session.saved = True
            if summary := about["finished"]:  # what it says needs neither pictures nor memory for them
                check_source(about, _fingerprint(job.source))
                return session.outcome(summary, words_of(self._state, summary, in_words))
        self._film = film = read_film(job)
        session.fingerprint = film.fingerprint
        if about is not None:
            check_source(about, film.fingerprint)
        lacking = too_little(film.frames, film.n_tracks) or standing(film.frames)
        if lacking is not None:
            return self._nothing(lacking)
        self._engine = structure_engine(film.frames, job.coherence, job.association, job.robust)
        after = None if saved is None else self._engine.load(saved, film.frames)[0]
        try:
            solution = self._ascended(after)
        except ValueError as error:
            reason = str(error).removeprefix("positions: ")
            return self._nothing(no_points(film.frames, track_points(film.frames), reason))
        lens, about_lens = known_lens(film.frames, job.focal, next(iter(film.pictures), None))
        try:
            found = reconstruction_of(solution, job.camera, lens, film.n_tracks, job.robust)
        except NoStructureError:
            return self._nothing(no_points(film.frames, tracks_of(solution), ""))
        lost = film.stream is not None and film.stream["lost"] is not None
        session.ended_early = lost or session.interruption.signal is not None
        diagnosis = no_shape(found.reason, tracks_of(solution)) if found.geometry == "none" else None
        summary = self._written(found, recorded_predictions(solution), about_lens, diagnosis)
        if not session.ended_early:
            self._save(solution, finished=summary)
        return session.outcome(summary, in_words(summary))

    def _ascended(self, after: Solution | None) -> Solution:
        """Return the solution at which the ascent or a signal ends; it is saved after every round.

        A ValueError says why no shape can be found in what is followed.
        """
        best = after
        done = 0 if after is None else len(after.rounds)
        rounds = self._engine.rounds(self._film.frames, after=after)
        with Progress(NAME, MOST_ROUNDS, done, unit="rounds") as progress:
            for best in self._session.interruption.items(rounds):
                self._begin_once()
                self._save(best)
                progress.update()
        if best is None:
            assert self._session.interruption.signal is not None  # or there would be a first round
            raise Interrupted(self._session.interruption.signal)
        self._begin_once()
        return best

    def _begin_once(self) -> None:
        if not self._begun:
            self._session.begin_results(FILES)
            self._begun = True

    def _save(self, solution: Solution, finished: dict[str, Any] | None = None) -> None:
        self._engine.save(self._state, solution, self._session.about(finished))
        self._session.saved = True

    def _written(
        self,
        result: Reconstruction,
        predictions: Sequence[PairRecord],
        about_lens: str,
        diagnosis: Diagnosis | None,
    ) -> dict[str, Any]:
        """Write all results; return the content of `summary.json`."""
        folder, film, frames = self.job.out, self._film, self._film.frames
        notes = [*film.notes, *_notes(result, diagnosis, film.n_tracks is not None)]
        notes += _note_on_dropped(result, frames)
        lens = result.perspective
        if lens is not None:
            known = zip(frames, lens.frame_determined.tolist(), strict=True)
            if alone := [frame.number for frame, is_known in known if not is_known]:
                notes.append(
                    f"The camera is unknown in {len(alone)} of {len(frames)} frames: {listed(alone)}. "
                    "Points that others determine are too few, or halves of them place it elsewhere."
                )
            notes += [about_lens] if about_lens else []
        colours: NDArray[np.uint8] = point_colours(frames, result)
        if result.geometry != "none":
            write_ply(folder / "structure.ply", result, colours)
        write_cameras(folder / "cameras.json", result, frames)
        if result.perspective is not None:
            images = [(frame.number, self._picture_of(index)) for index, frame in enumerate(frames)]
            write_colmap(folder / COLMAP, result.perspective, result.places, result.observed, colours, images)
        write_tracks(folder / "tracks.npz", result, frames)
        write_predictions(folder, predictions)
        if film.n_tracks is None and self.job.video:
            _write_video(folder / OVERLAY, frames, result, film.rate)
        facts = {
            "tracks": len(result.point_of_track),
            "rejected_tracks": int(np.count_nonzero(result.point_of_track < 0)),
            **facts_of(result),
            "focal_length_px": None if lens is None else lens.cameras.focal,
            "focal_length_deviation_px": None if lens is None else lens.focal_deviation,
            "shape": result.geometry,
            "shape_reason": result.reason or None,
            "diagnosis": None if diagnosis is None else asdict(diagnosis),
            "rounds": len(result.objective),
            "converged": result.converged,
            "stream": film.stream,
            "objective": list(result.objective),
            "notes": notes,
        }
        summary = self._summary(facts)
        if film.n_tracks is None:
            shown, corner = write_film(folder, frames, film.rate, result), EDGE
        else:
            shown, corner = film_of_tracks(frames, result)
        page = structure_page(self._title, frames, result, colours, summary, shown, corner)
        write_page(folder / VIEW, page)
        write_json(folder / "summary.json", summary)
        return summary

    def _picture_of(self, index: int) -> str:
        """Name of a frame's picture; of a video's as if it was written out."""
        film = self._film
        return film.pictures[index].name if film.pictures else f"{film.frames[index].number:06d}.png"

    def _nothing(self, diagnosis: Diagnosis) -> Outcome:
        """Say why there is no structure, in `summary.json` and on the page."""
        self._begin_once()
        folder, film = self.job.out, self._film
        notes = [*film.notes, *diagnosis.sentences]
        summary = self._summary({**diagnosis.facts(), "stream": film.stream, "notes": notes})
        seen = film.n_tracks is None and any(frame.image is not None for frame in film.frames)
        shown = write_film(folder, film.frames, film.rate) if seen else None
        page = nothing_page(self._title, film.frames, diagnosis.figures, summary, shown)
        write_page(folder / VIEW, page)
        write_json(folder / "summary.json", summary)
        checkpoint.save(self._state, {"about": self._session.about(summary)}, {"about": dict[str, Any]})
        return self._session.outcome(summary, in_words(summary))

    def _summary(self, facts: Mapping[str, Any]) -> dict[str, Any]:
        film = self._film
        missing = [frame.number for frame in film.frames if frame.missing]
        facts = {**facts, "seconds": self._session.seconds()}
        return self._session.summary(film.name, [frame.number for frame in film.frames], missing, facts)

    @property
    def _title(self) -> str:
        return f"{Path(self._film.name).name}: structure from motion"


def read_film(job: StructureJob) -> Film:
    """Read all frames of the job's source, which is a track file or anything that `open_source` takes.

    A source that is live and has no end, or frames or arrays that are not what they should be, are
    ValueErrors.
    """
    return _tracks(job) if _is_of_tracks(job.source) else _images(job)


def _is_of_tracks(source: str) -> bool:
    return Path(source).suffix.lower() in TRACK_FILES


def _fingerprint(source: str) -> dict[str, Any]:
    """What tells a source from others, without its pictures."""
    if not _is_of_tracks(source):
        return fingerprint(source)
    return {"kind": "tracks", "name": source, "sha256": hashlib.sha256(Path(source).read_bytes()).hexdigest()}


def _tracks(job: StructureJob) -> Film:
    tracks, numbers = read_track_file(
        Path(job.source), Selection(job.start, job.stop, job.step), allow_single=True
    )
    known = ~np.isnan(tracks)
    seen, whole = np.asarray(known.any(axis=2)), np.asarray(known.all(axis=2))
    notes = []
    if n_half := int(np.count_nonzero(seen & ~whole)):
        notes.append(
            f"Positions with one known coordinate: {n_half}. Affine cameras and the shape use them; "
            "errors, counts and perspective cameras do not."
        )
    empty = [number for number, some in zip(numbers, seen, strict=True) if not some.any()]
    if empty:
        notes.append(f"No point is seen in {listed(empty)}; cameras there are only predicted.")
    frames = frames_of_tracks(tracks, numbers)
    rate, n_tracks = DEFAULT_RATE / job.step, tracks.shape[1]
    return Film(job.source, frames, rate, n_tracks, _fingerprint(job.source), tuple(notes))


def _images(job: StructureJob) -> Film:
    def fits(source: Source) -> None:
        n_frames = source.n_frames or job.stop or 1
        per_pixel = STRUCTURE + n_frames * STRUCTURE_FRAME
        check_memory(source.name, source.size, per_pixel, n_frames * STRUCTURE_POINTS)

    with open_source(job.source, job.start, job.stop, job.step, reconnect=job.reconnect, fits=fits) as source:
        if source.live and job.resume:
            raise ValueError(f"--resume: {source.name} is live and cannot be read again")
        if source.live and job.stop is None:
            raise ValueError(f"{source.name}: has no end, expected one, or --stop")
        frames = []
        with Progress("reading", source.n_frames) as progress:
            for frame in source:
                frames.append(frame)
                progress.update()
        notes = source.notes
        if source.skipped:
            notes.append(f"Missing or unreadable: {listed(source.skipped)}.")
        if source.truncated:
            notes.append("The source ends before its announced end.")
        rate = source.rate / job.step
        where = Path(job.source)
        where = where if where.is_dir() else where.parent
        pictures = tuple(where / source.pictures[frame.number - 1] for frame in frames if source.pictures)
        return Film(
            source.name, frames, rate, None, source.fingerprint(), tuple(notes), pictures, source.stream
        )


def _write_video(path: Path, frames: Sequence[Frame], result: Reconstruction, rate: float) -> None:
    """Write a video of all frames with their points."""
    with Progress("overlay", len(frames)) as progress, OverlayVideo(path, rate, PointsOverlay()) as video:
        for index, frame in enumerate(frames):
            video.add(frame, partial(view_row, result, index))
            progress.update()


def _note_on_dropped(result: Reconstruction, frames: Sequence[Frame]) -> list[str]:
    """Return a note on the tracked positions that no point explains, if there are any."""
    if result.dropped is None or not result.dropped.any():
        return []
    tracked = result.dropped + result.observed.sum(axis=1)
    mostly = [frame.number for frame, most in zip(frames, 2 * result.dropped > tracked, strict=True) if most]
    where = f"; in {listed(mostly)} more than half" if mostly else ""
    count = f"{result.dropped.sum()} of {tracked.sum()}"
    return [f"{count} tracked positions were dropped, since no point explains them{where}."]


def _notes(result: Reconstruction, diagnosis: Diagnosis | None, given: bool) -> list[str]:
    """Return the notes on a result, a sentence each; rejected tracks are listed if `given`."""
    notes = [] if diagnosis is None else list(diagnosis.sentences)
    if result.geometry == "affine":
        notes.append(f"The shape is known up to an affine map only: {result.reason}.")
    rejected = (np.flatnonzero(result.point_of_track < 0) + 1).tolist()
    if rejected:
        which = f" (counted from 1): {listed(rejected, 'track')}" if given else ""
        notes.append(f"{len(rejected)} of {len(result.point_of_track)} tracks belong to no point{which}.")
    if not result.converged:
        notes.append("The ascent was ended before it converged.")
    return notes

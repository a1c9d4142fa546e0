"""The background application: from a source of frames to masks, tracks, pictures and a report."""

import logging
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..inference import Belief, MultiChain, RecursiveBP
from ..inference.recursive_bp import BEGINNING
from ..models import Frame, ObjectBoxes, PixelLabels
from ..models.threads import thread_count
from .ground_truth import MaskTruth, common_frames, read_ground_truth
from .interruption import Interruption, Outcome
from .parameters import SECTIONS, Parameters, build_chain, read_parameters, with_defaults
from .progress import Progress
from .region import inside, read_region
from .report import RunRecord, write_report
from .results import (
    RESULT_PATTERNS,
    MaskWriter,
    OverlayWriter,
    TrackedObject,
    TrackWriter,
    draw_overlay,
    naming,
    prepare_output,
    read_tracks,
    write_image,
    write_json,
)
from .scoring import Scoring, track_rows
from .sources import Source, open_source
from .versions import versions

_log = logging.getLogger(__name__)

Engine = Literal["recursive-bp", "feed-forward", "stand-alone"]
ENGINES: tuple[Engine, ...] = ("recursive-bp", "feed-forward", "stand-alone")

EVIDENCE_EVERY = 10
"""Frames between two values of log p(I) in the report: nothing else needs that pass over the pixels."""


def build_model(engine: Engine = "recursive-bp", parameters: Parameters | None = None) -> MultiChain:
    """Connect the background application's chains.

    Parameters
    ----------
    engine
        `"recursive-bp"`: background, blobs and ground plane correct each other. `"feed-forward"`: the same
        chains, but the background hears nothing of the blobs. `"stand-alone"`: the background by itself.
    parameters
        those of the chains that differ from their defaults, by section and name; a section's `model` says
        which chain it is.

    Raises
    ------
    ValueError
        if there is no such engine, or a parameter is out of range.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine: got {engine!r}, expected one of {', '.join(ENGINES)}")
    chains = {section: build_chain(section, parameters or {}) for section in SECTIONS}
    pixels, objects = PixelLabels(), ObjectBoxes()
    model = MultiChain().connect(chains["background"], pixels)
    if engine == "stand-alone":
        return model
    return (
        model.connect(chains["blobs"], pixels, feedback=engine == "recursive-bp")
        .connect(chains["blobs"], objects)
        .connect(chains["ground"], objects)
    )


@dataclass(frozen=True)
class Found:
    """What was found in a frame.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, 0 or 255.
    tracks
        boxes in px with identities.
    """

    foreground: NDArray[np.uint8]
    tracks: list[TrackedObject]


def found_in(belief: Belief, size: tuple[int, int], region: NDArray[np.uint8] | None = None) -> Found:
    """Read mask and tracks from a belief; of a frame without image, they are what the chains predict.

    Parameters
    ----------
    belief
        after the frame.
    size
        `(width, height)` px.
    region
        `(height, width)` uint8: the mask is 0 where this is, and tracks that stand there are left out.
    """
    if not belief.states:  # no image yet
        return Found(np.zeros((size[1], size[0]), np.uint8), [])
    foreground: NDArray[np.uint8] = belief["pixels"].foreground()
    if region is not None:
        foreground &= region
    tracks = belief["blobs"].tracks() if "blobs" in belief.states else []
    return Found(foreground, inside(region, tracks))


@dataclass(frozen=True)
class Job:
    """What to do; `rsmcm background --help` explains each field."""

    source: str
    out: Path
    engine: Engine = "recursive-bp"
    config: Path | None = None
    roi: str | None = None
    start: int = 1
    stop: int | None = None
    step: int = 1
    resume: bool = False
    overwrite: bool = False
    every: int = 500
    masks: Literal["none", "png", "video"] = "png"
    ground_truth: Path | None = None
    seed: int = 0

    def settings(self, parameters: Parameters) -> dict[str, Any]:
        """What the results depend on: a run is resumed only with the same."""
        return {
            "engine": self.engine,
            "roi": self.roi,
            "start": self.start,
            "stop": self.stop,
            "step": self.step,
            "masks": self.masks,
            "ground_truth": None if self.ground_truth is None else str(self.ground_truth.resolve()),
            "seed": self.seed,
            **with_defaults(parameters),
        }


def run_background(job: Job) -> Outcome:
    """Run the background application; all results are in `job.out` afterwards.

    SIGINT (Ctrl-C) and SIGTERM end the run after the current frame, with complete results; a second one ends
    it at once, with results up to the last saved state.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with the job, its files or its output.
    """
    if job.every < 1:
        raise ValueError(f"--every: got {job.every}, expected 1 or more frames")
    if job.resume and job.overwrite:
        raise ValueError("--resume and --overwrite: got both, expected one of them")
    parameters = read_parameters(job.config) if job.config else {}
    run = _Run(job, job.settings(parameters), RecursiveBP(build_model(job.engine, parameters)))
    with Interruption() as interruption:
        return run.carry_out(interruption)


class _EndedEarlyError(Exception):
    """Leaves the writers' blocks in a way that they keep what a resumed run needs."""


class _Run:
    """One run: what it knows, and in which order it is saved."""

    def __init__(self, job: Job, settings: dict[str, Any], engine: RecursiveBP) -> None:
        self._job = job
        self._settings = settings
        self._engine = engine
        self._state = BEGINNING
        self._record = RunRecord()
        self._scoring: Scoring | None = None
        self._fingerprint: dict[str, Any] = {}
        self._earlier_seconds = 0.0  # of wall time, before the run was resumed
        self._started = 0.0
        self._ended_early = False
        self._error: Exception | None = None  # of the source, in the middle

    def carry_out(self, interruption: Interruption) -> Outcome:
        job = self._job
        saved = self._load() if job.resume else None
        with open_source(job.source, job.start, job.stop, job.step, after=self._state.number) as source:
            self._fingerprint = source.fingerprint()
            if job.resume and source.live:
                raise ValueError(f"--resume: {source.name} is live and cannot be read again")
            if saved is not None:
                _refuse_other("source", _identity(saved["source"]), _identity(self._fingerprint))
            if saved is not None and saved["finished"]:
                return Outcome(saved["finished"], None)
            if self._state.shape is not None:  # perhaps no frame is left to ask
                source.size = (self._state.shape[1], self._state.shape[0])
            region = read_region(job.roi, source.size) if job.roi else None
            self._scoring = read_truth(job, source, region)
            if self._scoring is not None and saved is not None:
                self._scoring.restore(saved["scores"])
            prepare_output(job.out, overwrite=job.overwrite, resume=job.resume)
            self._started = time.perf_counter()
            try:
                self._process(source, region, interruption)
            except _EndedEarlyError:
                self._ended_early = True
            summary = self._finish(source)
        if self._error is not None:
            raise self._error
        return Outcome(summary, interruption.signal)

    def _process(self, source: Source, region: NDArray[np.uint8] | None, interruption: Interruption) -> None:
        """Take in all frames, and complete the files that grow with them."""
        job, number = self._job, self._state.number
        rate = source.rate / job.step
        with (
            Progress("background", source.n_frames, len(self._record.numbers)) as progress,
            TrackWriter(job.out / "tracks.txt", number) as tracks,
            MaskWriter(job.out, job.masks, rate, number) as masks,
            OverlayWriter(job.out / "overlay.mp4", rate, number) as overlay,
        ):
            self._save()
            unsaved = 0
            for frame in self._frames(source, interruption):
                before = time.perf_counter()
                belief = self._engine.step(self._state, frame)
                found = found_in(belief, source.size, region)
                spent = time.perf_counter() - before
                self._state = belief.state
                tracks.write(frame.number, found.tracks)
                masks.write(found.foreground, frame.number, frame.time)
                overlay.write(frame, found.foreground, found.tracks)
                if self._scoring is not None:
                    self._scoring.add(frame.number, found.foreground)
                self._note(belief, found, spent)
                unsaved += 1
                if unsaved == job.every:
                    unsaved = 0
                    self._checkpoint(tracks, masks, overlay)
                progress.update()
            self._checkpoint(tracks, masks, overlay)
            if interruption.signal is not None or self._error is not None:
                raise _EndedEarlyError

    def _frames(self, source: Source, interruption: Interruption) -> Iterator[Frame]:
        """The source's frames until it ends, breaks, or somebody interrupts."""
        try:
            yield from interruption.items(source)
        except (ValueError, OSError) as error:
            self._error = error  # told at the end, when the results until here are complete

    def _note(self, belief: Belief, found: Found, spent: float) -> None:
        frame = belief.frame

        def overlay() -> NDArray[np.uint8]:
            assert frame.image is not None
            return draw_overlay(frame.image, found.foreground, found.tracks, {}, f"frame {frame.number}")

        due = len(self._record.numbers) % EVIDENCE_EVERY == 0
        self._record.add(
            frame,
            found.tracks,
            found.foreground,
            lambda: belief["background"].picture(),
            overlay,
            belief.log_evidence if due else np.nan,
            spent,
        )

    def _finish(self, source: Source) -> dict[str, Any]:
        """Write what is written once, at the end."""
        job = self._job
        metrics = None
        if self._scoring is not None:
            rows = None if job.engine == "stand-alone" else track_rows(read_tracks(job.out / "tracks.txt"))
            metrics = self._scoring.measures(rows)
        summary = self._summary(source, metrics)
        if self._state.states:
            background = self._state.states["background"].picture()
            write_image(job.out / "background.png", background)
            title = f"{Path(source.name).name}: {job.engine}"
            write_report(job.out / "report.html", self._record, background, self._settings, metrics, title)
        write_json(job.out / "summary.json", summary)
        if not summary["ended_early"]:
            self._save(finished=summary)
        return summary

    def _summary(self, source: Source, metrics: Mapping[str, Any] | None) -> dict[str, Any]:
        record, seconds = self._record, self._seconds()
        count = len(record.numbers)
        return {
            "source": source.name,
            "size": list(source.size),
            "rate": source.rate,
            "frames": count,
            "first_frame": record.numbers[0] if count else None,
            "last_frame": record.numbers[-1] if count else None,
            "missing_frames": len(record.missing),
            "missing": record.missing,
            "truncated": source.truncated,
            "ended_early": self._ended_early,
            "tracks": len(record.tracks),
            "seconds": seconds,
            "frames_per_second": count / seconds,
            "frames_per_second_of_engine": count / sum(record.seconds) if count else None,
            "threads": thread_count(),
            "seed": self._job.seed,
            "parameters": self._settings,
            "versions": versions(),
            "metrics": metrics,
        }

    def _checkpoint(self, *writers: TrackWriter | MaskWriter | OverlayWriter) -> None:
        for writer in writers:
            writer.checkpoint()
        self._save()
        _log.info("state saved after frame %d", self._state.number)

    def _save(self, finished: dict[str, Any] | None = None) -> None:
        about = {
            "settings": self._settings,
            "source": self._fingerprint,
            "record": self._record.saved(),
            "scores": None if self._scoring is None else self._scoring.saved(),
            "seconds": self._seconds(),
            "finished": finished,
        }
        path = self._job.out / "state.npz"
        with naming(path):
            self._engine.save(path, self._state, about)

    def _load(self) -> dict[str, Any] | None:
        """Take over the state of the run to be resumed; return what was saved with it."""
        path = self._job.out / "state.npz"
        if not path.exists():
            if any(any(self._job.out.glob(pattern)) for pattern in RESULT_PATTERNS):
                raise ValueError(f"--resume: {path} is not there, so start anew with --overwrite")
            return None  # nothing is there: this is the beginning
        try:
            self._state, about = self._engine.load(path)
        except ValueError:
            about = _about_other_chains(path)
        if about.keys() != {"settings", "source", "record", "scores", "seconds", "finished"}:
            raise ValueError(f"--resume: {path} is no state of this application")
        _refuse_other("parameters", about["settings"], self._settings)
        self._record = RunRecord.restored(about["record"])
        self._earlier_seconds = about["seconds"]
        return about

    def _seconds(self) -> float:
        return self._earlier_seconds + time.perf_counter() - self._started


def _about_other_chains(path: Path) -> dict[str, Any]:
    """What was saved about a run whose engine has other chains.

    Raises
    ------
    ValueError
        if it is no state of any engine.
    """
    problem: ValueError | None = None
    for engine in ENGINES:
        try:
            return RecursiveBP(build_model(engine)).load(path)[1]
        except ValueError as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _refuse_other(what: str, saved: Mapping[str, Any], now: Mapping[str, Any], above: str = "") -> None:
    """Refuse to resume where a value was another one."""
    for name in [*saved, *(name for name in now if name not in saved)]:
        before, after = saved.get(name), now.get(name)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            _refuse_other(what, before, after, f"{above}{name}.")
        elif before != after:
            raise ValueError(
                f"--resume: other {what} than in the saved run: {above}{name} was {before!r}, now {after!r}"
            )


def _identity(fingerprint: Mapping[str, Any]) -> dict[str, Any]:
    """What tells sources apart; one that was moved or renamed is the same."""
    unneeded = {"name"} if "sha256" in fingerprint else set()
    return {key: value for key, value in fingerprint.items() if key not in unneeded}


def read_truth(job: Job, source: Source, region: NDArray[np.uint8] | None) -> Scoring | None:
    """Read the job's ground truth, if any, and make sure that it belongs to this source.

    Raises
    ------
    ValueError
        if it has no frame in common with the source, or masks of another size.
    """
    if job.ground_truth is None:
        return None
    truth = read_ground_truth(job.ground_truth)
    numbers = list(truth.frames)
    if source.n_frames is not None:
        last = job.start + (source.n_frames - 1) * job.step
        numbers = common_frames(truth, range(job.start, last + 1, job.step))
    if isinstance(truth, MaskTruth):
        height, width = truth.labels(numbers[0]).shape
        if (width, height) != source.size:
            raise ValueError(
                f"--ground-truth: {truth.files[numbers[0]]} has {width}x{height} px, "
                f"expected {source.size[0]}x{source.size[1]} like {source.name}"
            )
    return Scoring(truth, region)

"""The background application: from a source of frames to masks, tracks, pictures and a report."""

import importlib.metadata
import platform
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..inference import Belief, MultiChain, RecursiveBP
from ..inference.recursive_bp import BEGINNING
from ..models import Frame, ObjectBoxes, PixelLabels
from ..models.threads import set_threads, thread_count
from .ground_truth import MaskTruth, common_frames, read_ground_truth
from .parameters import SECTIONS, Parameters, read_parameters, with_defaults
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
    prepare_output,
    read_tracks,
    write_image,
    write_json,
)
from .scoring import Scoring, track_rows
from .sources import Source, open_source

Engine = Literal["recursive-bp", "feed-forward", "stand-alone"]
ENGINES: tuple[Engine, ...] = ("recursive-bp", "feed-forward", "stand-alone")

EVIDENCE_EVERY = 10
"""Frames between two values of log p(I) in the report: it costs a pass over the pixels that nothing else needs."""


def build_model(engine: Engine = "recursive-bp", parameters: Parameters | None = None) -> MultiChain:
    """Connect the background application's chains.

    Parameters
    ----------
    engine
        `"recursive-bp"`: background, blobs and ground plane correct each other. `"feed-forward"`: the same
        chains, but the background hears nothing of the blobs. `"stand-alone"`: the background by itself.
    parameters
        those of the chains that differ from their defaults, by section and name.

    Raises
    ------
    ValueError
        if there is no such engine, or a parameter is out of range.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine: got {engine!r}, expected one of {', '.join(ENGINES)}")
    chains = {name: chain(**(parameters or {}).get(name, {})) for name, chain in SECTIONS.items()}
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
    threads: int | None = None

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


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    summary
        the content of `summary.json`.
    signal
        number of the signal that ended it early; `None` if it came to the end.
    """

    summary: dict[str, Any]
    signal: int | None


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
    if job.threads is not None:
        set_threads(job.threads)
        cv2.setNumThreads(job.threads)
    parameters = read_parameters(job.config) if job.config else {}
    run = _Run(job, job.settings(parameters), RecursiveBP(build_model(job.engine, parameters)))
    with Interruption() as interruption:
        return run.carry_out(interruption)


class _Run:
    """One run: what it knows, and in which order it is saved."""

    def __init__(self, job: Job, settings: dict[str, Any], engine: RecursiveBP) -> None:
        self._job = job
        self._settings = settings
        self._engine = engine
        self._state = BEGINNING
        self._record = RunRecord()
        self._seconds = 0.0  # of wall time, in earlier runs
        self._scoring: Scoring | None = None

    def carry_out(self, interruption: "Interruption") -> Outcome:
        job = self._job
        saved = self._saved_run() if job.resume else None
        with open_source(job.source, job.start, job.stop, job.step, after=self._state.number) as source:
            self._fingerprint = source.fingerprint()
            if saved is not None:
                self._check_same(saved, source)
            region = read_region(job.roi, source.size) if job.roi else None
            if job.ground_truth is not None:
                self._scoring = _scoring(job.ground_truth, source, job, region)
                if saved is not None:
                    self._scoring.restore(saved["scores"])
            if saved is not None and saved["finished"]:
                return Outcome(saved["finished"], None)
            prepare_output(job.out, overwrite=job.overwrite, resume=job.resume)
            background = self._process(source, region, interruption)
            summary = self._finish(source, background, interruption)
            return Outcome(summary, interruption.signal)

    def _process(
        self, source: Source, region: NDArray[np.uint8] | None, interruption: "Interruption"
    ) -> NDArray[np.uint8]:
        """Take in all frames; return the picture of the background at the end."""
        job, number = self._job, self._state.number
        rate = source.rate / job.step
        with (
            Progress("background", source.n_frames, len(self._record.numbers)) as progress,
            TrackWriter(job.out / "tracks.txt", number) as tracks,
            MaskWriter(job.out, job.masks, rate, number) as masks,
            OverlayWriter(job.out / "overlay.mp4", rate, number) as overlay,
        ):
            self._started = time.perf_counter()
            self._save()
            since = 0
            for frame in interruption.frames(source):
                before = time.perf_counter()
                belief = self._engine.step(self._state, frame)
                found = found_in(belief, source.size, region)
                spent = time.perf_counter() - before
                tracks.write(frame.number, found.tracks)
                masks.write(found.foreground, frame.number, frame.time)
                overlay.write(frame, found.foreground, found.tracks)
                if self._scoring is not None:
                    self._scoring.add(frame.number, found.foreground)
                self._note(frame, belief, found, spent)
                self._state = belief.state
                since += 1
                if since == job.every:
                    since = 0
                    for writer in (tracks, masks, overlay):
                        writer.checkpoint()
                    self._save()
                progress.update()
            for writer in (tracks, masks, overlay):
                writer.checkpoint()
            self._save()
            if interruption.signal is not None:  # the segments of videos stay, for --resume
                overlay.close(finished=False)
                masks.close(finished=False)
        if not self._state.states:
            return np.zeros((source.size[1], source.size[0]), np.uint8)
        picture: NDArray[np.uint8] = self._state.states["background"].picture()
        return picture

    def _note(self, frame: Frame, belief: Belief, found: Found, spent: float) -> None:
        image = frame.image
        due = image is not None and len(self._record.numbers) % EVIDENCE_EVERY == 0

        def overlay() -> NDArray[np.uint8]:
            assert image is not None
            return draw_overlay(image, found.foreground, found.tracks, {}, f"frame {frame.number}")

        self._record.add(
            frame,
            found.tracks,
            found.foreground,
            lambda: belief["background"].picture(),
            overlay,
            belief.log_evidence if due else np.nan,
            spent,
        )

    def _finish(
        self, source: Source, background: NDArray[np.uint8], interruption: "Interruption"
    ) -> dict[str, Any]:
        job = self._job
        metrics = None
        if self._scoring is not None:
            rows = None if job.engine == "stand-alone" else track_rows(read_tracks(job.out / "tracks.txt"))
            metrics = self._scoring.measures(rows)
        summary = self._summary(source, metrics, interrupted=interruption.signal is not None)
        write_image(job.out / "background.png", background)
        write_json(job.out / "summary.json", summary)
        if self._record.numbers:
            title = f"{Path(source.name).name}: {job.engine}"
            write_report(job.out / "report.html", self._record, background, self._settings, metrics, title)
        if interruption.signal is None and not source.live:
            self._save(finished=summary)
        return summary

    def _summary(self, source: Source, metrics: Mapping[str, Any] | None, interrupted: bool) -> dict[str, Any]:
        record = self._record
        seconds = self._wall_seconds()
        return {
            "source": source.name,
            "size": list(source.size),
            "rate": source.rate,
            "frames": len(record.numbers),
            "first_frame": record.numbers[0] if record.numbers else None,
            "last_frame": record.numbers[-1] if record.numbers else None,
            "missing_frames": len(record.missing),
            "missing": record.missing,
            "truncated": source.truncated,
            "interrupted": interrupted,
            "tracks": len(record.tracks),
            "seconds": seconds,
            "frames_per_second": len(record.numbers) / seconds if seconds > 0 else None,
            "engine_frames_per_second": len(record.numbers) / max(sum(record.seconds), 1e-9),
            "threads": thread_count(),
            "seed": self._job.seed,
            "parameters": self._settings,
            "versions": _versions(),
            "metrics": metrics,
        }

    def _save(self, finished: dict[str, Any] | None = None) -> None:
        about = {
            "settings": self._settings,
            "source": self._fingerprint,
            "record": self._record.saved(),
            "seconds": self._wall_seconds(),
            "scores": None if self._scoring is None else self._scoring.saved(),
            "finished": finished,
        }
        self._engine.save(self._job.out / "state.npz", self._state, about)

    def _wall_seconds(self) -> float:
        return self._seconds + time.perf_counter() - self._started

    def _saved_run(self) -> dict[str, Any] | None:
        """Take over the state of the run to be resumed; return what was saved about it."""
        path = self._job.out / "state.npz"
        if not path.exists():
            if any(any(self._job.out.glob(pattern)) for pattern in RESULT_PATTERNS):
                raise ValueError(f"--resume: {path} is not there, so the run cannot go on: use --overwrite")
            return None  # nothing there at all: this is the beginning
        with open(path, "rb") as stream:  # before it is asked whether it belongs to the same chains
            about = _about(path)
        _refuse_difference("parameters", about["settings"], self._settings)
        self._state, about = self._engine.load(path)
        self._record = RunRecord.restored(about["record"])
        self._seconds = about["seconds"]
        return about

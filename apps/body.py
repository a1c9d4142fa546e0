"""The body application: from a film of a person to the pose of the upper body in every frame."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chains.articulated_pose import ArticulatedPose
from ..chains.flesh_tracker import FleshTracker
from ..inference import MultiChain, RecursiveBP
from ..inference.recursive_bp import BEGINNING
from ..models.body_parts import CALIBRATION_FRAMES
from ..models.frame import Frame
from ..models.threads import thread_count
from .blank_frames import SeenFrames
from .body_files import ClickedJoints, read_joints
from .body_report import BodyRecord, write_body_report
from .body_results import BodyResults, lengths
from .body_start import BodyStart, read_head, start_from_faces, start_from_head
from .interruption import Interruption, Outcome
from .progress import Progress
from .results import check_output, write_json, write_together
from .sources import Source, open_source
from .versions import versions

_log = logging.getLogger(__name__)

Image = NDArray[np.uint8]

SPREAD_OVER = 1000
"""Frames of a video over which those are spread in which faces are looked for: all of these are decoded."""

FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class BodyJob:
    """What to do; `rsmcm body --help` explains each field."""

    source: str
    out: Path
    detector: Path | None = None
    head: str | None = None
    joints: Path | None = None
    samples: int = 1000
    seed: int = 0
    start: int = 1
    stop: int | None = None
    step: int = 1
    overwrite: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source."""
        files = {name: getattr(self, name) for name in ("detector", "joints")}
        return {
            **{name: None if path is None else str(path) for name, path in files.items()},
            "head": self.head,
            "samples": self.samples,
            "seed": self.seed,
            "start": self.start,
            "stop": self.stop,
            "step": self.step,
        }


def run_body(job: BodyJob) -> Outcome:
    """Run the body application; all results are in `job.out` afterwards.

    SIGINT (Ctrl-C) and SIGTERM end the run after the current frame, with complete results of the frames so
    far. Nothing is in the folder before the end. Frames that are missing, unreadable or blank (black,
    saturated) are predicted.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with the job, its files, its source or its output. A source that breaks
        in the middle leaves the results of the frames before.
    KeyboardInterrupt
        if a signal came before there was any result.
    """
    check_output(job.out, overwrite=job.overwrite)
    if job.samples < FEWEST_SAMPLES:
        raise ValueError(f"--samples: got {job.samples}, expected {FEWEST_SAMPLES} or more")
    if job.head is not None:
        if job.detector is not None:
            raise ValueError("--head: got --detector as well, expected one of them")
        read_head(job.head)
    clicked = None if job.joints is None else read_joints(job.joints)
    with (
        Interruption() as interruption,
        open_source(job.source, job.start, job.stop, job.step) as source,
    ):
        run = _Run(job, source, interruption)
        start, frames = run.begin(clicked)
        with write_together(job.out, overwrite=job.overwrite) as folder:
            summary = run.carry_out(start, frames, folder)
    if run.error is not None:
        raise run.error
    return Outcome(summary, interruption.signal)


class _Run:
    """One run: who is tracked, the frames, and what is said of it in the end."""

    def __init__(self, job: BodyJob, source: Source, interruption: Interruption) -> None:
        self._job = job
        self._source = source
        self._interruption = interruption
        self._frames = SeenFrames(interruption.items(source))
        self._before: list[int] = []  # frames before the one in which the track starts
        self._started = time.perf_counter()

    @property
    def error(self) -> Exception | None:
        """By which the source broke in the middle, if it did."""
        return self._frames.error

    def carry_out(self, start: BodyStart, frames: Iterator[Frame], folder: Path) -> dict[str, Any]:
        """Take in all frames and write all results; return the content of `summary.json`."""
        job = self._job
        pose = ArticulatedPose(start.body, job.samples, seed=job.seed)
        flesh = FleshTracker(start.body)
        engine = RecursiveBP(MultiChain().connect(flesh, start.parts).connect(pose, start.parts))
        rate = self._source.rate / job.step
        run = BEGINNING
        with (
            Progress("body", self._source.n_frames) as progress,
            BodyResults(folder, rate, start.body, job.seed) as results,
        ):
            for frame in frames:
                before = time.perf_counter()
                run = engine.step(run, frame).state
                detected = run.states[flesh.name].unseen == 0
                results.add(frame, run.states[pose.name], detected, time.perf_counter() - before)
                progress.update()
            results.finish()
        summary = self._summary(start, results.record)
        title = f"{Path(self._source.name).name}: upper body"
        write_body_report(folder / "report.html", results.record, summary, title)
        write_json(folder / "summary.json", summary)
        return summary

    def begin(self, clicked: ClickedJoints | None) -> tuple[BodyStart, Iterator[Frame]]:
        """Who is tracked, and the frames from the first one in which anything is to be seen."""
        frames = iter(self._frames)
        job, images = self._job, None
        if self._source.kind in ("camera", "stream"):  # cannot be read twice
            beginning = list(islice(frames, CALIBRATION_FRAMES))
            frames = chain(beginning, frames)
            images = [frame.image for frame in beginning if frame.image is not None]
        for first in frames:
            if first.image is not None:
                break
            self._before.append(first.number)
        else:
            if self.error is not None:
                raise self.error
            if self._interruption.signal is not None:
                raise KeyboardInterrupt
            raise ValueError(f"{self._source.name}: holds no frame in which anything is to be seen")
        if images is None:
            images = self._looked_at()
        images = images or [first.image]  # where nothing else is to be seen in what was looked at
        if job.head is not None:
            start = start_from_head(first, read_head(job.head), images, clicked)
        else:
            start = start_from_faces(self._source.name, images, job.detector, clicked)
        found = (
            "the head as marked"
            if job.head is not None
            else str(job.detector or "OpenCV's cascades of faces")
        )
        _log.info("start in frame %d, by %s: %s", first.number, found, start.origin)
        return start, chain([first], frames)

    def _looked_at(self) -> list[Image]:
        """Images from all over the source, which is read a second time for it."""
        job, total = self._job, self._source.n_frames
        if total is not None and self._source.kind == "video":
            total = min(total, SPREAD_OVER)
        stride = 1 if total is None else -(-total // CALIBRATION_FRAMES)
        with open_source(job.source, job.start, job.stop, job.step * stride) as source:
            frames = islice(SeenFrames(self._interruption.items(source)), CALIBRATION_FRAMES)
            images = [frame.image for frame in frames if frame.image is not None]
        if self._interruption.signal is not None:
            raise KeyboardInterrupt
        return images

    def _summary(self, start: BodyStart, record: BodyRecord) -> dict[str, Any]:
        source = self._source
        count = len(record.numbers)
        seconds = time.perf_counter() - self._started
        return {
            "source": source.name,
            "size": list(source.size),
            "rate": source.rate,
            "frames": count,
            "first_frame": record.numbers[0],
            "last_frame": record.numbers[-1],
            "before_the_start": self._before,
            "missing_frames": len(record.missing),
            "missing": record.missing,
            "blank": self._frames.blank,
            "truncated": source.truncated,
            "ended_early": self._interruption.signal is not None or self.error is not None,
            "seen": record.shares_seen,
            "stationary": record.stationary_periods,
            "flesh_colour": start.parts.flesh is not None,
            "body": {"origin": start.origin, "lengths": lengths(start.body)},
            "seconds": seconds,
            "frames_per_second": count / seconds,
            "frames_per_second_of_tracker": count / sum(record.seconds),
            "threads": thread_count(),
            "notes": [*start.notes, *record.notes],
            "parameters": self._job.settings,
            "versions": versions(),
        }

"""The face application: from a film of a face to its pose, deformation and texture in every frame."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Never

import numpy as np
from numpy.typing import NDArray

from ..chains.gflow import GFlow
from ..inference import MultiChain, RecursiveBP
from ..inference.recursive_bp import BEGINNING
from ..models.built_in_face import face_model
from ..models.frame import Frame
from ..models.morphable_files import read_correspondences, read_model
from ..models.morphable_model import MorphableModel
from ..models.pixel_labels import PixelLabels
from ..models.threads import thread_count
from .blank_frames import SeenFrames
from .face_files import GivenLandmarks, read_landmarks
from .face_report import FaceRecord, write_face_report
from .face_results import FaceResults, write_textures
from .face_start import FaceStart, find_face, start_from_box, start_from_landmarks
from .interruption import Interruption, Outcome
from .progress import Progress
from .results import check_output, write_json, write_together
from .sources import Source, open_source
from .versions import versions

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class FaceJob:
    """What to do; `rsmcm face --help` explains each field."""

    source: str
    out: Path
    model: Path | None = None
    landmarks: Path | None = None
    correspondences: Path | None = None
    detector: Path | None = None
    experts: int = 20
    gain: float | Literal["learned"] = 0.1
    seed: int = 0
    start: int = 1
    stop: int | None = None
    step: int = 1
    overwrite: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source."""
        files = {name: getattr(self, name) for name in ("model", "landmarks", "correspondences", "detector")}
        return {
            **{name: None if path is None else str(path) for name, path in files.items()},
            "experts": self.experts,
            "gain": self.gain,
            "seed": self.seed,
            "start": self.start,
            "stop": self.stop,
            "step": self.step,
        }


def run_face(job: FaceJob) -> Outcome:
    """Run the face application; all results are in `job.out` afterwards.

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
    if job.experts < 1:
        raise ValueError(f"--experts: got {job.experts}, expected 1 or more")
    if job.gain != "learned" and not 0 <= job.gain <= 1:
        raise ValueError(f"--gain: got {job.gain}, expected 0 to 1, or learned")
    model = face_model() if job.model is None else read_model(job.model)
    if not len(model.triangles):
        raise ValueError(f"{job.model}: got a model without triangles, expected a surface with a texture")
    given = _given_landmarks(job)
    with (
        Interruption() as interruption,
        open_source(job.source, job.start, job.stop, job.step) as source,
        write_together(job.out, overwrite=job.overwrite) as folder,
    ):
        frames = SeenFrames(interruption.items(source))
        summary = _Run(job, model, given, source, frames, folder).carry_out(interruption)
    if frames.error is not None:
        raise frames.error
    return Outcome(summary, interruption.signal)


def _given_landmarks(job: FaceJob) -> GivenLandmarks | None:
    """Read the job's landmarks, if any.

    The first row belongs to the first frame that is processed, the second to the second. Only where there are
    as many rows as the whole source has frames, they count from its beginning.
    """
    if job.landmarks is None:
        if job.correspondences is not None:
            raise ValueError("--correspondences: got them without landmarks, expected --landmarks as well")
        return None
    rows = read_landmarks(job.landmarks)
    pairs = None if job.correspondences is None else read_correspondences(job.correspondences)
    if len(rows) > 1 and (job.start, job.step) != (1, 1):
        with open_source(job.source) as whole:
            if whole.n_frames == len(rows):
                return GivenLandmarks(rows, pairs)
    return GivenLandmarks(rows, pairs, job.start, job.step)


class _Run:
    """One run: its frames, where the face is in the first one, and what is said of it in the end."""

    def __init__(
        self,
        job: FaceJob,
        model: MorphableModel,
        given: GivenLandmarks | None,
        source: Source,
        frames: SeenFrames,
        folder: Path,
    ) -> None:
        self._job = job
        self._model = model
        self._given = given
        self._source = source
        self._frames = frames
        self._folder = folder
        self._notes: list[str] = []
        self._before: list[int] = []  # frames before the one in which the track starts

    def carry_out(self, interruption: Interruption) -> dict[str, Any]:
        """Take in all frames and write all results; return the content of `summary.json`."""
        started = time.perf_counter()
        frames = iter(self._frames)
        for first in frames:
            start = self._start(first)
            if start is not None:
                break
            self._before.append(first.number)
        else:
            self._complain(interruption)
        job = self._job
        found = "landmarks" if self._given is not None else str(job.detector or "OpenCV's cascade of faces")
        _log.info("start in frame %d, by %s", first.number, found)
        chain = GFlow(start.model, start.pose, experts=job.experts, gain=job.gain, seed=job.seed)
        engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
        rate = self._source.rate / job.step
        run = BEGINNING
        with (
            Progress("face", self._source.n_frames) as progress,
            FaceResults(self._folder, rate, chain, start, self._given) as results,
        ):
            for frame in _and_then(first, frames):
                before = time.perf_counter()
                run = engine.step(run, frame).state
                results.add(frame, run.states[chain.name], time.perf_counter() - before)
                progress.update()
            results.finish()
        white, textures = write_textures(self._folder, chain, run.states[chain.name])
        summary = self._summary(start, results.record, white, interruption, started)
        title = f"{Path(self._source.name).name}: face"
        names = start.model.names
        write_face_report(self._folder / "report.html", results.record, summary, names, textures, title)
        write_json(self._folder / "summary.json", summary)
        return summary

    def _start(self, frame: Frame) -> FaceStart | None:
        """Where the face is in a frame; `None` if it is not found, or nothing is to be seen."""
        if frame.image is None:
            return None
        if self._given is None:
            box = find_face(frame.image, self._job.detector)
            return None if box is None else start_from_box(self._model, box)
        landmarks = self._given.of_frame(frame.number)
        if landmarks is None:
            landmarks = self._given.rows[-1]
            self._notes.append(
                f"There are no landmarks of frame {frame.number}; those of a frame before are taken for it."
            )
        try:
            _check_inside(landmarks, frame.image)
            return start_from_landmarks(self._model, landmarks, self._given.pairs)
        except ValueError as error:
            raise ValueError(f"{self._job.landmarks}: {error}") from None

    def _complain(self, interruption: Interruption) -> Never:
        """Say why there is no frame to start with."""
        if self._frames.error is not None:
            raise self._frames.error
        if interruption.signal is not None:
            raise KeyboardInterrupt
        if self._given is not None or len(self._before) == len(self._frames.blank):
            raise ValueError(f"{self._source.name}: holds no frame in which anything is to be seen")
        raise ValueError(f"{self._source.name}: no face is found in it, expected one, or --landmarks")

    def _summary(
        self, start: FaceStart, record: FaceRecord, white: float, interruption: Interruption, started: float
    ) -> dict[str, Any]:
        source = self._source
        count = len(record.numbers)
        seconds = time.perf_counter() - started
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
            "ended_early": interruption.signal is not None or self._frames.error is not None,
            "start": "face detector" if start.fit_error is None else "landmarks",
            "start_fit_error_px": start.fit_error,
            "landmarks": len(start.present),
            "vertices": start.model.n_vertices,
            "bases": start.model.n_bases,
            "lost_frames": len(record.lost),
            "lost": record.lost_periods,
            "reinitialised": record.restarted,
            "log_evidence": record.evidence_measures,
            "error": None if self._given is None else record.error_measures(self._given.size),
            "texture_variance_of_white": white,
            "seconds": seconds,
            "frames_per_second": count / seconds,
            "frames_per_second_of_tracker": count / sum(record.seconds),
            "threads": thread_count(),
            "notes": [*self._notes, *record.notes],
            "parameters": self._job.settings,
            "versions": versions(),
        }


def _and_then(first: Frame, frames: Iterator[Frame]) -> Iterator[Frame]:
    yield first
    yield from frames


def _check_inside(landmarks: Array, image: Image) -> None:
    """Refuse landmarks of a picture of another size, most of which lie outside of this one."""
    height, width = image.shape[:2]
    present = landmarks[~np.isnan(landmarks[:, 0])]
    if not len(present):
        raise ValueError("landmarks: got NaN for all in the first frame, expected some of them")
    outside = ((present < -0.5) | (present > (width - 0.5, height - 0.5))).any(axis=1)
    if 2 * np.count_nonzero(outside) > len(present):
        raise ValueError(
            f"landmarks: got {np.count_nonzero(outside)} of {len(present)} outside the picture of "
            f"{width}x{height} px, expected them inside"
        )

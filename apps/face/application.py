"""The face application: from a film of a face to its pose, deformation and texture in every frame."""

import logging
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...chains.face.recovery import DetectedFace, Finder
from ...inference import Belief, MultiChain, RecursiveBP
from ...models.core.frame import Frame
from ...models.face.built_in_model import face_model
from ...models.face.detectors import PartDetector, default_faces
from ...models.face.model_files import read_correspondences, read_model
from ...models.face.morphable_model import MorphableModel
from ...models.pixels.pixel_labels import PixelLabels
from ..drawing.overlay import Draw, draw_face
from ..io.point_files import read_points
from ..io.segments import segment_pattern
from ..io.sources.open_source import open_source
from ..runs.film_run import FilmRun, Writer
from ..runs.interruption import Outcome
from ..runs.memory import EXPERT, FACE, FACE_EXPERT
from ..runs.saved_run import SavedRun
from ..view.film import Film, Row
from ..view.page import Page
from .job import FaceJob
from .landmark_files import GivenLandmarks
from .page import FaceDrawing, face_page
from .record import FaceRecord
from .start import FaceStart, find_face, start_from_box, start_from_landmarks
from .texture import vertices_on_texture, write_textures
from .writer import FaceWriter

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


SMALL_EVERY = 25
"""Frames without a face until small ones are looked for again, which takes long."""


def run_face(job: FaceJob) -> Outcome:
    """Run the face application; see `FilmRun.carry_out`.

    Frames that are missing, unreadable or blank (black, saturated) are predicted.
    """
    model = face_model() if job.model is None else read_model(job.model)
    if not len(model.triangles):
        raise ValueError(f"{job.model}: got a model without triangles, expected a surface with a texture")
    return FaceRun(job, model, _given_landmarks(job)).carry_out()


def _given_landmarks(job: FaceJob) -> GivenLandmarks | None:
    """Read the job's landmarks, if any.

    The first row belongs to the first frame that is processed, the second to the second. Only where there are
    as many rows as the whole source has frames, they count from its beginning.
    """
    if job.landmarks is None:
        return None
    rows = read_points(job.landmarks)
    pairs = None if job.correspondences is None else read_correspondences(job.correspondences)
    if len(rows) > 1 and (job.start, job.step) != (1, 1):
        with open_source(job.source) as whole:
            if whole.n_frames == len(rows):
                return GivenLandmarks(rows, pairs)
    return GivenLandmarks(rows, pairs, job.start, job.step)


class FaceRun(FilmRun[FaceJob]):
    """One run: where the face is in the first frame, its poses and texture, and the record for the page."""

    application = "face"
    files = ("poses.npz", segment_pattern("poses.npz"), "texture.png", "texture_variance.png")
    kinds: ClassVar[dict[str, Any]] = {
        "start": FaceStart,
        "record": FaceRecord.kinds(),
    }
    chains: ClassVar[dict[str, Any]] = {"gflow": GFlow}

    def __init__(self, job: FaceJob, model: MorphableModel, given: GivenLandmarks | None) -> None:
        super().__init__(job)
        self._model = model
        self._given = given
        self._textures: dict[str, Image] = {}
        self._restarts = 0  # relocations until the frame before
        self.record = FaceRecord()

    @property
    def bytes_needed(self) -> tuple[float, float]:
        """Depends on the number of experts."""
        return FACE + self.job.experts * FACE_EXPERT, self.job.experts * EXPERT

    def memory(self) -> dict[str, Any]:
        """Who is tracked, and the record."""
        return {"start": self._start, "record": self.record.saved()}

    def begin(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Find the face in the first frame that shows one."""
        for first in frames:
            start = self._found_in(first)
            if start is not None:
                break
            self.before.append(first.number)
        else:
            if self._given is not None or len(self.before) == len(self.blank):
                raise self.no_frame("holds no frame in which anything is to be seen")
            raise self.no_frame("no face is found in it, expected one, or --landmarks")
        found = "landmarks" if self._given else str(self.job.detector or "OpenCV's cascade of faces")
        _log.info("start in frame %d, by %s", first.number, found)
        if start.misfit is not None:
            self.notes.append(start.misfit)
        self._begin_with(start)
        return chain([first], frames)

    def go_on(self, memory: Mapping[str, Any]) -> None:
        """Take up the face, and the record."""
        self.record = FaceRecord.restored(memory["record"])
        self._begin_with(memory["start"])

    def learn_from(self, saved: SavedRun) -> None:
        """Take the face and its texture."""
        experts = len(saved.state.states["gflow"].poses)
        if experts != self.job.experts:
            raise ValueError(f"--experts: got {self.job.experts}, expected {experts} like {self.job.learned}")
        self._begin_with(saved.memory["start"])

    def _begin_with(self, start: FaceStart) -> None:
        job = self.job
        self._start = start
        self._drawing = FaceDrawing(start.model)
        self._chain = GFlow(
            start.model,
            start.pose,
            experts=job.experts,
            gain=job.gain,
            finder=self._finder(start),
            seed=job.seed,
        )
        self.engine = RecursiveBP(MultiChain().connect(self._chain, PixelLabels()))
        if self.state.states:
            self._restarts = self.state.states["gflow"].relocations

    def writers(self, rate: float, after: int) -> list[Writer]:
        """Poses."""
        self._writer = FaceWriter(self.job.out, after, self._chain, self._start, self._given, self.record)
        return [self._writer]

    def take_in(self, belief: Belief, found: Any, seconds: float) -> None:
        """Write the frame's poses."""
        state = belief[self._chain]
        self._row = self._writer.add(
            belief.frame, state, seconds, restarted=state.relocations > self._restarts
        )
        self._restarts = state.relocations

    def drawn(self, belief: Belief, found: Any) -> Callable[[], Row]:
        """Pose and points."""
        return partial(self._drawing.drawn, self._row, self.record.errors[-1])

    def drawing(self) -> Draw:
        """Points of the face, and landmarks."""
        return draw_face

    def told(self, belief: Belief, found: Any) -> dict[str, object]:
        """Whether the face is lost."""
        return {"face": "lost" if belief[self._chain].lost else "tracked"}

    @property
    def title(self) -> str:
        """The source, and what of it is followed."""
        return f"{Path(self.source.name).name}: face"

    def page(self, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """The face over the film and in space, and what is to be said of it."""
        state = self.state.states["gflow"]
        morphs = self._chain.mean_pose(state).morphs[0]
        places = vertices_on_texture(self._start.model, morphs, self._chain.object.texels)
        layer = {} if film is None else self._drawing.layer(film, self._textures, places)
        names = self._start.model.names
        return face_page(self.title, self.record, summary, film, layer, names)

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """How much was lost, and the error."""
        words = [
            f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second, "
            f"{summary['lost_frames']} lost, {len(summary['reinitialised'])} re-initialisations"
        ]
        if error := summary["error"]:
            words.append(
                f"error in {error['frames']} frames: mean {error['mean_px']:.3g} px, "
                f"worst {error['worst_px']:.3g} px in frame {error['worst_frame']}"
            )
        return words

    def _finder(self, start: FaceStart) -> Finder | None:
        """Who is asked where the face is when it is lost; nobody where OpenCV brings no detector along."""
        try:
            return DetectedFace(start.model, self._faces)
        except ValueError:
            if self.job.detector is not None:
                raise
            return None

    @cached_property
    def _faces(self) -> PartDetector:
        return default_faces(
            self.job.detector, "--landmarks of the first frame, or a model file of YuNet as --detector"
        )

    def _found_in(self, frame: Frame) -> FaceStart | None:
        """Where the face is in a frame; `None` if it is not found, or nothing is to be seen."""
        if frame.image is None:
            return None
        if self._given is None:
            box = find_face(frame, self._faces, small=len(self.before) % SMALL_EVERY == 0)
            return None if box is None else start_from_box(self._model, box)
        landmarks = self._given.of_frame(frame.number)
        if landmarks is None:
            landmarks = self._given.rows[-1]
            self.notes.append(
                f"There are no landmarks of frame {frame.number}; those of a frame before are taken for it."
            )
        try:
            _check_inside(landmarks, frame.image)
            return start_from_landmarks(self._model, landmarks, self._given.pairs)
        except ValueError as error:
            raise ValueError(f"{self.job.landmarks}: {error}") from None

    def facts(self) -> dict[str, Any]:
        """How the track began, where it was lost, and errors against landmarks."""
        start, record = self._start, self.record
        if self.job.learned is not None:
            origin = "another run"
        else:
            origin = "face detector" if start.fit_error is None else "landmarks"
        white, self._textures = write_textures(self.job.out, self._chain, self.state.states["gflow"])
        return {
            "start": origin,
            "start_fit_error_px": start.fit_error,
            "start_fit": None if np.isnan(record.start_fit) else record.start_fit,
            "landmarks": len(start.present),
            "vertices": start.model.n_vertices,
            "bases": start.model.n_bases,
            "lost_frames": len(record.lost),
            "lost": record.lost_periods,
            "reinitialised": record.restarted,
            "log_evidence": record.evidence_measures,
            "error": None if self._given is None else record.error_measures(self._given.size),
            "texture_variance_of_white": white,
            "notes": record.notes,
        }


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

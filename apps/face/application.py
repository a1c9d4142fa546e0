"""The face application: from a film of a face to its pose, deformation and texture in every frame."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...chains.face.recovery import DetectedFace, Finder
from ...chains.face.start import (
    CONFIRMING,
    FaceStart,
    find_face,
    on_trial,
    start_from_box,
    start_from_landmarks,
)
from ...inference import Belief, MultiChain
from ...models.core.frame import Frame
from ...models.face.built_in_model import face_model
from ...models.face.detectors import PartDetector, default_faces
from ...models.face.model_files import read_correspondences, read_model
from ...models.face.morphable_model import MorphableModel
from ...models.pixels.pixel_labels import PixelLabels
from ..io.point_files import read_points
from ..io.row_log import RowLog
from ..io.sources.open_source import Source, open_source
from ..runs.interruption import Outcome
from ..runs.loop import Application, Columns, Engine, Start, run_film
from ..runs.memory import EXPERT, FACE
from ..view.film import Film
from ..view.overlay import Draw, draw_face
from ..view.page import Page
from .job import FaceJob
from .page import FaceDrawing, FaceRecord, face_page
from .texture import vertices_on_texture, write_textures

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GivenLandmarks:
    """Landmarks from a file, of one frame or of many.

    Parameters
    ----------
    rows
        `(n_rows, n_landmarks, 2)` px, NaN where missing.
    pairs
        `(n_pairs, 2)`: index of a landmark, from 0, and its number in the model's list, from 1; `None` where
        the landmarks are in the model's own order.
    start, step
        which frames of the source the rows belong to: `start`, `start + step`, ...
    """

    rows: Numbers
    pairs: NDArray[np.int64] | None = None
    start: int = 1
    step: int = 1

    def of_frame(self, number: int) -> Numbers | None:
        """Return the landmarks `(n_landmarks, 2)` px of the frame with this number; `None` without any."""
        row = (number - self.start) // self.step
        return self.rows[row] if 0 <= row < len(self.rows) else None

    def error(self, number: int, landmarks: Numbers) -> float:
        """Return the mean distance of a frame's landmarks `(n_landmarks, 2)` from the given ones, px.

        NaN where none is given for this frame, or only those of one frame are: they are where the track
        starts and say nothing about it.
        """
        given = self.of_frame(number)
        if given is None or len(self.rows) == 1:
            return np.nan
        distances = np.linalg.norm(landmarks - given, axis=1)
        known = np.isfinite(distances)
        return float(distances[known].mean()) if known.any() else np.nan

    @property
    def size(self) -> float:
        """Root of the area of the box around the first landmarks, px."""
        return float(np.sqrt(np.prod(np.nanmax(self.rows[0], axis=0) - np.nanmin(self.rows[0], axis=0))))


_log = logging.getLogger(__name__)

Image = NDArray[np.uint8]


POSES = {
    "frame_numbers": "number", "times": "time", **{name: name for name in (
        "weights", "rotations", "translations", "morphs", "mean_rotation", "mean_translation", "mean_morphs",
        "vertices_2d", "vertices_3d", "covariance", "landmarks", "log_evidence", "fit", "lost",
        "tracked_probability", "reinitialised", "missing",
    )}
}  # fmt: skip
"""Arrays of `poses.npz` with a row a frame, and the columns of the log that they are: `frame_numbers`,
`times` s; of the experts `weights (n_experts,)`, `rotations (n_experts, 3, 3)`, `translations (n_experts, 2)`
px, `morphs (n_experts, n_bases)` px; of their mean `mean_rotation`, `mean_translation`, `mean_morphs`;
`vertices_2d (n_vertices, 2)` px, `vertices_3d (n_vertices, 3)` px with depth, and `covariance (n_vertices, 3,
3)` px squared, how the experts differ; `landmarks (n_landmarks, 2)` px, NaN for those that were missing at
the start; `log_evidence` nats and `fit`, the share of the picture under the face that the texture explains,
NaN where there is none; `lost`, `reinitialised`, `missing`; `tracked_probability`, that the face is where it
is stated to be, 0 while it is lost. `bases (n_bases, n_vertices, 3)` and `triangles
(n_triangles, 3)` of the person's model come once."""

SMALL_EVERY = 25
"""Frames without a face until small ones are looked for again, which takes long."""


def run_face(job: FaceJob) -> Outcome:
    """Run the face application; see `run_film`.

    Frames that are missing, unreadable or blank (black, saturated) are predicted.
    """
    model = face_model() if job.model is None else read_model(job.model)
    if not len(model.triangles):
        raise ValueError(f"{job.model}: got a model without triangles, expected a surface with a texture")
    return run_film(Face(job, model, _given_landmarks(job)))


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


class Face(Application[FaceJob]):
    """Application that tracks a face with `GFlow`."""

    name = "face"
    files = ("poses.npz", "texture.png", "texture_variance.png")
    schema: ClassVar[dict[str, Any]] = {"start": FaceStart}

    def __init__(self, job: FaceJob, model: MorphableModel, given: GivenLandmarks | None) -> None:
        super().__init__(job)
        self._model = model
        self._given = given
        self._textures: dict[str, Image] = {}

    def bytes_needed(self, source: Source) -> tuple[float, float]:
        """Return bytes a pixel and beside them, for the number of experts."""
        return FACE, self.job.experts * EXPERT

    def build(self, start: Start) -> Engine:
        """Take the face from another run, or find it in the first frame that shows one; connect the chain."""
        job, memory = self.job, start.memory(self.schema)
        self._start = face = self._find_start(start) if memory is None else memory["start"]
        self._drawing = FaceDrawing(face.model)
        self._chain = GFlow(
            face.model,
            face.pose,
            experts=job.experts,
            gain=job.gain,
            finder=self._finder(face),
            seed=job.seed,
        )
        self._engine = start.filter(MultiChain().connect(self._chain, PixelLabels()))
        before = self._engine.state.states.get("gflow")
        self._restarts = 0 if before is None else before.relocations  # until the frame before
        if before is not None and len(before.poses) != job.experts:
            raise ValueError(f"--experts: got {job.experts}, expected {len(before.poses)} like {job.learned}")
        return self._engine

    def _find_start(self, start: Start) -> FaceStart:
        """Find the face in the first frame that shows one for sure; leave out frames before it."""
        wanted = CONFIRMING if self._given is None else 1
        frames, trial = list[Frame](), list[FaceStart]()
        while len(trial) < wanted and (frame := next(start.frames, None)) is not None:
            frames.append(frame)
            trial = on_trial(trial, self._start_in(frame, start))
            n_before = len(frames) - len(trial)
            start.before += [each.number for each in frames[:n_before]]
            frames = frames[n_before:]
        interrupted = start.interruption.signal is not None
        if not trial or (len(trial) < wanted and (start.before or interrupted)):
            if not trial and (self._given is not None or len(start.before) == len(start.blank)):
                raise start.no_frame("holds only blank frames")
            raise start.no_frame("no face is found in it, expected one, or --landmarks")
        face = trial[0]
        found = "landmarks" if self._given else str(self.job.detector or "OpenCV's cascade of faces")
        _log.info("start in frame %d, by %s", frames[0].number, found)
        if face.misfit is not None:
            start.notes.append(face.misfit)
        start.frames = chain(frames, start.frames)
        return face

    def columns(self, belief: Belief) -> Columns:
        """Return the poses of the experts, their mean, and their covariance."""
        frame, state = belief.frame, belief[self._chain]
        mean = self._chain.mean_pose(state)
        vertices, covariance = self._chain.vertices(state)
        present = self._start.present
        landmarks = np.full((len(present), 2), np.nan)
        if present.any():
            landmarks[present] = self._chain.points(state, self._start.points)
        # the first picture shows the texture, which nothing could predict
        unpredicted = frame.missing or state.frames_seen == 1
        evidence, fit = (np.nan, np.nan) if unpredicted else (state.log_evidence, state.fit)
        error = np.nan if self._given is None else self._given.error(frame.number, landmarks)
        restarted, self._restarts = state.relocations > self._restarts, state.relocations
        row = {
            "weights": state.weights,
            "rotations": state.stated_poses.rotations,
            "translations": state.stated_poses.translations,
            "morphs": state.stated_poses.morphs,
            "mean_rotation": mean.rotations[0],
            "mean_translation": mean.translations[0],
            "mean_morphs": mean.morphs[0],
            "vertices_2d": vertices[:, :2].astype(np.float32),
            "vertices_3d": vertices.astype(np.float32),
            "covariance": covariance.astype(np.float32),
            "landmarks": landmarks,
            "log_evidence": np.float64(evidence),
            "fit": np.float64(fit),
            "lost": np.bool_(state.lost),
            "tracked_probability": np.float64(state.tracked_probability),
            "reinitialised": np.bool_(restarted),
            "missing": np.bool_(frame.missing),
        }
        return Columns(
            {**row, "error": np.float64(error)},
            view_row=partial(self._drawing.view_row, row, error),
            live={"face": "lost" if state.lost else "tracked"},
        )

    def drawing(self) -> Draw:
        """Return what draws the points of the face and the landmarks."""
        return draw_face

    def state_dict(self) -> dict[str, Any]:
        """Return the start, with the person's model."""
        return {"start": self._start}

    def finish(self, log: RowLog) -> dict[str, Any]:
        """Write poses and texture; return start, lost frames, and errors against landmarks."""
        start, record, out = self._start, FaceRecord(log), self.job.out
        constants = {"bases": start.model.bases, "triangles": start.model.triangles}
        log.write_arrays(out / "poses.npz", constants, POSES)
        white, self._textures = write_textures(out, self._chain, self._engine.state.states["gflow"])
        if self.job.learned is not None:
            origin = "another run"
        else:
            origin = "face detector" if start.fit_error is None else "landmarks"
        return {
            "start": origin,
            "start_fit_error_px": start.fit_error,
            "start_fit": None if np.isnan(record.start_fit) else record.start_fit,
            "landmarks": len(start.present),
            "vertices": start.model.n_vertices,
            "bases": start.model.n_bases,
            "lost_frames": len(record.lost),
            "lost": record.lost_periods,
            "tracked_probability": record.tracked_probability,
            "reinitialised": record.restarted,
            "log_evidence": record.evidence_measures,
            "error": None if self._given is None else record.error_measures(self._given.size),
            "texture_variance_of_white": white,
            "notes": record.notes,
        }

    def page(self, log: RowLog, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Return the page: the face over the film and in space."""
        state, model = self._engine.state.states["gflow"], self._start.model
        morphs = self._chain.mean_pose(state).morphs[0]
        places = vertices_on_texture(model, morphs, self._chain.object.texels)
        layer = {} if film is None else self._drawing.layer(film, self._textures, places)
        return face_page(self.title(summary["source"]), FaceRecord(log), summary, film, layer, model.names)

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """Describe how much was lost, and the error."""
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
        """Return the detector that finds a lost face; `None` where OpenCV has none."""
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

    def _start_in(self, frame: Frame, start: Start) -> FaceStart | None:
        """Return the start of a face in a frame; `None` without one."""
        if frame.image is None:
            return None
        if self._given is None:
            box = find_face(frame, self._faces, small=len(start.before) % SMALL_EVERY == 0)
            return None if box is None else start_from_box(self._model, box)
        landmarks = self._given.of_frame(frame.number)
        if landmarks is None:
            landmarks = self._given.rows[-1]
            start.notes.append(f"Frame {frame.number} has no landmarks; those of an earlier frame are used.")
        try:
            _check_inside(landmarks, frame.image)
            return start_from_landmarks(self._model, landmarks, self._given.pairs)
        except ValueError as error:
            raise ValueError(f"{self.job.landmarks}: {error}") from None


def _check_inside(landmarks: Numbers, image: Image) -> None:
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

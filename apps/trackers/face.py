"""Tracker of a face, given one image after the other."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...chains.face.gflow import GFlow
from ...chains.face.recovery import DetectedFace
from ...chains.face.start import (
    CONFIRMING,
    FaceStart,
    find_face,
    on_trial,
    start_from_box,
    start_from_landmarks,
)
from ...inference import MultiChain, RecursiveBP
from ...models.core.checks import Count, Positive, Shape, checked
from ...models.core.frame import Frame
from ...models.face.built_in_model import face_model
from ...models.face.detectors import default_faces
from ...models.face.morphable_model import MorphableModel
from ...models.pixels.pixel_labels import PixelLabels
from ..face.application import SMALL_EVERY
from .tracker import DetectingTracker, Floats, Picture, size_of


@dataclass(frozen=True, eq=False)
class TrackedFace:
    """A face in an image.

    Parameters
    ----------
    vertices
        `(n_vertices, 3)` px: the surface, z away from the camera.
    covariances
        `(n_vertices, 3, 3)` px^2, of the vertices.
    triangles
        `(n_triangles, 3)`: vertices of each triangle.
    rotation, translation
        `(3, 3)`, and `(2,)` px.
    expression
        `(n_bases,)` px: coefficients of the face's shapes; the first is its size.
    landmarks
        `(n, 2)` px: the landmarks given at the start, tracked on the surface.
    lost
        whether the face is lost: all else is then as it was last seen.
    probability
        that the face is where it is stated to be; 0 while it is lost.
    """

    vertices: Floats
    covariances: Floats
    triangles: NDArray[np.int64]
    rotation: Floats
    translation: Floats
    expression: Floats
    landmarks: Floats
    lost: bool
    probability: float


class FaceTracker(DetectingTracker[FaceStart, TrackedFace | None]):
    """Tracker of pose, expression and texture of one face (G-flow), as `rsmcm face`.

    Parameters
    ----------
    model
        of faces; default: a small built-in one.
    experts
        number of experts (pose hypotheses).
    detector, seed, frame_rate
        as of `DetectingTracker`.
    """

    start_type = FaceStart

    @checked
    def __init__(
        self,
        detector: str | Path | None = None,
        model: MorphableModel | None = None,
        experts: Count = 20,
        seed: int = 0,
        frame_rate: Positive = 25.0,
    ) -> None:
        self._experts = experts
        self._model = face_model() if model is None else model
        super().__init__(detector, seed, frame_rate, experts=experts)

    @checked
    def update(
        self,
        image: Picture | None,
        box: Annotated[Any, Shape(4)] | None = None,
        landmarks: Annotated[Any, Shape("n", 2, finite=False)] | None = None,
        time: float | None = None,
    ) -> TrackedFace | None:
        """Return the face in the next image; `None` until a face was found.

        Parameters
        ----------
        image
            uint8, BGR or grey; `None` if it is missing.
        box
            `(4,)` px: left, top, right, bottom of the face. Used until a face is tracked.
        landmarks
            `(n, 2)` px of the face, in the order of the model's landmarks or vertices, NaN where one is
            missing. Used until a face is tracked. Without box and landmarks, the detector finds the face.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range, or there is no face detector.
        """
        frame = self._frame(image, time)
        if not self._started(frame, lambda first: self._find(first, box, landmarks)):
            return None
        state = self._step(frame)[self._gflow]
        pose, start = self._gflow.mean_pose(state), self._start
        vertices, covariances = self._gflow.vertices(state)
        return TrackedFace(
            vertices,
            covariances,
            start.model.triangles,
            pose.rotations[0],
            pose.translations[0],
            pose.morphs[0],
            self._gflow.points(state, start.points) if start.present.any() else np.zeros((0, 2)),
            state.lost,
            state.tracked_probability,
        )

    def _find(self, frame: Frame, box: ArrayLike | None, landmarks: ArrayLike | None) -> FaceStart | None:
        if landmarks is not None:
            return start_from_landmarks(self._model, np.array(landmarks, np.float64))
        if box is None:
            faces = default_faces(self._detector, "box, landmarks, or a model file of YuNet as detector")
            trial = self._state.trial
            found = find_face(frame, faces, small=bool(trial) or frame.number % SMALL_EVERY == 1)
            trial = on_trial(trial, None if found is None else start_from_box(self._model, found))
            self._state = replace(self._state, trial=trial)
            return trial[-1] if len(trial) == CONFIRMING else None
        return start_from_box(self._model, size_of(box))

    def _build(self, start: FaceStart | None) -> RecursiveBP | None:
        if start is None:
            return None
        try:
            finder = DetectedFace(start.model, default_faces(self._detector))
        except ValueError:  # OpenCV 5 has no cascade: the face is found again by its texture
            if self._detector is not None:
                raise
            finder = None
        self._start = start
        self._gflow = GFlow(start.model, start.pose, experts=self._experts, finder=finder, seed=self._seed)
        return RecursiveBP(MultiChain().connect(self._gflow, PixelLabels()))

    def _chains(self) -> Mapping[str, Any]:
        return {GFlow.name: GFlow}

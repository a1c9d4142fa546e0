"""Trackers that are given one image after the other, over the models of the applications.

    tracker = ObjectTracker()
    for image in camera:
        objects = tracker.update(image, boxes=detector(image))

Images are uint8, `(height, width)` or `(height, width, 3)` in the order BGR, as OpenCV reads them; `None`
stands for a missing image, for which everything is predicted. Boxes, in both directions, are `(n, 4)`
px: left, top, right, bottom, as detectors and supervision have them (`xyxy`). `time` is in seconds and
increases; without it, images are evenly spaced.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..chains.body.articulated_pose import ArticulatedPose
from ..chains.body.flesh_tracker import FleshTracker
from ..chains.body.samples import body_moments
from ..chains.body.start import (
    BodyStart,
    SavedPerson,
    shows_person,
    start_from_faces,
    start_from_head,
    start_from_keypoints,
)
from ..chains.face.gflow import GFlow
from ..chains.face.recovery import DetectedFace
from ..chains.face.start import (
    CONFIRMING,
    FaceStart,
    find_face,
    on_trial,
    start_from_box,
    start_from_landmarks,
)
from ..chains.pixels.camera_motion import CameraMotion, CameraState
from ..chains.points import point_tracker
from ..chains.structure.recursive_structure import RecursiveStructure
from ..inference import Belief, MultiChain, RecursiveBP, RunState
from ..inference.engine import checkpoint
from ..inference.engine.graph import require_later
from ..models.camera.moving_camera import View
from ..models.core.checks import Bound, Count, Positive, Shape, checked, shown
from ..models.core.frame import BoundingBox, Frame, GivenBoxes, GivenKeypoints, GivenPoints
from ..models.core.short_repr import short_repr
from ..models.face.built_in_model import face_model
from ..models.face.detectors import confirmed_faces, default_faces
from ..models.face.morphable_model import MorphableModel
from ..models.pixels.pixel_labels import PixelLabels
from ..models.points.point_tracks import PointTracks
from .background.application import build_model, read_frame_result
from .background.parameters import with_defaults
from .exports.coco import object_masks
from .exports.for_supervision import to_supervision
from .face.application import SMALL_EVERY
from .io.tracks import TrackedObject

if TYPE_CHECKING:
    import supervision

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Picture = Annotated[Image, Bound(lambda image: image.size > 0, "an image with pixels")]
Result = TypeVar("Result")
Start = TypeVar("Start")


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class TrackerState(Generic[Start]):
    """State of a tracker after an image: an immutable value that can be kept, and assigned to `state`.

    Parameters
    ----------
    run
        state of the engine.
    start
        the tracked face or person; `None` for objects and points, and before the first detection.
    settings
        of the tracker: only one with the same settings can continue.
    """

    run: RunState
    start: Start | None
    settings: Mapping[str, Any]


class Tracker(ABC, Generic[Start, Result]):
    """Base of all trackers: an engine and its state.

    Parameters
    ----------
    frame_rate
        images per second, if `update` gets no time.
    settings
        on which the state depends, plain JSON.
    """

    start_type: ClassVar[Any] = type(None)
    _state: TrackerState[Start]

    def __init__(self, frame_rate: float, **settings: Any) -> None:
        self._interval, self._settings = 1 / frame_rate, {"tracker": type(self).__name__, **settings}
        self.reset()

    @property
    def state(self) -> TrackerState[Start]:
        """The state after the last image. Assign one to go on from it."""
        return self._state

    @state.setter
    def state(self, state: TrackerState[Start]) -> None:
        if not isinstance(state, TrackerState):
            raise TypeError(f"state: got {shown(state)}, expected a TrackerState")
        got, own = state.settings.get("tracker"), type(self).__name__
        if got != own:
            raise ValueError(f"state: got one of {got or 'another program'}, expected one of {own}")
        checkpoint.require_same("state", dict(state.settings), self._settings)
        if state.start is not self._state.start:
            self._engine = self._build(state.start)
        self._state = state

    def reset(self) -> None:
        """Forget everything: the next image is the first."""
        self._state = TrackerState(RunState(), None, self._settings)
        self._engine = self._build(None)

    def save(self, path: str | Path) -> None:
        """Write the state to an `.npz` file, whole or not at all."""
        state = self._state
        values = {"settings": dict(state.settings), "start": state.start, "run": state.run.saved()}
        checkpoint.save(path, values, self._kinds())

    def load(self, path: str | Path) -> None:
        """Go on from a state that `save` wrote; a `ValueError` says what does not fit."""
        contents = checkpoint.read(path)
        settings = contents.plain("settings")
        try:
            if isinstance(settings, dict) and settings.get("tracker") == type(self).__name__:
                values = checkpoint.load(contents, self._kinds())
                self.state = TrackerState(RunState.restored(values["run"]), values["start"], settings)
            else:
                self.state = TrackerState(RunState(), None, settings if isinstance(settings, dict) else {})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def __repr__(self) -> str:
        return f"{type(self).__name__}(after {self._state.run.number} images)"

    @abstractmethod
    def _build(self, start: Start | None) -> RecursiveBP | None:
        """Return the engine; `None` where it needs a start."""

    @abstractmethod
    def _chains(self) -> Mapping[str, Any]:
        """Return the chains, or their classes, by name."""

    def _kinds(self) -> dict[str, Any]:
        return {
            "settings": dict[str, Any],
            "start": self.start_type | None,
            "run": RunState.kinds(self._chains()),
        }

    def _frame(self, image: Image | None, time: float | None, **given: Any) -> Frame:
        run = self._state.run
        if time is None:
            time = run.time + self._interval if run.number else 0.0
        frame = Frame(image, time, run.number + 1, **given)
        require_later(frame, run.time, run.number)
        return frame

    def _step(self, frame: Frame) -> Belief:
        assert self._engine is not None
        belief = self._engine.step(self._state.run, frame)
        self._state = replace(self._state, run=belief.state)
        return belief


class DetectingTracker(Tracker[Start, Result]):
    """Base of trackers of one face or person, whom a detector finds where images show one for sure.

    Parameters
    ----------
    detector
        model file of YuNet (.onnx) or a cascade (.xml) that finds the face; that of OpenCV 4 without it.
    seed
        of all random draws.
    frame_rate, settings
        images per second, where `update` is given no time.
    """

    def __init__(self, detector: str | Path | None, seed: int, frame_rate: float, **settings: Any) -> None:
        self._detector = None if detector is None else Path(detector)
        self._seed = seed
        super().__init__(frame_rate, seed=seed, **settings)

    def _started(self, frame: Frame, find: Callable[[Frame], Start | None]) -> bool:
        """Return whether there is a face or person, who is looked for in this frame if not."""
        if self._state.start is None:
            start = None if frame.image is None else find(frame)
            shape = self._state.run.shape if frame.image is None else frame.image.shape
            if start is None:
                self._state = replace(self._state, run=RunState({}, frame.number, frame.time, shape))
                return False
            self._engine = self._build(start)
            self._state = replace(self._state, start=start)
        return True


@dataclass(frozen=True, eq=False)
class Objects:
    """Objects in an image, by increasing identity.

    Parameters
    ----------
    tracks
        one per object, as in `belief["blobs"].tracks()`.
    foreground
        `(height, width)` uint8, 255 for foreground, 0 for background.
    view
        map from the first image to this one, with its covariance (`view.map.inverse` maps back to the first
        image); `None` for a fixed camera.
    """

    tracks: Sequence[TrackedObject]
    foreground: Image
    view: View | None = None

    def __len__(self) -> int:
        return len(self.tracks)

    @cached_property
    def boxes(self) -> Floats:
        """`(n, 4)` px: left, top, right, bottom; 0 is the left or top edge of the image."""
        boxes = self._sizes
        return np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])

    @property
    def identities(self) -> NDArray[np.int64]:
        """`(n,)`: numbers from 1 that stay with the objects, and are never used twice."""
        return np.array([track.identity for track in self.tracks], np.int64)

    @property
    def velocities(self) -> Floats:
        """`(n, 2)` px/s, to the right and down."""
        return np.array([track.velocity for track in self.tracks], np.float64).reshape(-1, 2)

    @property
    def existence(self) -> Floats:
        """`(n,)`, 0 to 1.

        Of an object that a detector has found, the probability that it exists; of others, the share of their
        visible part that the last image showed.
        """
        return np.array([track.confidence for track in self.tracks], np.float64)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """`(n,)`: whether the image or a detector shows the object; otherwise it is only predicted."""
        return np.array([track.seen for track in self.tracks], np.bool_)

    @cached_property
    def masks(self) -> NDArray[np.bool_]:
        """`(n, height, width)`: the foreground inside each box; where boxes overlap, it belongs to both."""
        return object_masks(self.foreground, self._sizes)

    def to_supervision(self) -> "supervision.Detections":
        """Return the objects as `supervision.Detections`, with `tracker_id`, masks and velocities."""
        return to_supervision(self.tracks, self.foreground)

    @property
    def _sizes(self) -> Floats:
        """`(n, 4)` px: x, y, width, height."""
        return np.array([track.box for track in self.tracks], np.float64).reshape(-1, 4)


class ObjectTracker(Tracker[None, Objects]):
    """Tracker of moving objects from pixels, and optionally from the boxes of a detector.

    The model is that of `rsmcm background`: an adaptive background, blobs, a ground plane and the detector's
    rates correct each other. Without a detector, everything that moves is an object.

    Parameters
    ----------
    camera
        `"fixed"`, or `"moving"` for one that shakes, turns, zooms or walks.
    parameters
        of the chains, by section and name, as in the file of `--config`.
    frame_rate
        images per second, if `update` gets no time.
    """

    @checked
    def __init__(
        self,
        camera: Literal["fixed", "moving"] = "fixed",
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        frame_rate: Positive = 25.0,
    ) -> None:
        self._objects = RecursiveBP(build_model(parameters=parameters, camera=camera))
        super().__init__(frame_rate, camera=camera, parameters=with_defaults(parameters or {}))

    @checked
    def update(
        self,
        image: Picture | None,
        boxes: Any = None,
        time: float | None = None,
    ) -> Objects:
        """Return the objects in the next image.

        Parameters
        ----------
        image
            uint8, BGR or grey; `None` if it is missing.
        boxes
            boxes of a detector: `(n, 4)` px, left, top, right, bottom, or `(n, 5)` with a score on any scale;
            or `supervision.Detections`, or the boxes of Ultralytics. `None` if the detector did not run on
            this image; n = 0 if it ran and found nothing, which is evidence against objects.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range.
        """
        found = None if boxes is None else GivenBoxes.of(boxes)
        belief = self._step(self._frame(image, time, boxes=found))
        height, width = (belief.state.shape or (0, 0))[:2]
        objects = read_frame_result(belief, (width, height))
        camera: CameraState | None = belief.states.get(CameraMotion.name)
        return Objects(objects.tracks, objects.foreground, None if camera is None else camera.view_of_first)

    def _build(self, start: None) -> RecursiveBP:
        return self._objects

    def _chains(self) -> Mapping[str, Any]:
        return self._objects.model.chains


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
        whether the face is lost.
    """

    vertices: Floats
    covariances: Floats
    triangles: NDArray[np.int64]
    rotation: Floats
    translation: Floats
    expression: Floats
    landmarks: Floats
    lost: bool


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
    _trial: tuple[int, list[FaceStart]]  # a face that is not sure yet, and the number of its last image

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
        )

    def _find(self, frame: Frame, box: ArrayLike | None, landmarks: ArrayLike | None) -> FaceStart | None:
        if landmarks is not None:
            return start_from_landmarks(self._model, np.array(landmarks, np.float64))
        if box is None:
            faces = default_faces(self._detector, "box, landmarks, or a model file of YuNet as detector")
            after, trial = self._trial
            trial = trial if frame.number == after + 1 else []
            found = find_face(frame, faces, small=bool(trial) or frame.number % SMALL_EVERY == 1)
            trial = on_trial(trial, None if found is None else start_from_box(self._model, found))
            self._trial = frame.number, trial
            return trial[-1] if len(trial) == CONFIRMING else None
        return start_from_box(self._model, size_of(box))

    def _build(self, start: FaceStart | None) -> RecursiveBP | None:
        self._trial = 0, []
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


@dataclass(frozen=True, eq=False)
class TrackedBody:
    """Head and arms of a person in an image; joints in the order of `JOINTS` of `rsmcm.models`.

    Parameters
    ----------
    joints, covariances
        `(8, 3)` px and `(8, 3, 3)` px^2, z away from the camera: head, neck, then shoulder, elbow and hand of
        the person's left side, and of the right one.
    angles, angle_covariances
        `(16,)` px and rad, and `(16, 16)`.
    seen
        `(3,)`: whether the image shows head, left hand and right hand.
    """

    joints: Floats
    covariances: Floats
    angles: Floats
    angle_covariances: Floats
    seen: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Keypoints:
    """Key points of one frame, where those of a film are expected."""

    frame: Frame
    path: Path = Path("keypoints")

    def frames(self) -> Iterable[tuple[int, GivenKeypoints]]:
        given = self.frame.keypoints
        return [] if given is None else [(self.frame.number, given)]


class BodyTracker(DetectingTracker[SavedPerson, TrackedBody | None]):
    """Tracker of head and arms of one person who faces the camera, as `rsmcm body --lag 0`.

    Size and colour of the person are learned from the first image with a person.

    Parameters
    ----------
    samples
        number of pose samples per image.
    detector, seed, frame_rate
        as of `DetectingTracker`.
    """

    start_type = SavedPerson

    @checked
    def __init__(
        self,
        detector: str | Path | None = None,
        samples: Count = 1000,
        seed: int = 0,
        frame_rate: Positive = 25.0,
    ) -> None:
        self._samples = samples
        super().__init__(detector, seed, frame_rate, samples=samples)

    @checked
    def update(
        self,
        image: Picture | None,
        keypoints: Any = None,
        head: Annotated[Any, Shape(4)] | None = None,
        time: float | None = None,
    ) -> TrackedBody | None:
        """Return the pose in the next image; `None` until a person was found.

        Parameters
        ----------
        image
            uint8, BGR; `None` if it is missing. Grey images have no skin colour: hands are hardly detected.
        keypoints
            keypoints of a detector: `(n, 17, 2)` px, or `(n, 17, 3)` with scores, in COCO's order;
            `supervision.KeyPoints`, the keypoints of Ultralytics, or for one person a dictionary of names
            with x, y. `None` if the detector did not run; n = 0 if it ran and found nobody.
        head
            `(4,)` px: the head, from chin to the top of the skull; left, top, right, bottom. Used until a
            person is tracked. Without keypoints and head, the detector finds the face.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range, or there is no face detector.
        """
        given = None if keypoints is None else GivenKeypoints.of(keypoints)
        frame = self._frame(image, time, keypoints=given)
        if not self._started(frame, lambda first: self._find(first, head)):
            return None
        states = self._step(frame).states
        found = body_moments(self._body, states[ArticulatedPose.name])
        return TrackedBody(
            found.joints,
            found.joint_covariances,
            found.angles,
            found.angle_covariances,
            np.asarray(states[FleshTracker.name].unseen == 0),
        )

    def _find(self, frame: Frame, head: ArrayLike | None) -> SavedPerson | None:
        person = self._person(frame, head)
        return None if person is None else SavedPerson.of(person)

    def _person(self, frame: Frame, head: ArrayLike | None) -> BodyStart | None:
        image, keypoints, file = frame.required_image(), frame.keypoints, self._detector
        box = None if head is None else size_of(head)
        if box is not None and file is None:
            return start_from_head(frame, box, [image])
        if keypoints is not None and file is None:
            return start_from_keypoints(frame, _Keypoints(frame), [image]) if shows_person(frame) else None
        faces = default_faces(file, "head, keypoints, or a model file of YuNet as detector")
        found = faces(frame) if box is not None else confirmed_faces(image, faces(frame), faces)
        return start_from_faces("image", [image], file, box) if len(found) else None

    def _build(self, start: SavedPerson | None) -> RecursiveBP | None:
        if start is None:
            return None
        person = start.start(self._detector)
        self._body, parts = person.body, person.parts
        model = MultiChain().connect(FleshTracker(self._body), parts)
        return RecursiveBP(model.connect(ArticulatedPose(self._body, self._samples, seed=self._seed), parts))

    def _chains(self) -> Mapping[str, Any]:
        return {FleshTracker.name: FleshTracker, ArticulatedPose.name: ArticulatedPose}


@dataclass(frozen=True, eq=False)
class Points:
    """Points in an image, by increasing identity.

    Parameters
    ----------
    positions, covariances
        `(n, 2)` px and `(n, 2, 2)` px^2.
    velocities
        `(n, 2)` px/s.
    identities
        `(n,)`: constant for each point, never used twice.
    seen
        `(n,)`: whether the image shows the point; otherwise it is only predicted.
    """

    positions: Floats
    covariances: Floats
    velocities: Floats
    identities: NDArray[np.int64]
    seen: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.identities)


class PointTracker(Tracker[None, Points]):
    """Tracker of corners, as `rsmcm structure --engine recursive-bp`.

    Parameters
    ----------
    rigid
        whether the points belong to one rigid object: its learned shape then predicts hidden points, so that
        they are found again under their identity.
    points
        number of points.
    frame_rate
        images per second, if `update` gets no time.
    """

    @checked
    def __init__(self, rigid: bool = True, points: Count = 200, frame_rate: Positive = 25.0) -> None:
        self._tracker = point_tracker.PointTracker(n_points=points)
        node = PointTracks()
        model = MultiChain().connect(self._tracker, node)
        self._points = RecursiveBP(model.connect(RecursiveStructure(), node) if rigid else model)
        super().__init__(frame_rate, rigid=rigid, points=points)

    @checked
    def update(
        self,
        image: Picture | None,
        positions: Annotated[Any, Shape("n", 2)] | None = None,
        identities: Annotated[Any, Shape("n")] | None = None,
        time: float | None = None,
    ) -> Points:
        """Return the points in the next image.

        Parameters
        ----------
        image
            uint8, BGR or grey; `None` if it is missing.
        positions, identities
            `(n, 2)` px and `(n,)`, increasing: points of another tracker, instead of points of the image.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range.
        """
        if (positions is None) != (identities is None):
            raise ValueError("positions: got them or identities alone, expected both or neither")
        given = None
        if positions is not None:
            given = GivenPoints(np.array(positions, np.float64), np.array(identities, np.int64))
        belief = self._step(self._frame(image, time, points=given))
        if not belief.states:
            nothing = np.zeros((0, 2))
            return Points(nothing, np.zeros((0, 2, 2)), nothing, np.zeros(0, np.int64), np.zeros(0, bool))
        known = belief[self._tracker].known
        followed = known.only(known.alive)
        states = followed.states
        return Points(
            states.position,
            states.position_covariance,
            states.mean[:, 2:],
            followed.identities,
            followed.unseen == 0,
        )

    def _build(self, start: None) -> RecursiveBP:
        return self._points

    def _chains(self) -> Mapping[str, Any]:
        return self._points.model.chains


def size_of(box: ArrayLike) -> BoundingBox:
    """Return x, y, width, height px of a box: left, top, right, bottom."""
    left, top, right, bottom = GivenBoxes.of(np.array(box, np.float64)[None]).xyxy[0].tolist()
    return left, top, right - left, bottom - top

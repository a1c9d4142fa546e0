"""Tracker of the upper body of a person, given one image after the other."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...chains.body.articulated_pose import ArticulatedPose
from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import FixedLag
from ...chains.body.flesh_tracker import FleshTracker
from ...chains.body.samples import body_moments
from ...chains.body.start import (
    BodyStart,
    SavedPerson,
    shows_person,
    start_from_faces,
    start_from_head,
    start_from_keypoints,
)
from ...inference import MultiChain, RecursiveBP
from ...models.core.checks import Count, Positive, Shape, checked
from ...models.core.frame import Frame, GivenKeypoints
from ...models.face.detectors import confirmed_faces, default_faces
from ..body.application import seen_probabilities
from .tracker import DetectingTracker, Floats, Picture, size_of


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
    seen_probability
        `(3,)`: that head, left hand and right hand are visible where they are stated to be.
    """

    joints: Floats
    covariances: Floats
    angles: Floats
    angle_covariances: Floats
    seen_probability: Floats

    @property
    def seen(self) -> NDArray[np.bool_]:
        """`(3,)`: whether the probability is above one half."""
        return np.asarray(self.seen_probability > 0.5)


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
        belief = self._step(frame)
        samples = belief.states[ArticulatedPose.name]
        found = body_moments(self._body, samples)
        (timed,) = self._seen.add(frame, samples, belief.evidence(self._parts).image)
        return TrackedBody(
            found.joints,
            found.joint_covariances,
            found.angles,
            found.angle_covariances,
            seen_probabilities(self._body, belief.states[FleshTracker.name], timed),
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
        self._body, self._parts = person.body, person.parts
        self._seen = FixedLag(BodyDynamics(self._body), 0, seed=self._seed)
        pose = ArticulatedPose(self._body, self._samples, seed=self._seed)
        model = MultiChain().connect(FleshTracker(self._body), self._parts)
        return RecursiveBP(model.connect(pose, self._parts))

    def _chains(self) -> Mapping[str, Any]:
        return {FleshTracker.name: FleshTracker, ArticulatedPose.name: ArticulatedPose}

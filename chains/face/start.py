"""Pose and shape of a face in the first frame: from landmarks, or from a face detector."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape
from ...models.core.frame import BoundingBox, Frame
from ...models.face.detectors import FACE, PartDetector, confirmed_faces, for_height
from ...models.face.morphable_model import KNOWN, MorphableModel, Poses, SurfacePoints, rms_radius
from .landmark_fit import LANDMARK_NOISE, MIN_LANDMARKS, fit_landmarks, own_points
from .recovery import poses_in_boxes

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

USUAL_MISFIT = 2 * LANDMARK_NOISE
"""Largest usual distance of landmarks from a fitted model, in its sizes: on a talking face at most 0.035."""

LARGE_FACE, SMALLEST, OCTAVE = 0.16, 30.0, 2.0
"""Heights of small faces to search for: below this share of the picture's shorter side, down to a half of so
many px, in steps of this factor, which a cascade covers."""

CONFIRMING = 3
"""Successive pictures that have to show a face in one place before it is tracked. In 2 of 40 films of smooth
random texture so many do."""

SAME_PLACE = 0.5  # widths of a face, by which it may move from a picture to the next


@dataclass(frozen=True, eq=False)
class FaceStart:
    """A face in one frame."""

    model: MorphableModel  # of this person
    pose: Annotated[Poses, KNOWN]  # one, of that model
    points: SurfacePoints  # at the present landmarks, which they meet exactly in this pose
    present: Annotated[NDArray[np.bool_], Shape("n_landmarks")]  # given landmarks that are not NaN
    fit_error: float | None  # px: root mean square distance of landmarks from the model's points, if any

    def require_fit(self) -> None:
        """Raise a `ValueError` if pose or points are none of the model's, or this is in no unit of size."""
        n_bases, n_vertices = self.model.bases.shape[:2]
        if not abs((radius := rms_radius(self.model.bases[0])) - 1) < 1e-6:
            raise ValueError(f"model: got a typical shape of radius {radius:.3g}, expected 1")
        if self.pose.morphs.shape != (1, n_bases) or self.points.vertices.max(initial=0) >= n_vertices:
            raise ValueError(f"start: got a pose or points of another model than of {n_vertices} vertices")

    @property
    def misfit(self) -> str | None:
        """Warning if the model does not meet the landmarks; `None` if it does."""
        size = float(self.pose.sizes[0])
        if self.fit_error is None or self.fit_error <= USUAL_MISFIT * size:
            return None
        return (
            f"The start may be poor: the model misses the landmarks by {self.fit_error:.3g} px, "
            f"{USUAL_MISFIT * size:.2g} px are usual. Are they this face's, in this order?"
        )


def start_from_landmarks(
    model: MorphableModel, landmarks: Array, pairs: NDArray[np.int64] | None = None
) -> FaceStart:
    """Fit pose, identity and expression to landmarks, and attach all of them to the surface.

    Parameters
    ----------
    model
        of faces, or of this one.
    landmarks
        `(n_landmarks, 2)` px, NaN where missing.
    pairs
        `(n_pairs, 2)`: index of a given landmark, from 0, and number of the model's landmark (of its vertex,
        where it has no list of landmarks), from 1. Without it, the given landmarks are the model's own
        landmarks, or its vertices, in their order.

    Raises
    ------
    ValueError
        if landmarks and model do not fit together, or fewer than four can be used.
    """
    chosen, points = _points_of(model, landmarks, pairs)
    places = landmarks[chosen]
    known = ~np.isnan(places[:, 0])
    if np.count_nonzero(known) < MIN_LANDMARKS:
        raise ValueError(
            f"landmarks: got {np.count_nonzero(known)} in the first frame that the model has as well, "
            f"expected {MIN_LANDMARKS} or more"
        )
    fitted = fit_landmarks(model, places, points)
    person = model.personalised(fitted.morphs[0])
    pose = fit_landmarks(person, places, points)
    missed = (points.project(person, pose)[0] - places)[known]
    error = float(np.sqrt((missed**2).sum(axis=1).mean()))
    present = ~np.isnan(landmarks[:, 0])
    attached = SurfacePoints.attached(person, pose, landmarks[present])
    return FaceStart(person, pose, attached, present, error)


def _points_of(
    model: MorphableModel, landmarks: Array, pairs: NDArray[np.int64] | None
) -> tuple[NDArray[np.int64], SurfacePoints]:
    """Return the indices of the landmarks that the model has, and its points there."""
    n_given = len(landmarks)
    own = model.landmarks
    if pairs is not None:
        chosen, numbers = pairs.T
        if chosen.max() >= n_given:
            raise ValueError(f"correspondences: got landmark {chosen.max()}, expected 0 to {n_given - 1}")
        if own is not None:
            return chosen, model.landmark_points(numbers)
        if numbers.max() > model.n_vertices:
            raise ValueError(
                f"correspondences: got vertex {numbers.max()}, expected 1 to {model.n_vertices} of the model"
            )
        return chosen, SurfacePoints.of_vertices(numbers - 1)
    try:
        return own_points(model, n_given)
    except ValueError as error:
        raise ValueError(f"{error}: give --correspondences") from None


def start_from_box(model: MorphableModel, box: BoundingBox) -> FaceStart:
    """Place the typical shape upright in the box `(x, y, width, height)` px of a face.

    Raises `ValueError` if the box is empty.
    """
    _, _, width, height = box
    if not (width > 0 and height > 0):
        raise ValueError(f"box: got {width}x{height} px, expected a width and height above 0")
    person = model.personalised(np.eye(model.n_bases)[0])
    pose = poses_in_boxes(person, np.array([box], np.float64))
    return FaceStart(person, pose, SurfacePoints.of_vertices([]), np.zeros(0, np.bool_), None)


def find_face(frame: Frame, faces: PartDetector, *, small: bool = True) -> BoundingBox | None:
    """Return the largest face that is detected and confirmed, `(x, y, width, height)` px; `None` without one.

    If there is none, the picture is enlarged, so that `small` faces have the size for which detectors are
    trained; this takes longer.
    """
    image = frame.image
    if image is None:
        return None
    sure = confirmed_faces(image, faces(frame), faces)
    if len(sure) or not small:
        return _largest(sure)
    finding, height = for_height(faces, FACE), LARGE_FACE * min(image.shape[:2])
    while height > SMALLEST:
        height /= OCTAVE
        scale = FACE / height
        enlarged = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        boxes = finding(replace(frame, image=np.asarray(enlarged, np.uint8))) / scale
        if len(sure := confirmed_faces(image, boxes, faces)):
            return _largest(sure)
    return None


def on_trial(before: Sequence[FaceStart], found: FaceStart | None) -> list[FaceStart]:
    """Return the starts of a face in successive pictures, up to the one `found` in the next picture.

    A face in another place begins a new trial; without a face there is none.
    """
    if found is None:
        return []
    if before:
        (last, middle), (width, now) = _width_and_middle(before[-1]), _width_and_middle(found)
        if np.linalg.norm(now - middle) > SAME_PLACE * min(last, width):
            return [found]
    return [*before, found]


def _width_and_middle(start: FaceStart) -> tuple[float, Array]:
    places = start.model.project(start.pose)[0]
    return float(np.ptp(places[:, 0])), places.mean(axis=0)


def _largest(boxes: Array) -> BoundingBox | None:
    if not len(boxes):
        return None
    x, y, width, height = boxes[np.prod(boxes[:, 2:], axis=1).argmax()].tolist()
    return x, y, width, height

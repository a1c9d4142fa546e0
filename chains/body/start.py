"""Initialisation of a body tracker: size, skin colour and lengths of a person, from some frames."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ...models.body.keypoints import head_places, joints_of, largest
from ...models.body.parts import CENTRE_OF_BOX, HEAD_OF_BOX, BodyParts
from ...models.body.skin import SkinColour, static_skin
from ...models.body.upper_body import PROPORTIONS, UpperBody
from ...models.core.checks import CountFrom0, Positive, Shape
from ...models.core.frame import BoundingBox, Frame, GivenKeypoints
from ...models.face.detectors import HaarFaces, PartDetector, default_faces

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class MarkedFace:
    """A detector that returns a face marked by hand, in its own frame only."""

    box: Annotated[Array, Shape(4)]  # px: x, y, width, height
    number: CountFrom0  # of the frame

    def __call__(self, frame: Frame) -> Array:
        """Return boxes `(1, 4)` px in that frame, `(0, 4)` in all others."""
        return self.box[None] if frame.number == self.number else np.zeros((0, 4))


@dataclass(frozen=True, eq=False)
class BodyStart:
    """A person to be tracked."""

    parts: BodyParts  # the feature node, with the person's skin colour and a detector
    body: UpperBody  # lengths of the segments
    origin: str  # where the lengths come from, in a sentence

    def head_in(self, frame: Frame) -> Array | None:
        """Detect the head in a frame: its centre `(2,)` px, or `None`."""
        boxes = np.zeros((0, 4)) if self.parts.detector is None else self.parts.detector(frame)
        return boxes[0, :2] + boxes[0, 2:] * (0.5, CENTRE_OF_BOX) if len(boxes) else None

    @property
    def notes(self) -> list[str]:
        """Warnings, a sentence each."""
        if self.parts.skin is None:
            return [
                "The video is grey: there is no skin colour. Hands are tracked by edges only, and in "
                "frames without a detected face everything is only predicted."
            ]
        return []


@dataclass(frozen=True, eq=False)
class SavedPerson:
    """A `BodyStart` that can be saved: face detectors are created from their settings again."""

    person: BodyStart  # without a detector
    face_height: Positive | None  # px, size that the face detector searches for; `None` for any
    marked: MarkedFace | None  # the face marked by hand in place of a detector

    @classmethod
    def of(cls, start: BodyStart) -> Self:
        """Replace the detector by its settings."""
        detector = start.parts.detector
        return cls(
            replace(start, parts=replace(start.parts, detector=None)),
            detector.height if isinstance(detector, HaarFaces) else None,
            detector if isinstance(detector, MarkedFace) else None,
        )

    def elsewhere(self) -> Self:
        """Return the same person for another film, without a marked face and without other people's faces."""
        marked = None if self.marked is None else replace(self.marked, number=0)
        person = replace(self.person, parts=replace(self.person.parts, others=None))
        return replace(self, person=person, marked=marked)

    def start(self, detector: Path | None) -> BodyStart:
        """Return the `BodyStart`; `detector` is the model file of its face detector, if any."""
        faces: PartDetector | None = self.marked
        if faces is None or detector is not None:
            faces = default_faces(detector)
            if isinstance(faces, HaarFaces):
                faces = replace(faces, height=self.face_height)
        return replace(self.person, parts=replace(self.person.parts, detector=faces))


def start_from_faces(
    name: str,
    images: Sequence[Image],
    detector: Path | None,
    head: BoundingBox | None = None,
) -> BodyStart:
    """Detect a person's face in some images, and learn size and colour from it.

    `name`: of the source; `images` `(height, width[, 3])` uint8 BGR, at least one; `detector`: model file of
    YuNet; OpenCV's cascade without it; `head`: x, y, width, height px of the person's head in the first
    image; without it the person with most hands, or the largest face. Raises `ValueError` if there is no face
    or no detector, `FileNotFoundError` if there is no such model file.
    """
    try:
        faces = default_faces(detector)
    except ValueError as error:
        if detector is not None:
            raise
        raise ValueError(f"{error} as --detector, or the head in the first frame as --head") from None
    faces(Frame(images[0], 0.0, 1))  # a file that holds another network shows it now
    try:
        parts = BodyParts.learned(images, faces, None if head is None else _face_of(head))
    except ValueError:
        raise ValueError(
            f"{name}: no face is found in the {len(images)} frames looked at, expected a person who faces "
            "the camera: mark the head in the first frame with --head"
        ) from None
    origin = "Average proportions of a person with the height of the detected faces."
    return BodyStart(parts, UpperBody.from_head(parts.head_height), origin)


def start_from_head(first: Frame, head: BoundingBox, images: Sequence[Image]) -> BodyStart:
    """Learn size and colour from a head marked by hand.

    `first`: its frame, which has an image; `head`: x, y, width, height px, from chin to the top of the skull;
    `images`: of the same size, from all over the clip. Raises `ValueError` if the head is not in the image.
    """
    image = first.image
    if image is None:
        raise ValueError(f"frame {first.number}: got no image, expected one with the head")
    x, y, width, height = head
    rows, columns = image.shape[:2]
    inside = 0 <= x + width / 2 < columns and 0 <= y + height / 2 < rows
    if not (inside and width <= columns and height <= rows):
        raise ValueError(
            f"--head: got {x:g},{y:g},{width:g},{height:g}, expected the head inside the picture of "
            f"{columns}x{rows} px"
        )
    box = np.array(_face_of(head))
    skin = SkinColour.learned([image], box[None])
    still = None if skin is None else static_skin(skin, images)
    parts = BodyParts(height, skin, MarkedFace(box, first.number), still)
    parts = parts.dressed([image], box[None])
    origin = "Average proportions of a person with a head of the given height."
    return BodyStart(parts, UpperBody.from_head(height), origin)


def _face_of(head: BoundingBox) -> BoundingBox:
    """Box that a face detector would return for a head."""
    x, y, width, height = head
    side = height / HEAD_OF_BOX
    return x + (width - side) / 2, y + height / 2 - CENTRE_OF_BOX * side, side, side


MOST_FRAMES = 200  # that lengths are fitted to, evenly spread over all


class FilmKeypoints(Protocol):
    """Key points of the persons in a film."""

    @property
    def path(self) -> Path:
        """File from which they are."""

    def frames(self) -> Iterable[tuple[int, GivenKeypoints]]:
        """Iterate over numbers of frames with the persons detected there, in order."""


def shows_person(frame: Frame) -> bool:
    """Whether head, neck or both shoulders of the largest person in a frame were detected."""
    given = frame.keypoints
    return (
        given is not None
        and len(given) > 0
        and bool(np.isfinite(head_places(given, 0.0)[largest(given)]).all())
    )


def start_from_keypoints(
    first: Frame, keypoints: FilmKeypoints, images: Sequence[NDArray[np.uint8]]
) -> BodyStart:
    """Learn size, lengths and colour from the key points of the largest person in a frame.

    `first`: the frame, which has an image and `shows_person`; `keypoints`: of the whole film; `images`: of
    the same size, from all over the film. Raises `ValueError` if the points do not give the person's size, or
    the head is not in the image.
    """
    given = first.keypoints
    assert given is not None
    joints = follow_person(keypoints, first.number)
    try:
        height = UpperBody.fit(joints).head_height
    except ValueError as error:
        raise ValueError(f"{keypoints.path}: {error}: mark the head in the first frame with --head") from None
    (x, y), width = head_places(given, height)[largest(given)].tolist(), PROPORTIONS["head_width"] * height
    try:
        start = start_from_head(first, (x - width / 2, y - height / 2, width, height), images)
    except ValueError as error:
        raise ValueError(f"{keypoints.path}, frame {first.number}: {error}") from None
    return fit_lengths(start, joints)


def fit_lengths(start: BodyStart, joints: Array) -> BodyStart:
    """Fit the lengths to joints `(n, 8, 2)` px; unchanged if they give impossible ones."""
    try:
        body = UpperBody.fit(joints, np.full(len(joints), start.parts.head_height))
    except ValueError:
        return start
    n_frames = len(joints)
    origin = f"Fitted to keypoints in {n_frames} frames; unknown lengths have average proportions."
    return replace(start, body=body, origin=origin)


def follow_person(keypoints: FilmKeypoints, first: int, head: Array | None = None) -> Array:
    """Return joints of one person in some frames: of the one nearest to the last points, by their median.

    `keypoints`: of the film; `first`: number of the first frame; `head` `(2,)` px: the person's head there,
    of the largest person if `None`. Returns `(n, 8, 2)` px, NaN where a joint was not detected.
    """
    own, last = [], None
    for number, given in keypoints.frames():
        if number < first:
            continue
        if last is not None:
            distances = np.sort(np.linalg.norm(given.positions - last, axis=2), axis=1)  # NaN last
            apart = distances[range(len(given)), (np.isfinite(distances).sum(axis=1) - 1) // 2]
        elif head is not None:
            apart = np.linalg.norm(head_places(given, 0.0) - head, axis=1)
        else:
            apart = np.where(np.arange(len(given)) == largest(given), 0.0, np.inf)
        apart = np.where(np.isnan(apart), np.inf, apart)
        person = int(apart.argmin())
        if np.isfinite(apart[person]):
            own.append(GivenKeypoints(given.positions[person, None], given.scores[person, None]))
            places = given.positions[person]
            last = places if last is None else np.where(np.isnan(places), last, places)
    chosen = np.unique(np.linspace(0, len(own) - 1, min(len(own), MOST_FRAMES)).round().astype(int))
    return np.concatenate([np.zeros((0, 8, 2)), *(joints_of(own[number]) for number in chosen)])

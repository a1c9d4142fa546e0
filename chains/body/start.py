"""Who is to be tracked: size, skin colour and lengths of a person, from some frames."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ...models.body.keypoints import head_places, joints_of, largest
from ...models.body.parts import CENTRE_OF_BOX, HEAD_OF_BOX, BodyParts
from ...models.body.skin import SkinColour, static_skin
from ...models.body.upper_body import PROPORTIONS, UpperBody
from ...models.core.frame import BoundingBox, Frame, GivenKeypoints
from ...models.face.detectors import HaarFaces, PartDetector, default_faces

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ClickedJoints:
    """Where joints are in a few frames."""

    path: Path  # of their file
    frames: NDArray[np.int64]  # `(n_frames,)` int64: numbers of the frames, from 1, in order
    places: Array  # `(n_frames, 8, 2)` px, in the order of `JOINTS`, NaN where a joint was not clicked


@dataclass(frozen=True, eq=False)
class MarkedFace:
    """A face that somebody has marked in one frame, as a detector that finds it there and nowhere else."""

    box: Array  # `(4,)` px: x, y, width, height
    number: int  # of the frame

    def __call__(self, frame: Frame) -> Array:
        """Boxes `(1, 4)` px in that frame, `(0, 4)` in all others."""
        return self.box[None] if frame.number == self.number else np.zeros((0, 4))


@dataclass(frozen=True, eq=False)
class BodyStart:
    """What is known of a person before the track starts."""

    parts: BodyParts  # the feature node, with the person's skin colour and a detector
    body: UpperBody  # lengths of the segments
    origin: str  # where the lengths come from, in a sentence

    def head_in(self, frame: Frame) -> Array | None:
        """`(2,)` px: the centre of the face that the detector finds in a frame; `None` if there is none."""
        found = np.zeros((0, 4)) if self.parts.detector is None else self.parts.detector(frame)
        return found[0, :2] + found[0, 2:] * (0.5, CENTRE_OF_BOX) if len(found) else None

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        if self.parts.skin is None:
            return [
                "The video is grey: there is no skin colour. Hands are followed by edges only, and in "
                "frames without a detected face everything is only predicted."
            ]
        return []


@dataclass(frozen=True, eq=False)
class SavedPerson:
    """A `BodyStart` as it is saved: detectors of faces are made anew from their settings."""

    person: BodyStart  # without a detector
    face_height: float | None  # px, size for which a detector of faces searches; `None` for any
    marked: MarkedFace | None  # the face that somebody has marked in place of a detector

    @classmethod
    def of(cls, start: BodyStart) -> Self:
        """As it can be saved."""
        detector = start.parts.detector
        return cls(
            replace(start, parts=replace(start.parts, detector=None)),
            detector.height if isinstance(detector, HaarFaces) else None,
            detector if isinstance(detector, MarkedFace) else None,
        )

    def elsewhere(self) -> Self:
        """The same person in another film, in which nobody has marked a face, and with whom is not known."""
        marked = None if self.marked is None else replace(self.marked, number=0)
        person = replace(self.person, parts=replace(self.person.parts, others=None))
        return replace(self, person=person, marked=marked)

    def start(self, detector: Path | None) -> BodyStart:
        """The start again, with a model file of a detector if there was one."""
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
    clicked: ClickedJoints | None,
    head: BoundingBox | None = None,
) -> BodyStart:
    """Find a person's face in some images, and learn size and colour from it.

    `name`: of the source; `images` `(height, width[, 3])` uint8 BGR, one at least; `detector`: model file of
    YuNet; OpenCV's cascade without it; `clicked`: joints from which the lengths are taken; `head`: x, y,
    width, height px of the person's head in the first image; without it, it is the person whose face is
    largest. Raises `ValueError` if there is no face or no detector, or the joints do not tell lengths that a
    person has; `FileNotFoundError` if there is no such model file.
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
    origin = "Usual proportions of a person whose head is as high as the detected faces say."
    return _start(parts, origin, clicked)


def start_from_head(
    first: Frame, head: BoundingBox, images: Sequence[Image], clicked: ClickedJoints | None
) -> BodyStart:
    """Learn size and colour from the head that somebody has marked in a frame.

    `first`: the frame, which has an image; `head`: x, y, width, height px: from chin to the top of the skull,
    and across; `images`: of the same size, from all over the clip; `clicked`: joints from which the lengths
    are taken. Raises `ValueError` if the head is not in the picture, or the joints do not tell lengths that a
    person has.
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
    return _start(parts, "Usual proportions of a person whose head is as high as the given one.", clicked)


def _face_of(head: BoundingBox) -> BoundingBox:
    """The box that a detector would give of a head."""
    x, y, width, height = head
    side = height / HEAD_OF_BOX
    return x + (width - side) / 2, y + height / 2 - CENTRE_OF_BOX * side, side, side


def _start(parts: BodyParts, origin: str, clicked: ClickedJoints | None) -> BodyStart:
    usual = UpperBody.from_head(parts.head_height)
    if clicked is None:
        return BodyStart(parts, usual, origin)
    n_frames = len(clicked.frames)
    try:
        body = UpperBody.fit(clicked.places, np.full(n_frames, parts.head_height))
    except ValueError as error:
        raise ValueError(f"{clicked.path}: {error}") from None
    if body == usual:
        raise ValueError(
            f"{clicked.path}: tells of no length, expected both ends of an arm's segment in one frame"
        )
    origin = f"Fitted to joints that were clicked in {n_frames} frames; what they leave open is as usual."
    return BodyStart(parts, body, origin)


MOST_FRAMES = 200  # from which lengths are taken, evenly spread over all


class FilmKeypoints(Protocol):
    """Key points of the persons in a film."""

    @property
    def path(self) -> Path:
        """File from which they are."""

    def frames(self) -> Iterable[tuple[int, GivenKeypoints]]:
        """Numbers of frames with the persons found there, in order."""


def shows_whom(frame: Frame) -> bool:
    """Whether head, neck or both shoulders of the largest person in a frame were found."""
    given = frame.keypoints
    return (
        given is not None
        and len(given) > 0
        and bool(np.isfinite(head_places(given, 0.0)[largest(given)]).all())
    )


def start_from_keypoints(
    first: Frame, keypoints: FilmKeypoints, images: Sequence[NDArray[np.uint8]], clicked: ClickedJoints | None
) -> BodyStart:
    """Learn size, lengths and colour from the points of the largest person in a frame.

    `first`: the frame, which has an image, and of which `shows_whom` holds; `keypoints`: of the whole film;
    `images`: of the same size, from all over the film; `clicked`: joints from which the lengths are taken, if
    there are any. Raises `ValueError` if the points do not tell how large the person is, or the head is not
    in the picture.
    """
    given = first.keypoints
    assert given is not None
    joints = followed(keypoints, first.number)
    try:
        height = UpperBody.fit(joints).head_height
    except ValueError as error:
        raise ValueError(f"{keypoints.path}: {error}: mark the head in the first frame with --head") from None
    (x, y), width = head_places(given, height)[largest(given)].tolist(), PROPORTIONS["head_width"] * height
    try:
        start = start_from_head(first, (x - width / 2, y - height / 2, width, height), images, clicked)
    except ValueError as error:
        raise ValueError(f"{keypoints.path}, frame {first.number}: {error}") from None
    return start if clicked else with_lengths(start, joints)


def with_lengths(start: BodyStart, joints: Array) -> BodyStart:
    """The same person with lengths from joints `(n, 8, 2)` px, if these tell lengths that a person has."""
    try:
        body = UpperBody.fit(joints, np.full(len(joints), start.parts.head_height))
    except ValueError:
        return start
    n_frames = len(joints)
    origin = f"Fitted to keypoints in {n_frames} frames; what they leave open is as usual."
    return replace(start, body=body, origin=origin)


def followed(keypoints: FilmKeypoints, first: int, head: Array | None = None) -> Array:
    """Joints of one person in some frames, from a frame on: of who is nearest to where the head was before.

    `keypoints`: of the film; `first`: number of the first frame; `head` `(2,)` px: where the person's head is
    there; the largest person, if it is not known. Returns `(n, 8, 2)` px, NaN where a joint was not found.
    """
    found = []
    for number, given in keypoints.frames():
        if number < first:
            continue
        places = head_places(given, 0.0)
        apart = np.full(len(given), np.inf) if head is None else np.linalg.norm(places - head, axis=1)
        apart = np.where(np.isnan(apart), np.inf, apart)
        person = largest(given) if head is None else int(apart.argmin())
        if head is None or np.isfinite(apart[person]):
            found.append(GivenKeypoints(given.positions[person, None], given.scores[person, None]))
            head = places[person] if np.isfinite(places[person]).all() else head
    chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), MOST_FRAMES)).round().astype(int))
    return np.concatenate([np.zeros((0, 8, 2)), *(joints_of(found[number]) for number in chosen)])

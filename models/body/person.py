"""Appearance of a person: one face among several, colours of the clothes, bare forearms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..core.checks import Count, Positive, Shape
from ..core.short_repr import short_repr
from .skin import N_BINS, SkinColour, count_colours, has_colour, log_count_ratio, look_up

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Map = NDArray[np.float32]

ALIKE = 1.4  # ratio of heights of two faces of one person, at most
APART = 2.0  # face heights that a person moves at most from one image to the next
SWAY = 0.5  # face heights: standard deviation of others' faces about the positions where they were seen


@short_repr
@dataclass(frozen=True, eq=False)
class OtherFaces:
    """Faces of other people: clutter that stays."""

    # px: middles of all others' faces in some images
    places: Annotated[Array, Shape("m", 2)]
    pictures: Count  # how many images
    std: Positive  # px: standard deviation about these

    @classmethod
    def learned(cls, faces: Sequence[Array], own: Sequence[int | None]) -> Self:
        """Collect the other faces, of `(k, 4)` px an image, in the images with the person's own one."""
        seen = [(boxes, one) for boxes, one in zip(faces, own, strict=True) if one is not None]
        rest = np.concatenate([np.delete(boxes, one, axis=0) for boxes, one in seen])
        height = np.median([boxes[one, 3] for boxes, one in seen])
        return cls(rest[:, :2] + 0.5 * rest[:, 2:], len(seen), float(SWAY * height))

    def density(self, places: Array) -> Array:
        """`(n,)` expected faces of others per px^2 and image at places `(n, 2)` px."""
        squares = ((places[:, None] - self.places) ** 2).sum(axis=2) / self.std**2
        total = np.exp(-0.5 * squares).sum(axis=1)
        return np.asarray(total / (2 * np.pi * self.std**2 * self.pictures), np.float64)


def track_face(faces: Sequence[Array], start: tuple[int, int]) -> list[int | None]:
    """Return the index of a person's face in every image, `None` where there is none.

    From image to image it is the nearest face of about the same size within `APART`, forwards to the last
    image, then backwards to the first.

    `faces`: by image, `(k, 4)` px: boxes x, y, width, height; k may be 0; `start`: image and face to begin
    with.
    """
    chosen: list[int | None] = [None] * len(faces)
    first, face = start
    chosen[first] = face
    for order in (range(first + 1, len(faces)), range(first - 1, -1, -1)):
        last = faces[first][face]
        for picture in order:
            chosen[picture] = _nearest(faces[picture], last)
            if chosen[picture] is not None:
                last = faces[picture][chosen[picture]]
    return chosen


def find_largest_face(faces: Sequence[Array]) -> tuple[int, int]:
    """Return image and index of a face of the largest person: the median of the images' largest faces.

    Raises `ValueError` if there is no face.
    """
    largest = [
        (float(boxes[:, 3].max()), picture, int(boxes[:, 3].argmax()))
        for picture, boxes in enumerate(faces)
        if len(boxes)
    ]
    if not largest:
        raise ValueError(f"faces: got none in {len(faces)} images, expected one at least")
    _, picture, face = sorted(largest)[len(largest) // 2]
    return picture, face


def find_face_at(faces: Sequence[Array], box: Array) -> tuple[int, int]:
    """Return image and index of the face nearest to a box `(4,)` px, in the first image with any.

    Raises `ValueError` if there is no face.
    """
    for picture, boxes in enumerate(faces):
        if len(boxes):
            return picture, int(_distances(boxes, box).argmin())
    raise ValueError(f"faces: got none in {len(faces)} images, expected one at least")


def _nearest(boxes: Array, last: Array) -> int | None:
    distances = _distances(boxes, last)
    alike = np.abs(np.log(boxes[:, 3] / last[3])) < np.log(ALIKE)
    alike &= distances < APART * last[3]
    return int(np.where(alike, distances, np.inf).argmin()) if alike.any() else None


def _distances(boxes: Array, box: Array) -> Array:
    """`(k,)` px between middles."""
    steps = boxes[:, :2] + 0.5 * boxes[:, 2:] - box[:2] - 0.5 * box[2:]
    return np.asarray(np.linalg.norm(steps, axis=1), np.float64)


TRUNK = (0.5, 1.0, 2.3)
"""Head heights from the head's centre: half the width of the part of the trunk that is used, its upper and
its lower end. Most of it is clothes, in spite of arms and hands."""

ELSEWHERE = (1.3, 0.8)  # head heights: farther to the side or higher is background
SHRINK = 0.5  # size of the map over that of the image
BLUR = 0.06  # head heights: of the map; a sleeve is three times as broad


@short_repr
@dataclass(frozen=True, eq=False)
class ClothesColour:
    """Log ratio of colours on the trunk against elsewhere in the image."""

    table: Annotated[NDArray[np.float32], Shape(8, 64, 64)]  # as that of `SkinColour`

    @classmethod
    def learned(
        cls, images: Sequence[Image], heads: Array, head_height: float, skin: SkinColour
    ) -> Self | None:
        """Learn from images in which the person's head is known.

        `images`: n of them, `(height, width, 3)` uint8 BGR; `heads` `(n, 2)` px: centres; `head_height`: px;
        `skin`: of the person, which is left out. Returns `None` if no image has colours or shows the trunk.
        """
        on, off = np.zeros(N_BINS), np.zeros(N_BINS)
        for image, (x, y) in zip(images, heads, strict=True):
            if not has_colour(image):
                continue
            rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
            across, down = np.abs(columns - x) / head_height, (rows - y) / head_height
            trunk = (across < TRUNK[0]) & (down > TRUNK[1]) & (down < TRUNK[2])
            on += count_colours(image, trunk & (skin.log_odds(image) < 0))
            off += count_colours(image, (across > ELSEWHERE[0]) | (down < -ELSEWHERE[1]))
        if not (on.any() and off.any()):
            return None
        return cls(log_count_ratio(on, off))

    def arm_map(self, colours: Image, head_height: float) -> Map:
        """Return the log odds of a sleeve against background, half as large as the image and smoothed.

        `colours` `(height, width, 3)` uint8: the `smoothed` image; `head_height`: px.
        """
        odds = look_up(self.table, colours)
        half = cv2.resize(odds, None, fx=SHRINK, fy=SHRINK, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(half, (0, 0), BLUR * SHRINK * head_height), np.float32)


IN_SLEEVE, WITH_FOREARM = 0.65, 1.9
"""Discs of a hand's radius: skin that a hand alone shows (0.55 to 0.8), and with a forearm, whose own 1.4
discs are mostly foreshortened."""

BETWEEN_PEOPLE, BETWEEN_FRAMES = 0.2, 0.4  # standard deviations of log areas
SURELY_LESS = 3.0  # standard deviations below the mean area of a hand from which a patch is none
SURE = 0.02  # probabilities within this of 0 or 1 are rounded to it
SKIN_FROM = 1.0  # nats: log odds from which a pixel counts
HEAD_MARGIN = 1.15  # factor of the ellipses of head and neck, whose rims are no hands
REACH = 3.2  # head heights: distance of hands from the head's centre at most


def bare_probability(areas: Sequence[float]) -> float:
    """Return the probability of bare forearms, from `hand_area` of some frames.

    Log areas are normal about one of two means, with a deviation of the person and one of each frame; the
    frames' median is used, without those in which no patch is as large as a hand. The prior is even.
    """
    least = IN_SLEEVE * np.exp(-SURELY_LESS * np.hypot(BETWEEN_PEOPLE, BETWEEN_FRAMES))
    seen = [area for area in areas if area > least]
    if not seen:
        return 0.5
    low, high = np.log(IN_SLEEVE), np.log(WITH_FOREARM)
    variance = BETWEEN_PEOPLE**2 + BETWEEN_FRAMES**2 / len(seen)
    log_odds = (np.log(np.median(seen)) - 0.5 * (low + high)) * (high - low) / variance
    probability = float(expit(log_odds))
    return 0.0 if probability < SURE else 1.0 if probability > 1 - SURE else probability


def hand_area(skin: Map, heads: Array, radius: float, head_height: float) -> float:
    """Return the area of the largest patch of skin beside heads, in discs of a hand's radius, or 0.

    `skin` `(height, width)` float32 nats: log odds of skin; `heads` `(k, 4)` px, of one person: ellipses,
    centre x, y and half axes, of head and neck; the head first; `radius`, `head_height`: px.
    """
    beside = np.asarray(skin > SKIN_FROM, np.uint8)
    near = np.zeros_like(beside)
    x, y = heads[0, :2]
    cv2.circle(near, (round(x), round(y)), round(REACH * head_height), 1, cv2.FILLED)
    for x, y, across, down in heads:
        cv2.ellipse(near, ((x, y), (2 * HEAD_MARGIN * across, 2 * HEAD_MARGIN * down), 0.0), 0, cv2.FILLED)
    # single pixels do not join patches
    patches = cv2.morphologyEx(beside & near, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, _, statistics, _ = cv2.connectedComponentsWithStats(patches)
    largest = statistics[1:, cv2.CC_STAT_AREA].max(initial=0)
    return float(largest / (np.pi * radius**2))

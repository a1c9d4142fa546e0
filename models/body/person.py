"""What identifies a person in the picture: the face, colours of the clothes, whether forearms are bare."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..core.short_repr import short_repr
from .kernels import blended
from .skin import N_BINS, SkinColour, count_colours, has_colour, log_count_ratio, look_up

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Map = NDArray[np.float32]

ALIKE = 1.4  # of two faces of one person, the higher one is at most so many times as high
APART = 2.0  # face heights that a person has moved at most from one picture to the next
SWAY = 0.5  # face heights: standard deviation of faces about the places where they were seen


@short_repr
@dataclass(frozen=True, eq=False)
class OtherFaces:
    """Where faces of others are seen: to the person who is tracked, they are false ones that stay."""

    places: Array  # `(m, 2)` px: middles of all others' faces in some pictures
    pictures: int  # how many
    spread: float  # px: standard deviation about these

    @classmethod
    def learned(cls, found: Sequence[Array], own: Sequence[int | None]) -> Self:
        """From the faces `(k, 4)` px of some pictures, of those in which the person's own one is found, too:
        anywhere else, a face may be the person's.
        """
        seen = [(boxes, one) for boxes, one in zip(found, own, strict=True) if one is not None]
        rest = np.concatenate([np.delete(boxes, one, axis=0) for boxes, one in seen])
        height = np.median([boxes[one, 3] for boxes, one in seen])
        return cls(rest[:, :2] + 0.5 * rest[:, 2:], len(seen), float(SWAY * height))

    def density(self, places: Array) -> Array:
        """`(n,)` expected faces of others a px^2 and picture at places `(n, 2)` px."""
        squares = ((places[:, None] - self.places) ** 2).sum(axis=2) / self.spread**2
        total = np.exp(-0.5 * squares).sum(axis=1)
        return np.asarray(total / (2 * np.pi * self.spread**2 * self.pictures), np.float64)


def track_face(found: Sequence[Array], start: tuple[int, int]) -> list[int | None]:
    """Number of a person's face in every picture, `None` where it has none.

    From one picture to the next, it is the nearest face of about the same size that is not too far, first on
    to the last picture, then back to the first.

    `found`: by picture, `(k, 4)` px: boxes x, y, width, height; k may be 0; `start`: picture and face to
    begin with.
    """
    chosen: list[int | None] = [None] * len(found)
    first, face = start
    chosen[first] = face
    for order in (range(first + 1, len(found)), range(first - 1, -1, -1)):
        last = found[first][face]
        for picture in order:
            chosen[picture] = _nearest(found[picture], last)
            if chosen[picture] is not None:
                last = found[picture][chosen[picture]]
    return chosen


def find_largest_face(found: Sequence[Array]) -> tuple[int, int]:
    """Picture and number of the face with which the person that is seen largest begins.

    Of the largest faces of all pictures it is the one of median height: a false one may be higher.

    Raises `ValueError` if there is no face.
    """
    largest = [
        (float(boxes[:, 3].max()), picture, int(boxes[:, 3].argmax()))
        for picture, boxes in enumerate(found)
        if len(boxes)
    ]
    if not largest:
        raise ValueError(f"found: got no face in {len(found)} pictures, expected one at least")
    _, picture, face = sorted(largest)[len(largest) // 2]
    return picture, face


def find_face_at(found: Sequence[Array], box: Array) -> tuple[int, int]:
    """Picture and number of the face that is nearest to a box `(4,)` px, in the first picture with any.

    Raises `ValueError` if there is no face.
    """
    for picture, boxes in enumerate(found):
        if len(boxes):
            return picture, int(_distances(boxes, box).argmin())
    raise ValueError(f"found: got no face in {len(found)} pictures, expected one at least")


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
"""Head heights from the head's centre: half the width of the part of the trunk that is looked at, its upper
and its lower end. Arms and hands before it do no harm: most of it is clothes."""

ELSEWHERE = (1.3, 0.8)  # head heights: further to the side or higher than this is not the trunk
SHRINK = 0.5  # the map of a picture is so much smaller
BLUR = 0.06  # head heights: of the map; a sleeve is three times as broad


@short_repr
@dataclass(frozen=True, eq=False)
class ClothesColour:
    """How much more often colours are seen on the trunk than elsewhere in the picture."""

    table: NDArray[np.float32]  # as that of `SkinColour`

    @classmethod
    def learned(
        cls, images: Sequence[Image], heads: Array, head_height: float, skin: SkinColour
    ) -> Self | None:
        """Learn from images in which the person's head is known.

        `images`: n of them, `(height, width, 3)` uint8 BGR; `heads` `(n, 2)` px: centres; `head_height`: px;
        `skin`: of the person, which is no clothes. Returns `None` if no image has colours or shows the trunk.
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

    def arm_map(self, colours: Image, head_height: float, skin: Map, bare: float) -> Map:
        """Log odds of an arm against anything else, half as large as the image and smoothed.

        `colours` `(height, width, 3)` uint8: the `smoothed` image; `head_height`: px; `skin`
        `(height, width)` nats: log odds of skin in it; `bare`: probability that arms are bare.
        """
        odds = look_up(self.table, colours)
        if bare > 0:
            blended(odds.reshape(-1), skin.reshape(-1), 1 - min(bare, 0.999), bare)
        half = cv2.resize(odds, None, fx=SHRINK, fy=SHRINK, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(half, (0, 0), BLUR * SHRINK * head_height), np.float32)


IN_SLEEVE, WITH_FOREARM = 0.65, 1.9
"""Discs of a hand's radius: skin that a hand alone shows (0.55 to 0.8), and with a forearm, whose own 1.4
discs are mostly seen from aslant."""

BETWEEN_PEOPLE, BETWEEN_FRAMES = 0.2, 0.4  # standard deviations of logs: of people, and of frames
SURE = 0.02  # probabilities that are less than that, or that far from 1, are taken for 0 and 1
SKIN_FROM = 1.0  # nats: log odds from which a pixel counts
HEAD_MARGIN = 1.15  # over the ellipses of head and neck: what is left of their rims is no hand
REACH = 3.2  # head heights from the head's centre: as far as hands are


def bare_probability(areas: Sequence[float]) -> float:
    """Probability that forearms are bare, from `hand_area` of some frames.

    Logs of areas are normal about one of two means, with what is common to all frames and what is not; of
    that the frames' median is taken. Both are as probable before; with no area, they stay so.
    """
    seen = [area for area in areas if area > 0]
    if not seen:
        return 0.5
    low, high = np.log(IN_SLEEVE), np.log(WITH_FOREARM)
    variance = BETWEEN_PEOPLE**2 + BETWEEN_FRAMES**2 / len(seen)
    log_odds = (np.log(np.median(seen)) - 0.5 * (low + high)) * (high - low) / variance
    probability = float(expit(log_odds))
    return 0.0 if probability < SURE else 1.0 if probability > 1 - SURE else probability


def hand_area(skin: Map, heads: Array, radius: float, head_height: float) -> float:
    """Area of the largest patch of skin beside heads, in discs of a hand's radius; 0 without any.

    `skin` `(height, width)` float32 nats: log odds of skin; `heads` `(k, 4)` px, of one person: ellipses,
    centre x, y and half axes, of head and neck; the head first; `radius`, `head_height`: px.
    """
    beside = np.asarray(skin > SKIN_FROM, np.uint8)
    near = np.zeros_like(beside)
    x, y = heads[0, :2]
    cv2.circle(near, (round(x), round(y)), round(REACH * head_height), 1, cv2.FILLED)
    for x, y, across, down in heads:
        cv2.ellipse(near, ((x, y), (2 * HEAD_MARGIN * across, 2 * HEAD_MARGIN * down), 0.0), 0, cv2.FILLED)
    # single pixels do not tie patches together
    patches = cv2.morphologyEx(beside & near, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, _, statistics, _ = cv2.connectedComponentsWithStats(patches)
    largest = statistics[1:, cv2.CC_STAT_AREA].max(initial=0)
    return float(largest / (np.pi * radius**2))

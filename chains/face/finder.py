"""Where a face is found anew: by a detector, in the picture turned upright, near a pose and all over it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.detectors import PartDetector, for_height
from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import Poses
from .search import rolls

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

WIDTH_OF_FACE = 0.85
"""Of a detector's box: what lies between the ears, which a model of a face spans."""

FACE = 52.0
"""px: width of a face's box in the pictures that a detector is given: twice what cascades were trained at."""

AROUND = 2.0
"""Side of the picture about a pose, in widths of the face's box."""

OFF = 0.2
"""How far the middle of a box may be from that of a face which it confirms, in its widths."""

SIZES = 0.7, 1.45
"""Of a box that confirms a face, in its widths."""

HERE, ANYWHERE = 1, 4
"""Neighbouring detections of a cascade that make one face: where one is known to have been, and all over a
picture. At 2400 places of films without faces four were confirmed."""

TURNS = (0.0, 0.45, -0.45)
"""rad by which a lost face is looked for turned in the picture's plane, from how it was seen last and from
upright, one in each picture: detectors find faces up to about 0.3 rad from upright."""

LARGEST = 640
"""px: longer side of the picture in which a lost face is looked for."""


class Finder(Protocol):
    """Anything that knows where an object is without having followed it."""

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Whether the object is about where one pose has it."""
        ...

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Poses that it may have, the likeliest first, perhaps none.

        `last` is the pose that it had when it was last seen, `attempt` counts the pictures since, from 0.
        """
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class DetectedFace(PickledByFields):
    """A face that a detector finds.

    Parameters
    ----------
    model
        of the person.
    detector
        of faces.
    """

    model: MorphableModel
    detector: PartDetector

    @cached_property
    def _here(self) -> PartDetector:
        return for_height(self.detector, FACE, HERE)

    @cached_property
    def _anywhere(self) -> PartDetector:
        return for_height(self.detector, FACE, ANYWHERE)

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Whether the detector finds a face in the picture about the pose, turned upright."""
        middle, width = self._box(pose)
        view = UprightView.of(middle, float(rolls(pose)[0]), FACE / width, (round(AROUND * FACE),) * 2)
        boxes = self._here(Frame(view.drawn(image), 0.0, 1))
        off = np.abs(boxes[:, :2] + boxes[:, 2:] / 2 - np.array(view.size) / 2).max(axis=1, initial=0)
        size = boxes[:, 2] / FACE
        return bool(((off < OFF * FACE) & (size > SIZES[0]) & (size < SIZES[1])).any())

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Poses in the boxes that the detector finds in the picture turned by an angle, another each time."""
        turn = TURNS[attempt // 2 % len(TURNS)] + (float(rolls(last)[0]) if attempt % 2 == 0 else 0.0)
        _, width = self._box(last)
        height, across = image.shape[:2]
        scale = min(FACE / width, LARGEST / max(height, across))
        size = np.abs(np.array([[np.cos(turn), np.sin(turn)], [np.sin(turn), np.cos(turn)]])) @ (
            across,
            height,
        )
        middle = np.array([across - 1, height - 1]) / 2
        wide, high = np.ceil(scale * size).astype(int).tolist()
        view = UprightView.of(middle, turn, scale, (wide, high))
        return view.poses(self.model, self._anywhere(Frame(view.drawn(image), 0.0, 1)))

    def _box(self, pose: Poses) -> tuple[Array, float]:
        """Middle and width, px, of the box that a detector would draw about a face."""
        places = self.model.project(pose)[0]
        typical = self.model.bases[0, :, 0]
        width = float(pose.sizes[0] * np.ptp(typical)) / WIDTH_OF_FACE
        return (places.min(axis=0) + places.max(axis=0)) / 2, width


@dataclass(frozen=True, eq=False)
class UprightView:
    """A part of a picture, turned and scaled.

    Parameters
    ----------
    matrix
        `(2, 3)`: from places of the picture to those of the view, px.
    size
        `(width, height)` px of the view.
    """

    matrix: Array
    size: tuple[int, int]

    @classmethod
    def of(cls, middle: Array, turn: float, scale: float, size: tuple[int, int]) -> Self:
        """With `middle` of the picture in its middle; what leans clockwise by `turn` rad is upright in it."""
        linear = scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        centre = (np.array(size) - 1) / 2
        return cls(np.column_stack([linear, centre - linear @ middle]), size)

    @property
    def scale(self) -> float:
        """Px of the view per px of the picture."""
        return float(np.hypot(*self.matrix[0, :2]))

    def drawn(self, image: Image) -> Image:
        """What it shows of a picture; beyond its edges they go on."""
        if self.scale < 1:  # of what is finer than the view's pixels nothing must be left
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 / self.scale), np.uint8)
        drawn = cv2.warpAffine(image, self.matrix, self.size, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(drawn, np.uint8)

    def poses(self, model: MorphableModel, boxes: Array) -> Poses:
        """The typical shape upright in boxes `(n, 4)` px of the view, as the picture has it."""
        upright = poses_in_boxes(model, boxes)
        back = np.linalg.inv(self.matrix[:, :2])
        turn = np.eye(3)
        turn[:2, :2] = back * self.scale
        places = (upright.translations - self.matrix[:, 2]) @ back.T
        return Poses(turn @ upright.rotations, places, upright.morphs / self.scale)


def poses_in_boxes(model: MorphableModel, boxes: Array) -> Poses:
    """The typical shape upright in boxes `(n, 4)` px of faces: x, y, width, height."""
    low, high = model.bases[0, :, :2].min(axis=0), model.bases[0, :, :2].max(axis=0)
    sizes = WIDTH_OF_FACE * boxes[:, 2] / (high[0] - low[0])
    centres = boxes[:, :2] + boxes[:, 2:] / 2
    return Poses.upright(centres - sizes[:, None] * (low + high) / 2, sizes, model.n_bases)

"""Affine maps from a scene's picture to a frame of a camera that moves."""

from dataclasses import dataclass
from typing import Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.frame import BoundingBox
from ..core.short_repr import short_repr

Numbers = NDArray[np.float64]
Image = NDArray[np.uint8]
Value = TypeVar("Value", np.uint8, np.float32)

UNKNOWNS = 6
"""Numbers of an affine map."""


@short_repr
@dataclass(frozen=True, eq=False)
class AffineMap:
    """Where the places of a scene's picture are seen in a frame of the same size.

    A place x, with (u, v) = (x - middle) / radius, is seen at x + (p0 + p1 u + p2 v, p3 + p4 u + p5 v); the
    radius is half the picture's diagonal. All six numbers are therefore in px, and none moves a place of the
    picture by more than its own amount.

    Parameters
    ----------
    parameters
        `(6,)` float64 px: p0 to p5.
    size
        `(height, width)` px of scene and frame.
    """

    parameters: Numbers
    size: tuple[int, int]

    @classmethod
    def identity(cls, size: tuple[int, int]) -> Self:
        """The map of a camera that looks where it did."""
        return cls(np.zeros(UNKNOWNS), size)

    @property
    def middle(self) -> tuple[float, float]:
        """Of the picture, px."""
        return (self.size[1] - 1) / 2, (self.size[0] - 1) / 2

    @property
    def radius(self) -> float:
        """Half the diagonal, px."""
        return float(np.hypot(*self.size)) / 2

    @property
    def matrix(self) -> Numbers:
        """`(2, 3)`: the same map of places (x, y, 1)."""
        rows = self.parameters.reshape(2, 3)
        linear = np.eye(2) + rows[:, 1:] / self.radius
        middle = np.array(self.middle)
        return np.column_stack([linear, middle + rows[:, 0] - linear @ middle])

    @property
    def displacement(self) -> float:
        """px by which places of the picture are moved: root of the mean square over all of it."""
        shares = (np.array([self.size[1], self.size[0]]) / (2 * self.radius)) ** 2 / 3
        rows = self.parameters.reshape(2, 3) ** 2
        return float(np.sqrt((rows[:, 0] + rows[:, 1:] @ shares).sum()))

    def points(self, places: NDArray[np.float64]) -> Numbers:
        """Where places `(..., 2)` of the scene are seen in the frame, px."""
        matrix = self.matrix
        return places @ matrix[:, :2].T + matrix[:, 2]

    def box(self, box: BoundingBox) -> BoundingBox:
        """Where the frame shows a box (x, y, width, height) of the scene: upright, about the same middle.

        Boxes have the pixels' edges at whole numbers.
        """
        x, y, width, height = box
        (middle_x, middle_y) = self.points(np.array([x + width / 2 - 0.5, y + height / 2 - 0.5])) + 0.5
        across, down = np.hypot(*self.matrix[:, :2])
        width, height = width * float(across), height * float(down)
        return float(middle_x) - width / 2, float(middle_y) - height / 2, width, height

    def in_scene(self, image: Image, beyond: Image) -> Image:
        """A frame's image as the scene's picture: what every place of the scene shows.

        Parameters
        ----------
        image
            `(height, width[, 3])` uint8.
        beyond
            of the same shape: what is taken where the frame does not show the scene.
        """
        out = beyond.copy()
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        cv2.warpAffine(
            image, self.matrix, self.size[::-1], dst=out, flags=flags, borderMode=cv2.BORDER_TRANSPARENT
        )
        return out

    @property
    def shown(self) -> NDArray[np.bool_]:
        """`(height, width)`: places of the scene that lie in the frame."""
        frame = np.ones(self.size, np.uint8)
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(frame, self.matrix, self.size[::-1], flags=flags), bool)

    def in_frame(self, mask: NDArray[Value]) -> NDArray[Value]:
        """What is said of the scene's places, `(height, width)`, as the frame shows it; 0 beyond."""
        seen = cv2.warpAffine(mask, self.matrix, self.size[::-1], flags=cv2.INTER_NEAREST)
        return np.asarray(seen, mask.dtype)

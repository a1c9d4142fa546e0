"""Boxes of objects as a feature node: where each one stands and how large it looks, by identity.

This is where what follows single objects through the pixels meets what knows the scene that they move in.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.drawing import FARTHEST, draw_region
from ..core.frame import Frame
from ..core.gaussian_message import GaussianMessage
from ..core.short_repr import short_repr

FOOT_X, FOOT_Y, WIDTH, HEIGHT = range(4)
"""Order of a box's numbers (px): middle of its bottom edge, as column and row, then its size."""

BOX = 4

COLOUR = (255, 190, 40)
"""BGR, of boxes that are drawn."""


@short_repr
@dataclass(frozen=True)
class ObjectBoxes:
    """Feature node of the boxes of objects, shared by trackers and by what knows the scene.

    Its messages hold a Gaussian over the four numbers of each object's box. Images say nothing of them by
    themselves: what they show of objects comes through the chain that also speaks to the pixels.
    """

    name: str = "objects"

    searches = False

    def uniform(self) -> GaussianMessage:
        """The message that mentions no object."""
        return GaussianMessage.uniform(BOX)

    def evidence(self, frame: Frame, prior: GaussianMessage) -> GaussianMessage:
        """Nothing."""
        return self.uniform()

    def draw(self, picture: NDArray[np.uint8], belief: GaussianMessage) -> None:
        """Draw the mean boxes into a BGR picture, and where their feet are to 90 %."""
        _, means, covariances = belief.moments
        for (x, y, width, height), covariance in zip(means, covariances, strict=True):
            left, top = (max(round(each), -FARTHEST) for each in (x - width / 2, y - height))
            right, bottom = (min(round(each), FARTHEST) for each in (x + width / 2, y))
            cv2.rectangle(picture, (left, top), (right, bottom), COLOUR, 1)
            draw_region(picture, np.array([x, y]), covariance[:2, :2], COLOUR)

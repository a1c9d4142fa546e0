"""Boxes of objects as a feature node: where each one stands and how large it looks, by identity.

This is where what follows single objects through the pixels meets what knows the scene that they move in, and
what a detector has found of them.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.frame import Frame
from ..core.pictures import FARTHEST, draw_region
from ..core.short_repr import short_repr
from .association import associate
from .box_message import BoxDetector, BoxMessage

COLOUR = (255, 190, 40)
"""BGR, of boxes that are drawn."""


@short_repr
@dataclass(frozen=True)
class ObjectBoxes:
    """Feature node of the boxes of objects, shared by trackers, by what knows the scene, and by detectors.

    An image says nothing of boxes by itself: what it shows of objects comes through the chain that also
    speaks to the pixels. A frame that comes with the boxes of a detector does.

    Parameters
    ----------
    detector
        how the detector behaves, as long as no chain knows it better.
    """

    detector: BoxDetector = field(default_factory=BoxDetector)
    name: str = "objects"

    searches = True

    def uniform(self) -> BoxMessage:
        """The message that mentions no object."""
        return BoxMessage()

    def evidence(self, frame: Frame, prior: BoxMessage) -> BoxMessage:
        """Likelihood of what the detector has found, given the objects that `prior` knows (see `associate`).

        Where the detector did not run, nothing is said; where it ran and found nothing, everybody who should
        have been found is there less likely.
        """
        if frame.boxes is None:
            return self.uniform()
        return associate(frame, prior, prior.detector or self.detector)

    def draw(self, picture: NDArray[np.uint8], belief: BoxMessage) -> None:
        """Draw the mean boxes into a BGR picture, and where their feet are to 90 %."""
        _, means, covariances = belief.objects.moments
        for (x, y, width, height), covariance in zip(means, covariances, strict=True):
            left, top = (max(round(each), -FARTHEST) for each in (x - width / 2, y - height))
            right, bottom = (min(round(each), FARTHEST) for each in (x + width / 2, y))
            cv2.rectangle(picture, (left, top), (right, bottom), COLOUR, 1)
            draw_region(picture, np.array([x, y]), covariance[:2, :2], COLOUR)

"""Boxes of objects as a feature node: where each one stands and how large it looks, by identity.

This is where what follows single objects through the pixels meets what knows the scene that they move in, and
what a detector has found of them.
"""

from dataclasses import dataclass, field

from ..core.checks import checked
from ..core.frame import Frame
from ..core.short_repr import short_repr
from .association import associate
from .box_message import BoxDetector, BoxMessage


@short_repr
@checked
@dataclass(frozen=True)
class ObjectBoxes:
    """Feature node of the boxes of objects, shared by trackers, ground planes and detectors.

    Images are evidence about boxes only through chains that also read the pixels, or by the boxes of a
    detector.

    Parameters
    ----------
    detector
        error model of the detector, if no chain estimates it.
    """

    detector: BoxDetector = field(default_factory=BoxDetector)
    name: str = "objects"

    searches = True

    def uniform(self) -> BoxMessage:
        """Return the message without objects."""
        return BoxMessage()

    def evidence(self, frame: Frame, prior: BoxMessage) -> BoxMessage:
        """Return the likelihood of the detector's boxes, given the objects of `prior` (see `associate`).

        Uniform if the detector did not run. If it ran and found nothing, visible objects become less likely.
        """
        if frame.boxes is None:
            return self.uniform()
        return associate(frame, prior, prior.detector or self.detector)

"""Boxes of objects as a feature node: where each one stands and how large it looks, by identity.

This is where what follows single objects through the pixels meets what knows the scene that they move in.
"""

from dataclasses import dataclass

from ..core.frame import Frame
from ..core.gaussian_message import GaussianMessage

FOOT_X, FOOT_Y, WIDTH, HEIGHT = range(4)
"""Order of a box's numbers (px): middle of its bottom edge, as column and row, then its size."""

BOX = 4


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

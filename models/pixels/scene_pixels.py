"""Pixels of a scene that a moving camera shows, as a feature node."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.frame import Frame
from ..core.short_repr import short_repr
from .pixel_labels import PixelLabels, PixelMessage, tint


@short_repr
@dataclass(frozen=True)
class ScenePixels(PixelLabels):
    """Labels and colours of the scene's pixels, and the map by which a frame shows them.

    All chains that meet `PixelLabels` meet it. Where a chain says how the camera may look (`View`), the
    evidence is the frame registered there: an image in which the scene stays where it is, and the likelihood
    of the map. Without such a chain it is the frame as it is.
    """

    searches = True

    def evidence(self, frame: Frame, prior: PixelMessage) -> PixelMessage:
        """The image as the scene's picture, and where it was found."""
        if frame.image is None or prior.view is None:
            return PixelMessage(image=frame.image)
        view, image = prior.view.register(frame.image)
        return PixelMessage(image=image, view=view)

    def draw(self, picture: NDArray[np.uint8], belief: PixelMessage) -> None:
        """Tint a BGR picture of the frame by P(B=0)."""
        foreground = 1 - belief.background_probability()
        tint(picture, foreground if belief.view is None else belief.view.map.in_frame(foreground))

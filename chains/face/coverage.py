"""Which pixels an object covers as its experts see it, and what that tells others of the pixels."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import Poses
from ...models.face.visibility import Box, covered
from ...models.pixels.layers import Layer, LayerStack

Map = NDArray[np.float32]

MARGIN = 4
"""px about the object in which its model may be wrong, and nothing is learned of the background."""

LEAST_SHARE = 1e-3
"""Weight of the experts who say that a pixel is covered, from which on it may be."""

STRENGTH = 100.0
"""How much likelier the object is to be where it is followed than something that nobody knows."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Pixels that an object covers.

    Parameters
    ----------
    box
        that holds the object, with a margin.
    inside
        `(n_experts, height, width)`: 1 where the object covers the pixel as an expert sees it, else 0.
    share
        `(height, width)` float32 of the box: probability that the object covers the pixel.
    """

    box: Box
    inside: NDArray[np.uint8]
    share: Map

    @classmethod
    def of(
        cls,
        model: MorphableModel,
        poses: Poses,
        weights: NDArray[np.float64],
        size: tuple[int, int],
        margin: float = 2 * MARGIN,
    ) -> "Coverage":
        """Of experts in `poses`, in a picture of `size` `(height, width)`; the box has a `margin` px wide."""
        positions = model.project(poses)
        box = Box.around(positions, margin, size)
        inside = covered(positions, model.triangles, box)
        share = np.tensordot(weights.astype(np.float32), inside.astype(np.float32), 1)
        return cls(box, inside, np.asarray(share, np.float32))

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """`(height, width)`: whether a likely expert, or the model's error, may cover the pixel."""
        return widened(self.share > LEAST_SHARE)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """`(height, width)`: whether the pixel is the object's, well inside its outline."""
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
        inner: NDArray[np.bool_] = cv2.erode((self.share > 0.5).astype(np.uint8), disc) > 0
        return inner

    def layers(self, trust: Map | None) -> LayerStack:
        """What is said of the pixels: the object, and that there is none where it was until now.

        The second is a ghost where nothing has been known of the background, by its `trust` of the whole
        picture, and the object is not: what the background remembers there is the object itself. Colours
        are left out: textures are grey and without the light, and backgrounds judge by colours.
        """
        mask = cv2.dilate(self.share, np.ones((3, 3), np.uint8))
        layer = Layer(self.box.top, self.box.left, np.asarray(mask, np.float32), None, strength=STRENGTH)
        if trust is None:
            return LayerStack((layer,))
        rows, columns = np.flatnonzero((trust <= 0).any(axis=1)), np.flatnonzero((trust <= 0).any(axis=0))
        if not len(rows):
            return LayerStack((layer,))
        top, left = int(rows[0]), int(columns[0])
        free = trust[top : rows[-1] + 1, left : columns[-1] + 1] == 0
        hidden = np.zeros(trust.shape, np.bool_)
        hidden[self.box.window] = self.hidden
        free &= ~hidden[top : rows[-1] + 1, left : columns[-1] + 1]
        if not free.any():
            return LayerStack((layer,))
        return LayerStack((layer, Layer(top, left, free.astype(np.float32), None, ghost=True)))


def widened(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask with a margin of `MARGIN` px."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
    wide: NDArray[np.bool_] = cv2.dilate(mask.astype(np.uint8), disc) > 0
    return wide

"""What colours a person's clothes have, learned from the trunk: sleeves are expected to have them.

Outlines alone say little of where an arm is; that it has to lead there in the colour of the clothes, and not
of the wall, says much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .kernels.skin_colour import blended
from .skin_colour import N_BINS, SkinColour, colour_counts, has_colour, log_ratio_of, looked_up_in

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Map = NDArray[np.float32]

TRUNK = (0.5, 1.0, 2.3)
"""Head heights from the head's centre: half the width of the part of the trunk that is looked at, its upper
and its lower end. Arms and hands before it do no harm: most of it is clothes."""

ELSEWHERE = (1.3, 0.8)
"""Head heights: what is further to the side than the first, or higher than the second, is not the trunk."""

SHRINK = 0.5
"""The map of a picture is so much smaller."""

BLUR = 0.06
"""Head heights: of the map; a sleeve is three times as broad."""


@short_repr
@dataclass(frozen=True, eq=False)
class ClothesColour:
    """How much more often colours are seen on the trunk than elsewhere in the picture.

    Parameters
    ----------
    table
        as that of `SkinColour`.
    """

    table: NDArray[np.float32]

    @classmethod
    def learned(
        cls, images: Sequence[Image], heads: Array, head_height: float, skin: SkinColour
    ) -> Self | None:
        """Learn from images in which the person's head is known.

        Parameters
        ----------
        images
            n of them, `(height, width, 3)` uint8 BGR.
        heads
            `(n, 2)` px: centres.
        head_height
            px.
        skin
            of the person, which is no clothes.

        Returns
        -------
        ClothesColour or None
            `None` if no image has colours or shows the trunk.
        """
        on, off = np.zeros(N_BINS), np.zeros(N_BINS)
        for image, (x, y) in zip(images, heads, strict=True):
            if not has_colour(image):
                continue
            rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
            across, down = np.abs(columns - x) / head_height, (rows - y) / head_height
            trunk = (across < TRUNK[0]) & (down > TRUNK[1]) & (down < TRUNK[2])
            on += colour_counts(image, trunk & (skin.log_odds(image) < 0))
            off += colour_counts(image, (across > ELSEWHERE[0]) | (down < -ELSEWHERE[1]))
        if not (on.any() and off.any()):
            return None
        return cls(log_ratio_of(on, off))

    def arm_map(self, colours: Image, head_height: float, skin: Map, bare: float) -> Map:
        """Log odds of an arm against anything else, half as large as the image and smoothed.

        Parameters
        ----------
        colours
            `(height, width, 3)` uint8: the `smoothed` image.
        head_height
            px.
        skin
            `(height, width)` nats: log odds of skin in it.
        bare
            probability that arms are bare.
        """
        odds = looked_up_in(self.table, colours)
        if bare > 0:
            blended(odds.reshape(-1), skin.reshape(-1), 1 - min(bare, 0.999), bare)
        half = cv2.resize(odds, None, fx=SHRINK, fy=SHRINK, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(half, (0, 0), BLUR * SHRINK * head_height), np.float32)

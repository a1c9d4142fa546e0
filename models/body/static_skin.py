"""Skin colour that is nearly always there, and so is no hand: clutter, trousers, the face itself."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .skin_colour import SkinColour

Map = NDArray[np.float32]

SELDOM = 0.2
"""Share of a clip in which a pixel has to be without skin, so that skin there is news."""

FEWEST = 8
"""Frames, spread over a clip, of which this can be told."""

LEVELS = 16
"""Steps of the log odds per nat, so that many frames fit into memory."""


def static_skin(colour: SkinColour, images: Sequence[NDArray[np.uint8]]) -> Map | None:
    """`(height, width)` nats: log odds of skin that a pixel has in nearly all frames, 0 if it has none.

    How much a skin-coloured pixel speaks for a hand is its log odds less this.

    Parameters
    ----------
    images
        of one clip with a camera at rest, spread over its length; of fewer than `FEWEST`, `None` is said.

    Raises
    ------
    ValueError
        if they are of different sizes.
    """
    if len(images) < FEWEST:
        return None
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise ValueError(f"images: got {len(sizes)} different sizes, expected one")
    looks = np.stack([np.rint(LEVELS * colour.log_odds(image)).astype(np.int8) for image in images])
    rank = int(SELDOM * len(images))
    looks.partition(rank, axis=0)
    return np.asarray(np.maximum(looks[rank], 0) / LEVELS, np.float32)

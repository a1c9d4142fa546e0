"""Skin colour that is nearly always there, and so is no hand: clutter, trousers, the face itself."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .skin_colour import SkinColour

Map = NDArray[np.float32]

AWAY = 0.2
"""Share of a clip in which a pixel has to be without skin, so that skin there says anything."""

LEAST_FRAMES = 8
"""Frames, spread over a clip, from which this can be learned."""

LEVELS = 16
"""Steps of the log odds per nat, so that many frames fit into memory."""


def static_skin(colour: SkinColour, images: Sequence[NDArray[np.uint8]]) -> Map | None:
    """`(height, width)` nats: log odds of skin that a pixel has in nearly all frames, 0 if it has none.

    How much a skin-coloured pixel speaks for a hand is its log odds less this.

    Parameters
    ----------
    images
        of one clip with a camera at rest, spread over its length; `None` of fewer than `LEAST_FRAMES`.

    Raises
    ------
    ValueError
        if they are of different sizes.
    """
    if len(images) < LEAST_FRAMES:
        return None
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise ValueError(f"images: got {len(sizes)} different sizes, expected one")
    odds = np.stack([np.rint(LEVELS * colour.log_odds(image)).astype(np.int8) for image in images])
    rank = int(AWAY * len(images))
    odds.partition(rank, axis=0)
    return np.asarray(np.maximum(odds[rank], 0) / LEVELS, np.float32)

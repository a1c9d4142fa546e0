"""What a belief looks like: the frame, with what is believed of its features drawn over it."""

from collections.abc import Iterable
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.pictures import as_bgr


@runtime_checkable
class Drawable(Protocol):
    """A feature node that can be seen in a picture."""

    def draw(self, picture: NDArray[np.uint8], belief: Any, /) -> None:
        """Draw the belief over `picture`, `(height, width, 3)` uint8 BGR."""
        ...


def png(image: NDArray[np.uint8], beliefs: Iterable[tuple[object, Any]]) -> bytes:
    """A PNG of the image with the beliefs of all feature nodes that are `Drawable` over it."""
    picture = as_bgr(image)
    for node, belief in beliefs:
        if isinstance(node, Drawable):
            node.draw(picture, belief)
    _, encoded = cv2.imencode(".png", picture)
    return encoded.tobytes()

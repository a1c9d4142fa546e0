"""Notice that a camera moves which is taken to stand still, and tracks of one that is known to move."""

import logging
from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference import Belief
from ...models.camera.moving_camera import AffineMap, ScenePicture, is_thin
from ...models.core.pictures import grey_of

_log = logging.getLogger(__name__)

MOVES = "the camera moves or shakes"
"""With which the notice begins."""

SUSPICIOUS = 0.02
"""Share of the picture that is foreground from which on the camera may be the cause."""

LOOK_TIME = 0.3
"""s between the first two looks at the camera, while so much is foreground; then a third more every time."""

MOST_LOOK_TIME = 3.0
"""s between two looks at most."""

MOST = 0.5
"""Share of the differences between frame and empty scene that one map has to explain."""

LEAST_MOTION = 0.4
"""px, root mean square over the picture, below which a map is no motion that matters."""


FIRST_FRAME = "tracks-first-frame.csv"


def in_first_frame(
    objects: Mapping[str, NDArray[Any]], parameters: NDArray[np.float64], size: tuple[int, int]
) -> dict[str, NDArray[Any]]:
    """Return columns of a frame's objects in px of the first frame, from which the map to it is given."""
    back = AffineMap(parameters, size).inverse
    x, y, width, height, vx, vy = (objects[name] for name in ("x", "y", "width", "height", "vx", "vy"))
    foot_x, foot_y, width, height = back.boxes(np.column_stack([x + width / 2, y + height, width, height])).T
    vx, vy = back.matrix[:, :2] @ np.stack([vx, vy])
    places = {"x": foot_x - width / 2, "y": foot_y - height, "width": width, "height": height}
    return {**objects, **places, "vx": vx, "vy": vy}


class CameraWatch:
    """Registers suspicious frames with the empty scene, and says once that the camera moves.

    A light that is switched, or somebody who fills the picture, makes most of it foreground too; but then no
    map of the picture takes the differences away. If `noticed`, it has been said already.
    """

    def __init__(self, *, noticed: bool = False) -> None:
        self.noticed = noticed
        self._due, self._wait = -inf, LOOK_TIME

    def saved(self) -> tuple[float, float] | None:
        """When it looks again, as plain JSON."""
        return None if self._due == -inf else (self._due, self._wait)

    def restore(self, saved: tuple[float, float] | None) -> None:
        """Take up what `saved` gave."""
        if saved is not None:
            self._due, self._wait = saved

    def on_frame(self, belief: Belief, foreground: NDArray[np.uint8]) -> str | None:
        """What is to be said, and is logged, after this frame with its mask `(height, width)`."""
        frame = belief.frame
        if self.noticed or frame.image is None or frame.time < self._due:
            return None
        if np.count_nonzero(foreground) < SUSPICIOUS * foreground.size:
            return None
        self._due, self._wait = frame.time + self._wait, min(self._wait * 4 / 3, MOST_LOOK_TIME)
        background = belief["pixels"].background
        if is_thin(background.size):
            return None
        empty = background.colours.grey_levels()[0]
        found = ScenePicture(empty).register(grey_of(frame.image), AffineMap.identity(background.size))
        moved = found.map.displacement
        if found.explained < MOST or moved < LEAST_MOTION:
            return None
        self.noticed = True
        said = (
            f"{MOVES}: in frame {frame.number} the scene is seen {moved:.1f} px from where "
            f"it was, which is {found.explained:.0%} of what has changed; --camera moving follows it"
        )
        _log.warning("%s", said)
        return said

"""A glossy room: a person stands on a floor, or behind a table, that mirrors what is above."""

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Annotated

import cv2
import numpy as np

from ...models.core.checks import Bound, CountFrom0, NotNegative, checked
from .street import Layer, Mask, Pixels, Scene, mottle

SHARE = Bound(lambda share: 0 <= share < 1, "0 or more and less than 1")
EDGE = 0.62  # share of the height at which floor or table begin


@checked
@dataclass(frozen=True, eq=False)
class GlossyRoom(Scene):
    """A room with the person of the street; the lower part is (1 - share) * diffuse + share * mirrored.

    On a floor the person's mirror image hangs from the feet, and the wall's from its lower edge; a table
    hides the legs, and mirrors everything about its far edge.

    Parameters
    ----------
    share
        of what is mirrored.
    blur
        standard deviation of the mirrored picture's blur, px at a height of 240 px.
    texture
        standard deviation of the surface, grey levels.
    table
        the surface is a table in front of the person.
    """

    enter: CountFrom0 = 20
    stand: CountFrom0 = 150
    car_leaves: CountFrom0 = 1 << 30
    _: KW_ONLY
    share: Annotated[float, SHARE] = 0.3
    blur: NotNegative = 1.5
    texture: NotNegative = 0.0
    table: bool = False

    def person(self, index: int) -> Mask:
        """Return `(height, width)` bool: pixels that the person covers by more than half."""
        mask = self._posed(index).mask(self.size)
        if self.table:
            mask[self._edge :] = False
        return mask

    def car(self, index: int) -> Mask:
        """Return `(height, width)` bool: there is no car."""
        return np.zeros(self.size[::-1], np.bool_)

    def _visible(self, index: int) -> tuple[Mask, Mask]:
        return self.car(index), self.person(index)

    def reflection(self, index: int) -> Mask:
        """Return `(height, width)` bool: where the surface mirrors the person, blur aside."""
        return self._mirrored(self._posed(index)).mask(self.size) & ~self.person(index)

    @property
    def _edge(self) -> int:
        return round(EDGE * self.size[1])

    @property
    def _feet(self) -> float:
        return (0.9 if self.table else 0.74) * self.size[1]

    def _posed(self, index: int) -> Layer:
        _, x, walked, gait = self._visit(index)
        return self._figure.posed(x, self._feet, walked, gait, index * self.dt)

    def _mirrored(self, layer: Layer) -> Layer:
        """The layer upside down below the feet, or below the table's edge."""
        axis = self._edge if self.table else round(self._feet)
        patch, top = layer.patch[::-1], 2 * axis - layer.top - len(layer.patch)
        above = max(self._edge - top, 0)
        return Layer(patch[above:], layer.left, top + above)

    def _composed(self, index: int) -> Pixels:
        picture, edge, layer = self._ground.copy(), self._edge, self._posed(index)
        below = self.size[1] - edge
        mirrored = picture.copy()
        mirrored[edge:] = picture[:edge][::-1][:below]
        self._mirrored(layer).paint(mirrored)
        seen = mirrored[edge:]
        if self.blur > 0:
            seen = np.asarray(cv2.GaussianBlur(seen, (0, 0), self.blur * self.size[1] / 240), np.float32)
        surface = (1 - self.share) * picture[edge:] + self.share * seen
        if not self.table:
            picture[edge:] = surface
        layer.paint(picture)
        if self.table:
            picture[edge:] = surface
        return picture

    @cached_property
    def _ground(self) -> Pixels:
        """`(height, width, 3)` float32: wall and surface in diffuse light."""
        random = np.random.default_rng([self.seed, 0])
        picture = np.empty((*self.size[::-1], 3), np.float32)
        unit = self.size[1] / 240
        for part, rough, grain in (
            (picture[: self._edge], 12.0, 20),
            (picture[self._edge :], self.texture, 6),
        ):
            colour = random.uniform(120, 210) + random.uniform(-15, 15, 3)
            part[:] = colour + rough * mottle(part.shape[1::-1], grain * unit, random)[..., None]
        return np.asarray(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.6 * unit), 12, 240), np.float32)


glossy = GlossyRoom

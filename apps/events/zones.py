"""Zones and lines in the picture, and how far a foot is from their borders."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.short_repr import short_repr

Corners = NDArray[np.float64]

ON_EDGE = 0.01
"""Share of the picture's side, up to which a corner beside the picture's edge is taken to lie on it."""

WITHIN = 1e-9
"""Share of the picture's side by which a foot at its edge is inside of it."""


@short_repr
@dataclass(frozen=True, eq=False)
class Zone:
    """A polygon of the picture.

    Where it reaches the picture's edge it has no border: nobody can be seen to cross it there.

    Parameters
    ----------
    name
        of the zone.
    polygon
        `(n, 2)` px, corners in either order; pixels' edges are at whole numbers, as of boxes.
    size
        `(width, height)` px of the picture.
    """

    name: str
    polygon: Corners
    size: tuple[int, int]
    _starts: Corners = field(init=False, repr=False)
    _ways: Corners = field(init=False, repr=False)
    _inner: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = np.array(self.size, np.float64)
        starts = np.where(self.polygon <= ON_EDGE * size, 0.0, self.polygon)
        starts = np.where(starts >= (1 - ON_EDGE) * size, size, starts)
        ends = np.roll(starts, -1, axis=0)
        on_edge = (starts == ends) & ((starts == 0) | (starts == size))
        object.__setattr__(self, "_starts", starts)
        object.__setattr__(self, "_ways", ends - starts)
        object.__setattr__(self, "_inner", ~on_edge.any(axis=1))

    def distance(self, places: ArrayLike) -> NDArray[np.float64]:
        """How far places are inside of the border, px; negative outside, infinite where there is no border.

        Parameters
        ----------
        places
            `(..., 2)` px; one out of the picture counts as the nearest one in it.

        Returns
        -------
        distances
            `(...)`.
        """
        size = np.array(self.size, np.float64)
        within = np.minimum(np.maximum(places, WITHIN * size), (1 - WITHIN) * size)
        offsets, ways = within[..., None, :] - self._starts, self._ways
        # a ray to the right crosses the border an odd number of times
        above = offsets[..., 1] < 0
        below = np.roll(above, -1, axis=-1)
        side = ways[:, 0] * offsets[..., 1] - ways[:, 1] * offsets[..., 0]
        crosses = (above != below) & ((side < 0) == (ways[:, 1] < 0))
        inside = crosses.sum(axis=-1) % 2 > 0
        offsets, ways = offsets[..., self._inner, :], ways[self._inner]
        along = np.minimum(np.maximum((offsets * ways).sum(axis=-1) / (ways * ways).sum(axis=1), 0), 1)
        off = offsets - along[..., None] * ways
        nearest = np.sqrt((off * off).sum(axis=-1)).min(axis=-1, initial=np.inf)
        distances: NDArray[np.float64] = np.where(inside, nearest, -nearest)
        return distances


@short_repr
@dataclass(frozen=True)
class Line:
    """A line of the picture that is crossed from left to right, or from right to left.

    Left and right are those of somebody in the picture who looks along it: of a line that goes to the right,
    what is above it is left.

    Parameters
    ----------
    name
        of the line.
    start, end
        px, as of `Zone`.
    left_to_right, right_to_left
        names of the two directions.
    size
        `(width, height)` px of the picture: a line that reaches its edge goes on beyond, where feet are that
        the edge cuts off. Without it, both ends are ends.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    left_to_right: str = "left to right"
    right_to_left: str = "right to left"
    size: tuple[int, int] | None = None

    def distance(self, place: tuple[float, float]) -> float:
        """How far a place is to the right of the endless line, px; negative to its left."""
        (x, y), (to_x, to_y) = self.start, self.end
        dx, dy = to_x - x, to_y - y
        return (dx * (place[1] - y) - dy * (place[0] - x)) / float(np.hypot(dx, dy))

    def is_beside(self, place: tuple[float, float]) -> bool:
        """Whether a place on the endless line is between its ends, or beyond one at the picture's edge."""
        (x, y), (to_x, to_y) = self.start, self.end
        dx, dy = to_x - x, to_y - y
        share = (dx * (place[0] - x) + dy * (place[1] - y)) / (dx * dx + dy * dy)
        return (share >= 0 or self._leaves(self.start, (-dx, -dy))) and (
            share <= 1 or self._leaves(self.end, (dx, dy))
        )

    def _leaves(self, end: tuple[float, float], way: tuple[float, float]) -> bool:
        """Whether who goes on from an end of the line is out of the picture."""
        return self.size is not None and any(
            (place <= ON_EDGE * side and step < 0) or (place >= (1 - ON_EDGE) * side and step > 0)
            for place, step, side in zip(end, way, self.size, strict=True)
        )


@short_repr
@dataclass(frozen=True, eq=False)
class Zones:
    """All zones and lines of a picture, and when somebody stands still or is gone.

    Parameters
    ----------
    zones, lines
        with names of which none is there twice.
    still_after
        s after which somebody stands still.
    patience
        s for which somebody may be out of sight and still be there.
    """

    zones: tuple[Zone, ...] = ()
    lines: tuple[Line, ...] = ()
    still_after: float = 2.0
    patience: float = 3.0

    def plain(self) -> dict[str, Any]:
        """Names and corners (px) as a page takes them, by the words of a file of zones."""
        return {
            "zones": [{"name": zone.name, "polygon": zone.polygon.tolist()} for zone in self.zones],
            "lines": [{"name": line.name, "from": line.start, "to": line.end} for line in self.lines],
        }

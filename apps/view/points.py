"""Points over the film in `view.html`, of any application that follows some."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.evenly_spaced import evenly_spaced
from .film import Film
from .overlay import Colour, css_colour, identity_colour
from .page import Line, Plot, TimelineRow, spans_of

Numbers = NDArray[np.float64]

LAYER = "points"

MOST_TRACKED, MOST_PLACES = 2_000, 200_000
"""Over the film: points, and places of points in frames."""
MOST_ROWS = 200
"""Of the timeline; other points have one while they are selected."""
SIDES = (("from the front", 0, 1), ("from the right", 2, 1), ("from above", 0, 2))
"""Title, and which of x (right), y (down) and z (away) goes to the right and which down."""
MARGIN = 0.08
"""About the points where there are no pictures."""


@dataclass(frozen=True, eq=False)
class FollowedPoints:
    """Points in all frames of a run.

    Parameters
    ----------
    positions
        `(n_frames, n_points, 2)` px: where each should be, seen or not; NaN where nothing is known.
    covariances
        `(n_frames, n_points, 2, 2)` px^2 of these.
    residuals
        `(n_frames, n_points, 2)` px: observation minus position, NaN where not observed.
    by
        what says where points are that are not seen.
    """

    positions: Numbers
    covariances: Numbers
    residuals: Numbers
    by: str

    @property
    def observed(self) -> NDArray[np.bool_]:
        """`(n_frames, n_points)`."""
        seen: NDArray[np.bool_] = ~np.isnan(self.residuals[..., 0])
        return seen

    @property
    def places(self) -> Numbers:
        """`(n_frames, n_points, 2)` px: where each was seen, or else where it should be."""
        return self.positions + np.where(self.observed[..., None], self.residuals, 0)

    def over(self, film: Film, shown: NDArray[np.bool_], corner: tuple[float, float]) -> dict[str, Any]:
        """The layer `LAYER` over a film.

        `shown (n_frames,)` says which frames it has; `corner` is its upper left one in the points' px.
        """
        tracked = self.tracked(film)
        observed = self.observed
        return {
            "corner": corner,
            "tracked": np.array(tracked, np.int32),
            "inks": [ink_of(point) for point in tracked],
            "positions": self.positions[shown][:, tracked].astype(np.float32),
            "residuals": self.residuals[shown][:, tracked].astype(np.float32),
            "spreads": self.covariances[shown][:, tracked][:, :, [0, 0, 1], [0, 1, 1]].astype(np.float32),
            "counts": np.count_nonzero(observed, axis=0).astype(np.int32),
            "frames": len(observed),
            "by": self.by,
        }

    def tracked(self, film: Film) -> list[int]:
        """Those that are drawn over a film: evenly chosen if there are many."""
        return evenly_spaced(self.positions.shape[1], most_over_film(len(film.numbers)))

    def rows(self, film: Film, shown: NDArray[np.bool_]) -> list[TimelineRow]:
        """Of some points, when they are seen."""
        tracked = self.tracked(film)
        chosen = [tracked[k] for k in evenly_spaced(len(tracked), MOST_ROWS)]
        observed = self.observed[shown]
        return [
            TimelineRow(point, f"point {point + 1}", ink_of(point), spans_of(observed[:, point]))
            for point in chosen
        ]

    def plots(self) -> list[Plot]:
        """Root mean square distance from where they were seen, and how many were."""
        observed = self.observed
        squares = np.where(observed, np.square(self.residuals).sum(axis=-1), 0.0).sum(axis=1)
        counts = np.count_nonzero(observed, axis=1)
        errors = np.sqrt(np.where(counts > 0, squares, np.nan) / np.maximum(counts, 1))
        caption = "Root mean square distance (per point, not per coordinate) over visible points."
        return [
            Plot("error per point", "px", [Line(errors)], caption),
            Plot("points seen", "", [Line(counts)]),
        ]


def most_over_film(n_frames: int) -> int:
    """How many points are drawn over a film of so many frames, at most."""
    return min(MOST_TRACKED, MOST_PLACES // n_frames)


def colour_of(point: int) -> Colour:
    """The BGR colour of a point, by its place in arrays: on pages and in films it is counted from 1."""
    return identity_colour(point + 1)


def ink_of(point: int) -> str:
    """The same, as CSS has it."""
    return css_colour(colour_of(point))


def packed(colours: NDArray[Any]) -> NDArray[np.uint32]:
    """Colours `(n, 3)` BGR as 0xBBGGRR."""
    blue, green, red = colours.astype(np.uint32).T
    together: NDArray[np.uint32] = (blue << 16) | (green << 8) | red
    return together


def film_of_points(
    places: Numbers, numbers: Sequence[int], times: Sequence[float]
) -> tuple[Film, tuple[float, float]]:
    """A film without pictures that is as large as points need, and its upper left corner, px.

    `places` are `(n_frames, n_points, 2)` px, some finite; frames are numbered from 1, times in s.
    """
    known = places[np.isfinite(places).all(axis=2)]
    low, high = known.min(axis=0), known.max(axis=0)
    edge = MARGIN * float((high - low).max()) or 1.0
    width, height = np.ceil(high - low + 2 * edge).astype(int).tolist()
    moments = np.array(times, np.float64)
    left, top = (low - edge).tolist()
    return Film(None, (width, height), np.array(numbers, np.int64), moments, moments), (left, top)

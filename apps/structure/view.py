"""A reconstruction's part of `view.html`: points over the film and in space, and from where it was taken."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.boxes import css_colour, identity_colour
from ..reports.evenly_spaced import evenly_spread
from ..view.film import Film, FilmWriter, read_film
from ..view.page import Plot, TimelineRow, View, spans_of
from .files import GREY, orthographic_parts
from .reconstruction import Numbers, Reconstruction

MOST_POINTS = 100_000
"""In space."""
MOST_TRACKED, MOST_PLACES = 2_000, 200_000
"""Over the film: points, and places of points in frames."""
MOST_ROWS = 200
"""Of the timeline; other points have one while they are selected."""

EDGE = (-0.5, -0.5)
"""px: upper left corner of pictures, where points have the pixels' centres at whole numbers."""
MARGIN = 0.08
"""About the points where there are no pictures."""


def write_film(folder: Path, frames: Sequence[Frame], rate: float) -> Film:
    """Write the film without drawings to the folder, and read what there is of it.

    Raises
    ------
    OSError
        if it cannot be written.
    """
    height, width = next(frame.image.shape[:2] for frame in frames if frame.image is not None)
    with FilmWriter(folder, rate) as writer:
        for frame in frames:
            writer.add(frame, dict)
    return read_film(folder, (width, height))


def film_of_tracks(frames: Sequence[Frame], found: Reconstruction) -> tuple[Film, tuple[float, float]]:
    """A film without pictures that is as large as the points need, and its upper left corner, px."""
    places = found.places[np.isfinite(found.places).all(axis=2)]
    low, high = places.min(axis=0), places.max(axis=0)
    edge = MARGIN * float((high - low).max()) or 1.0
    width, height = np.ceil(high - low + 2 * edge).astype(int).tolist()
    times = np.array([frame.time for frame in frames], np.float64)
    numbers = np.array([frame.number for frame in frames], np.int64)
    left, top = (low - edge).tolist()
    return Film(None, (width, height), numbers, times, times), (left, top)


def structure_view(
    frames: Sequence[Frame],
    found: Reconstruction,
    colours: NDArray[np.uint8],
    film: Film,
    corner: tuple[float, float] = EDGE,
) -> View:
    """The page of a reconstruction.

    Parameters
    ----------
    frames
        all of them.
    found
        points and cameras.
    colours
        `(n_points, 3)` BGR: of the points in space.
    film
        of all frames, or of the last ones.
    corner
        px, in the coordinates of points: the upper left one of the film.
    """
    shown = np.isin([frame.number for frame in frames], film.numbers)
    points = evenly_spread(found.n_points, MOST_POINTS)
    tracked = evenly_spread(found.n_points, min(MOST_TRACKED, MOST_PLACES // len(film.numbers)))
    observed = found.observed[shown]
    residuals = np.where(observed[..., None], found.residuals[shown], np.nan)[:, tracked]
    upper = found.covariances[shown][:, tracked][:, :, [0, 0, 1], [0, 1, 1]]
    layer: dict[str, Any] = {
        "corner": corner,
        "tracked": np.array(tracked, np.int32),
        "inks": [_ink(point) for point in tracked],
        "positions": found.positions[shown][:, tracked].astype(np.float32),
        "residuals": residuals.astype(np.float32),
        "spreads": upper.astype(np.float32),
        "counts": np.count_nonzero(found.observed, axis=0).astype(np.int32),
        "frames": len(frames),
        "geometry": found.geometry,
        "reason": found.reason,
        "space": None if found.geometry == "none" else _space(found, colours, points, shown),
    }
    rows = [
        TimelineRow(point, f"point {point}", _ink(point), spans_of(observed[:, point]))
        for point in (tracked[k] for k in evenly_spread(len(tracked), MOST_ROWS))
    ]
    plots = [
        Plot("error", "px", found.reprojection_errors[shown]),
        Plot("points seen", "", np.count_nonzero(observed, axis=1)),
    ]
    return View({"structure": layer}, rows, plots)


def _ink(point: int) -> str:
    return css_colour(identity_colour(point))


def _space(
    found: Reconstruction, colours: NDArray[np.uint8], points: Sequence[int], shown: NDArray[np.bool_]
) -> dict[str, Any]:
    """The points in space, and from where the cameras look at them."""
    shape = found.shape[points]
    centre = np.median(shape, axis=0)
    # what is badly known lies anywhere, and would make everything else small
    reach = float(np.quantile(np.linalg.norm(shape - centre, axis=1), 0.9))
    inks = [identity_colour(point) for point in points]
    rotations: Numbers = np.full((np.count_nonzero(shown), 3, 3), np.nan)
    if found.geometry == "euclidean":
        rotations = orthographic_parts(found.cameras)[1][shown]
    return {
        "points": np.array(points, np.int32),
        "places": shape.astype(np.float32),
        "inks": _packed(np.array(inks)),
        "colours": _packed(colours[points]) if (colours != GREY).any() else None,
        "covariances": found.shape_covariances[points][:, *np.triu_indices(3)].astype(np.float32),
        "rotations": rotations.astype(np.float32),
        "centre": centre.tolist(),
        "reach": reach,
    }


def _packed(colours: NDArray[Any]) -> NDArray[np.uint32]:
    """Colours `(n, 3)` BGR as 0xBBGGRR."""
    blue, green, red = colours.astype(np.uint32).T
    packed: NDArray[np.uint32] = (blue << 16) | (green << 8) | red
    return packed

"""A reconstruction's part of `view.html`: points over the film and in space, and from where it was taken."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.boxes import identity_colour
from ..reports.evenly_spaced import evenly_spread
from ..view.film import Film, FilmWriter, read_film
from ..view.page import View
from ..view.points import LAYER, FollowedPoints, film_of_points, packed
from .files import GREY, orthographic_parts
from .reconstruction import Numbers, Reconstruction

MOST_POINTS = 100_000
"""In space."""

EDGE = (-0.5, -0.5)
"""px: upper left corner of pictures, where points have the pixels' centres at whole numbers."""


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
    return film_of_points(found.places, [frame.number for frame in frames], [frame.time for frame in frames])


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
    residuals = np.where(found.observed[..., None], found.residuals, np.nan)
    followed = FollowedPoints(found.positions, found.covariances, residuals, "shape and camera")
    layer: dict[str, Any] = {
        "geometry": found.geometry,
        "reason": found.reason,
        "count": found.n_points,
        "space": None if found.geometry == "none" else _space(found, colours, points, shown),
    }
    layers = {LAYER: followed.over(film, shown, corner), "structure": layer}
    return View(layers, followed.rows(film, shown), followed.plots(shown))


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
        "inks": packed(np.array(inks)),
        "colours": packed(colours[points]) if (colours != GREY).any() else None,
        "covariances": found.shape_covariances[points][:, *np.triu_indices(3)].astype(np.float32),
        "rotations": rotations.astype(np.float32),
        "centre": centre.tolist(),
        "reach": reach,
    }

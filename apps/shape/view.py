"""A deforming shape's part of `view.html`: points over their tracks, and the shape and its modes in space."""

from typing import Any

import numpy as np

from ..drawing.boxes import identity_colour
from ..view.film import Film
from ..view.page import Plot, View
from ..view.points import LAYER, FollowedPoints, film_of_points, packed
from .result import LearnedShape


def shape_view(found: LearnedShape) -> tuple[Film, View]:
    """The film without pictures that the points need, and what is drawn over it and beside it."""
    learned = found.learned
    positions = found.shapes[..., :2]
    followed = FollowedPoints(positions, found.covariances[..., :2, :2], found.residuals, "shape and pose")
    film, corner = film_of_points(followed.places, found.numbers, found.times.tolist())
    shown = np.ones(len(film.numbers), np.bool_)
    mean = learned.bases[0]
    layer: dict[str, Any] = {
        "bases": learned.bases.astype(np.float32),
        "triangles": learned.model().triangles.astype(np.int32),
        "inks": packed(np.array([identity_colour(point) for point in range(len(mean))])),
        "rotations": learned.rotations.astype(np.float32),
        "scales": learned.scales.astype(np.float32),
        "weights": learned.weights.astype(np.float32),
        "size": float(np.nanmean(learned.scales)),
        # a shape that leans out of the mean one still fits
        "reach": 1.25 * float(np.linalg.norm(mean - mean.mean(axis=0), axis=1).max()),
    }
    modes = [Plot(f"weight {k}", "s.d.", values) for k, values in enumerate(learned.weights.T, start=1)]
    plots = [*followed.plots(shown), *modes]
    return film, View(
        {LAYER: followed.over(film, shown, corner), "shape": layer}, followed.rows(film, shown), plots
    )

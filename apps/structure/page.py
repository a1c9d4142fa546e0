"""The page of a reconstruction: points over the film and in space, the cameras, errors over time."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from ...chains.reconstruction import Numbers, Reconstruction, lens_of
from ...inference.sfm.perspective.structure import Lens, PerspectiveStructure
from ...models.core.frame import Frame
from ...models.numerics.evenly_spaced import evenly_spaced
from ..io.sources.images import focal_of_picture
from ..view.film import Film, FilmWriter, Row, read_film
from ..view.overlay import css_colour
from ..view.page import Line, Page, Plot, Section, encoded
from ..view.points import (
    LAYER,
    SIDES,
    FollowedPoints,
    colour_of,
    film_of_points,
    ink_of,
    most_over_film,
    packed,
)
from .files import GREY, orthographic_parts


def known_lens(frames: Sequence[Frame], focal: float | None, picture: Path | None) -> tuple[Lens, str]:
    """Return what is known of the lens, and a sentence on what is assumed.

    The focal length is in px, `None` where it is not given; `picture` is a file of the film that may tell it.
    """
    pictures = any(frame.image is not None for frame in frames)
    stated = focal_of_picture(picture) if pictures and focal is None and picture is not None else None
    lens = lens_of(frames, stated if focal is None else focal)
    if pictures:
        note = "" if stated is None else f"Focal length: {stated:.5g} px, as the pictures' files state."
        return lens, note
    height, width = lens.size
    return lens, (
        f"The picture is taken to be {width} x {height} px, with positions as far from the left and upper "
        "edge as from the others: a camera with perspective needs its middle."
    )


def camera_in_words(result: Reconstruction) -> str:
    """Describe the camera, as in "perspective, focal length 660 ± 4 px", or why it is affine."""
    if result.perspective is not None:
        return f"perspective, {focal_in_words(result.perspective)}"
    return f"affine: {result.affine_reason}" if result.affine_reason else "affine"


def focal_in_words(structure: PerspectiveStructure) -> str:
    """Describe the focal length, as in "focal length 660 ± 4 px"."""
    if structure.curvature_deviation == 0:
        return f"focal length {structure.cameras.focal:.5g} px, as given"
    if not structure.focal_deviation < structure.cameras.focal / 2:
        shortest = 1 / (structure.cameras.curvature + 2 * structure.curvature_deviation)
        return f"focal length unknown, more than {shortest:.2g} px"
    return f"focal length {structure.cameras.focal:.5g} ± {structure.focal_deviation:.2g} px"


def facts_of(result: Reconstruction) -> dict[str, Any]:
    """Return the entries of `summary.json` on points and camera, of any engine."""
    return {
        "points": result.n_points,
        "observations": result.n_observations,
        "dropped_observations": None if result.dropped is None else int(result.dropped.sum()),
        "reprojection_rmse_px_per_point": result.reprojection_error,
        "reprojection_rmse_px_per_coordinate": result.reprojection_error / math.sqrt(2),
        "noise_px_per_coordinate": float(np.sqrt(result.noise_variance)),
        "camera": "affine" if result.perspective is None else "perspective",
        "camera_in_words": camera_in_words(result),
    }


def in_words(summary: Mapping[str, Any]) -> list[str]:
    """Describe the number of points and how well they fit."""
    words = f"{summary['frames']} frames, {summary['points']} points from {summary['tracks']} tracks"
    if not summary["points"]:
        return [words]
    return [
        f"{words}, reprojection error {summary['reprojection_rmse_px_per_point']:.3g} px per point "
        f"({summary['reprojection_rmse_px_per_coordinate']:.3g} px per coordinate), shape: "
        f"{summary['shape']}",
        f"camera: {summary['camera_in_words']}",
    ]


MOST_POINTS = 100_000
"""In space."""
MOST_DRAWN, MOST_PLACES = 300, 60_000
"""In a plot of tracks without pictures: points, and their places."""

EDGE = (-0.5, -0.5)
"""px: upper left corner of pictures, where points have the pixels' centres at whole numbers."""

LONGEST_EDGE = 0.2
"""Of triangles of the surface, by the picture's diagonal: longer ones span what belongs to nothing."""
LEAST_SURE = 4.0
"""Deviation, in medians over the points, beyond which a point is no corner of the surface."""
PICTURE_SIDE = 640
"""px of the picture that the surface carries, at most."""


def write_film(
    folder: Path, frames: Sequence[Frame], rate: float, result: Reconstruction | None = None
) -> Film:
    """Write the film without drawings, with the places of points, to the folder; read it again."""
    with FilmWriter(folder, rate) as writer:
        for index, frame in enumerate(frames):
            writer.add(frame, dict if result is None else partial(view_row, result, index))
    return read_film(folder)


def film_of_tracks(frames: Sequence[Frame], result: Reconstruction) -> tuple[Film, tuple[float, float]]:
    """Return a film without pictures that is as large as the points need, and its upper left corner, px."""
    return film_of_points(result.places, [frame.number for frame in frames], [frame.time for frame in frames])


def view_row(result: Reconstruction, index: int) -> Row:
    """Return what is drawn on a frame: see `PointsOverlay`."""
    shown = evenly_spaced(result.n_points, most_over_film(len(result.observed)))
    places = result.places[index, shown].astype(np.float32)
    return {"id": np.array(shown, np.int32) + 1, "points": places, "seen": result.observed[index, shown]}


def structure_page(
    title: str,
    frames: Sequence[Frame],
    result: Reconstruction,
    colours: NDArray[np.uint8],
    summary: Mapping[str, Any],
    film: Film,
    corner: tuple[float, float] = EDGE,
) -> Page:
    """Return the page of a run.

    `colours (n_points, 3)` BGR are those of the points in space; the film is of all frames, or of the last
    ones, and `corner` its upper left one, in the points' px.
    """
    shown = np.isin([frame.number for frame in frames], film.numbers)
    points = evenly_spaced(result.n_points, MOST_POINTS)
    residuals = np.where(result.observed[..., None], result.residuals, np.nan)
    followed = FollowedPoints(result.positions, result.covariances, residuals, "shape and camera")
    layer: dict[str, Any] = {
        "geometry": result.geometry,
        "reason": result.reason,
        "count": result.n_points,
        "space": None if result.geometry == "none" else _space(result, colours, points, shown),
        "surface": _surface(frames, result) if result.geometry == "euclidean" else None,
    }
    sections: list[Section] = []
    if result.geometry != "none":
        sections.append(("Shape", three_sides(result, colours)))
    if film.path is None:
        sections.append(("Tracks", [_tracks(result)]))
    if result.objective:
        sections.append(("Rounds", [_rounds(result)]))
    return Page(
        title,
        cards=_cards(result, summary),
        notes=summary["notes"],
        film=film,
        layers={LAYER: followed.over(film, shown, corner), "structure": layer},
        timeline=followed.rows(film, shown),
        plots=followed.plots(),
        sections=sections,
        parameters=summary["parameters"],
        numbers=[frame.number for frame in frames],
        times=[frame.time for frame in frames],
        over="frame",
    )


def nothing_page(
    title: str,
    frames: Sequence[Frame],
    figures: Mapping[str, float | None],
    summary: Mapping[str, Any],
    film: Film | None,
) -> Page:
    """Return the page of a run without a result: what is missing, why, and the film.

    `figures` were measured, by names as they are in `summary.json`; without pictures there is no film.
    """
    known = {name.replace("_", " "): f"{value:.3g}" for name, value in figures.items() if value is not None}
    return Page(
        title,
        cards={"frames": f"{len(frames)}", **known},
        notes=summary["notes"],
        film=film,
        parameters=summary["parameters"],
        numbers=[frame.number for frame in frames],
        times=[frame.time for frame in frames],
        over="frame",
    )


def _cards(result: Reconstruction, summary: Mapping[str, Any]) -> dict[str, str]:
    return {
        "frames": f"{summary['frames']}",
        "points": f"{result.n_points}",
        "observations": f"{result.n_observations}",
        "reprojection error per point": f"{result.reprojection_error:.3g} px",
        "reprojection error per coordinate": f"{result.reprojection_error / math.sqrt(2):.3g} px",
        "noise of a coordinate": f"{np.sqrt(result.noise_variance):.3g} px",
        "shape": "undetermined" if result.geometry == "none" else result.geometry,
        "camera": camera_in_words(result),
        **({"rounds": f"{len(result.objective)}"} if result.objective else {}),
    }


def three_sides(result: Reconstruction, colours: NDArray[np.uint8]) -> list[Plot]:
    """Plot the points of a shape from three sides."""
    centred = result.shape - np.median(result.shape, axis=0)
    # what is badly known lies anywhere, and would make everything else small
    shown = np.all(np.abs(centred) <= 2 * np.quantile(np.abs(centred), 0.9, axis=0), axis=1)
    inks = [css_colour(colour) for colour in colours[shown].tolist()]
    left_out = result.n_points - np.count_nonzero(shown)
    caption = (
        "In px of the image, up to scale and a reflection in depth."
        if result.geometry == "euclidean"
        else "Up to an affine map: lengths and angles are not determined."
    )
    caption += f" {left_out} of {result.n_points} points lie outside." if left_out else ""
    return [
        Plot(
            side,
            "xyz"[down],
            [Line(centred[shown, down], x=centred[shown, across], style="dots", colours=inks)],
            caption if not k else "",
            axis="xyz"[across],
            is_map=True,
        )
        for k, (side, across, down) in enumerate(SIDES)
    ]


def _tracks(result: Reconstruction) -> Plot:
    """Paths of the points in the plane of the picture, where they were seen."""
    drawn = evenly_spaced(result.n_points, MOST_DRAWN)
    chosen = evenly_spaced(len(result.observed), MOST_PLACES // max(1, len(drawn)))
    lines = []
    for point in drawn:
        seen = np.where(result.observed[chosen, point, None], result.places[chosen, point], np.nan)
        lines.append(Line(seen[:, 1], "", ink_of(point), x=seen[:, 0]))
    caption = "As observed."
    caption += f" {len(drawn)} of {result.n_points} points." if len(drawn) < result.n_points else ""
    return Plot("tracks", "y, px", lines, caption, axis="x, px", is_map=True)


def _rounds(result: Reconstruction) -> Plot:
    values = np.array(result.objective)
    ended = "It ended by itself." if result.converged else "It was ended before it converged."
    caption = f"Log density of the model after each round of coordinate ascent. {ended}"
    return Plot("objective", "nats", [Line(values, x=np.arange(1, len(values) + 1))], caption, axis="round")


def _space(
    result: Reconstruction, colours: NDArray[np.uint8], points: Sequence[int], shown: NDArray[np.bool_]
) -> dict[str, Any]:
    """The points in space, and from where the cameras look at them."""
    shape = result.shape[points]
    centre = np.median(shape, axis=0)
    # what is badly known lies anywhere, and would make everything else small
    reach = float(np.quantile(np.linalg.norm(shape - centre, axis=1), 0.9))
    inks = [colour_of(point) for point in points]
    rotations: Numbers = np.full((np.count_nonzero(shown), 3, 3), np.nan)
    if result.geometry == "euclidean":
        rotations = orthographic_parts(result.cameras)[1][shown]
    return {
        "points": np.array(points, np.int32),
        "places": shape.astype(np.float32),
        "inks": packed(np.array(inks)),
        "colours": packed(colours[points]) if (colours != GREY).any() else None,
        "covariances": result.shape_covariances[points][:, *np.triu_indices(3)].astype(np.float32),
        "rotations": rotations.astype(np.float32),
        "centre": centre.tolist(),
        "reach": reach,
    }


def _surface(frames: Sequence[Frame], result: Reconstruction) -> dict[str, Any] | None:
    """Triangles between the points of the frame that shows most, and its picture, which they carry."""
    with_image = [index for index, frame in enumerate(frames) if frame.image is not None]
    counts = np.count_nonzero(result.observed[with_image], axis=1)
    if not len(counts) or counts.max() < 3:
        return None
    index = with_image[int(counts.argmax())]
    image = frames[index].image
    assert image is not None
    sure = result.deviations <= LEAST_SURE * np.median(result.deviations)
    corners = np.flatnonzero(result.observed[index] & sure)
    if len(corners) < 3:
        return None
    places = result.places[index, corners]
    triangles = Delaunay(places).simplices
    edges = np.linalg.norm(places[triangles] - places[np.roll(triangles, 1, axis=1)], axis=2)
    triangles = triangles[edges.max(axis=1) <= LONGEST_EDGE * math.hypot(*image.shape[:2])]
    scale = min(1.0, PICTURE_SIDE / max(image.shape[:2]))
    picture = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    return {
        "frame": frames[index].number,
        "points": corners.astype(np.int32),
        "corners": result.shape[corners].astype(np.float32),
        "triangles": triangles.astype(np.int32),
        "onPicture": (scale * places).astype(np.float32),
        "picture": encoded(picture, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, 85]),
    }

"""The report of a structure-from-motion run as one page: shape, tracks, errors over time, rounds."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.boxes import identity_colour
from ..reports.evenly_spaced import evenly_spread
from ..reports.page import Section, cards, paragraph, picture_grid, write_run_page
from ..reports.plots import figure
from ..reports.snapshots import MOST_SNAPSHOTS, small
from .camera import camera_in_words
from .reconstruction import Numbers, Reconstruction
from .surface_views import surface_views
from .track_overlay import draw_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_DRAWN = 300  # tracks in a plot without images
BLUE = "#2f7fc1"
DOWN = 1
TURNS = (-40, 0, 40)  # degrees

SIDES = (("from the front", 0, 1), ("from the right", 2, 1), ("from above", 0, 2))
"""Title, and which of x (right), y (down) and z (away) goes to the right and which along the other axis."""


def write_structure_report(
    path: Path,
    frames: Sequence[Frame],
    found: Reconstruction,
    colours: NDArray[np.uint8],
    notes: Sequence[str],
    parameters: Mapping[str, object],
    title: str,
) -> None:
    """Write the report of a run as one HTML file.

    Parameters
    ----------
    path
        file to write; it appears when it is complete.
    frames
        all frames, with images or without.
    found
        points and cameras.
    colours
        `(n_points, 3)` BGR.
    notes
        what is out of the ordinary, a sentence each.
    parameters
        every setting of the run.
    title
        heading of the page.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    numbers = np.array([frame.number for frame in frames])
    sections: list[Section] = []
    if found.geometry != "none":
        sections.append(("Shape", [shape_pictures(frames, found, colours)]))
    sections.append(("Tracks", [track_pictures(frames, found)]))
    sections.append(("Over time", [_over_time(numbers, found)]))
    sections.append(("Rounds", [_rounds(found)]))
    write_run_page(path, title, _summary(frames, found), notes, sections, parameters)


def write_nothing_report(
    path: Path,
    frames: Sequence[Frame],
    figures: Mapping[str, float | None],
    notes: Sequence[str],
    parameters: Mapping[str, object],
    title: str,
) -> None:
    """Write the report of a run that has found nothing: what is missing, why, and some of what it has seen.

    Parameters
    ----------
    figures
        what was measured, by names as they are in `summary.json`.
    path, frames, notes, parameters, title
        as of `write_structure_report`.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    known = {name.replace("_", " "): f"{value:.3g}" for name, value in figures.items() if value is not None}
    images = [(frame, frame.image) for frame in frames if frame.image is not None]
    chosen = [images[k] for k in evenly_spread(len(images), MOST_SNAPSHOTS)]
    sections: list[Section] = []
    if chosen:
        columns = [f"frame {frame.number}, {frame.time:.1f} s" for frame, _ in chosen]
        sections.append(("Pictures", [picture_grid([("", [small(image) for _, image in chosen])], columns)]))
    write_run_page(path, title, cards({"frames": f"{len(frames)}", **known}), notes, sections, parameters)


def _summary(frames: Sequence[Frame], found: Reconstruction) -> Markup:
    return cards(
        {
            "frames": f"{len(frames)}",
            "points": f"{found.n_points}",
            "observations": f"{found.n_observations}",
            "reprojection error per point": f"{found.reprojection_error:.3g} px",
            "reprojection error per coordinate": f"{found.reprojection_error / math.sqrt(2):.3g} px",
            "noise of a coordinate": f"{np.sqrt(found.noise_variance):.3g} px",
            "shape": "undetermined" if found.geometry == "none" else found.geometry,
            "camera": camera_in_words(found),
            "rounds": f"{len(found.objective)}",
        }
    )


def shape_pictures(
    frames: Sequence[Frame], found: Reconstruction, colours: NDArray[np.uint8], title: str = ""
) -> Markup:
    """The points from three sides, each in its own colour, and as a surface where there are images.

    Parameters
    ----------
    frames, found
        the run.
    colours
        `(n_points, 3)` BGR.
    title
        stands before the captions.
    """
    parts = _three_sides(found, colours, title)
    views = surface_views(frames, found, TURNS) if found.geometry == "euclidean" else []
    if views:
        columns = [f"turned by {angle}°" for angle in TURNS]
        parts = Markup(parts + picture_grid([(f"{title}surface", [small(view) for view in views])], columns))
    return parts


def _three_sides(found: Reconstruction, colours: NDArray[np.uint8], title: str) -> Markup:
    centred = found.shape - np.median(found.shape, axis=0)
    # What is badly known lies anywhere, and would make everything else small.
    shown = np.all(np.abs(centred) <= 2 * np.quantile(np.abs(centred), 0.9, axis=0), axis=1)
    reach = 1.1 * np.abs(centred[shown]).max(axis=0)
    ink = colours[shown, ::-1] / 255

    def draw(canvas: "Figure") -> None:
        for axis, (side, across, along) in zip(canvas.subplots(1, len(SIDES)), SIDES, strict=True):
            axis.scatter(
                *centred[shown][:, [across, along]].T, s=16, c=ink, linewidths=0.3, edgecolors="#808080",
                rasterized=True,
            )  # fmt: skip
            axis.set_title(side, fontsize=10)
            axis.set_xlabel("xyz"[across])
            axis.set_ylabel("xyz"[along])
            axis.set_xlim(-reach[across], reach[across])
            axis.set_ylim(-reach[along], reach[along])
            if along == DOWN:
                axis.invert_yaxis()
            if found.geometry == "euclidean":
                axis.set_aspect("equal")

    left_out = found.n_points - np.count_nonzero(shown)
    caption = (
        "In px of the picture, up to scale and to reflection in depth."
        if found.geometry == "euclidean"
        else "Up to an affine map: lengths and angles mean nothing."
    )
    caption += f" {left_out} of {found.n_points} points lie outside." if left_out else ""
    return figure(draw, (13, 4.6), f"{title}{caption}")


def track_pictures(frames: Sequence[Frame], found: Reconstruction) -> Markup:
    """Tracks on some of the frames, or by themselves where there are no images."""
    with_image = [index for index, frame in enumerate(frames) if frame.image is not None]
    if not with_image:
        return _tracks_alone(found)
    chosen = sorted(
        {with_image[k] for k in np.linspace(0, len(with_image) - 1, MOST_SNAPSHOTS).round().astype(int)}
    )
    pictures = []
    for index in chosen:
        image = frames[index].image
        assert image is not None
        pictures.append(small(draw_points(image, found, index)))
    columns = [f"frame {frames[index].number}, {frames[index].time:.1f} s" for index in chosen]
    note = paragraph("Dots are seen, with the way that they came; rings are predicted.")
    return Markup(note + picture_grid([("tracks", pictures)], columns))


def _tracks_alone(found: Reconstruction) -> Markup:
    """Paths of the points in the plane of the picture; what was not seen is dashed."""
    drawn = evenly_spread(found.n_points, MOST_DRAWN)

    def draw(canvas: "Figure") -> None:
        axis: Axes = canvas.subplots()
        for point in drawn:
            blue, green, red = identity_colour(point)
            ink = (red / 255, green / 255, blue / 255)
            seen = np.where(found.observed[:, point, None], found.places[:, point], np.nan)
            axis.plot(*found.positions[:, point].T, color=ink, linewidth=0.5, linestyle=(0, (2, 3)))
            axis.plot(*seen.T, color=ink, linewidth=1.1, marker=".", markersize=2.5)
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.set_xlabel("x, px")
        axis.set_ylabel("y, px")

    caption = "Lines with dots: as observed; dashed: by shape and cameras."
    caption += f" {len(drawn)} of {found.n_points} points." if len(drawn) < found.n_points else ""
    return figure(draw, (9, 7), caption)


def _over_time(numbers: NDArray[np.int64], found: Reconstruction) -> Markup:
    curves = (
        ("error per\npoint, px", found.reprojection_errors),
        ("points seen", np.count_nonzero(found.observed, axis=1).astype(np.float64)),
    )

    def draw(canvas: "Figure") -> None:
        axes = canvas.subplots(len(curves), sharex=True)
        for axis, (name, values) in zip(axes, curves, strict=True):
            axis.plot(numbers, values, color=BLUE, linewidth=1.2)
            axis.set_ylabel(name)
            axis.set_ylim(bottom=0)
            axis.margins(x=0.01)
        axes[-1].set_xlabel("frame")
        canvas.align_ylabels()

    return figure(draw, (11, 4), "Root mean square distance (per point, not per coordinate) over those seen.")


def _rounds(found: Reconstruction) -> Markup:
    values: Numbers = np.array(found.objective)
    ended = "It ended by itself." if found.converged else "It was ended before it converged."

    def draw(canvas: "Figure") -> None:
        axis: Axes = canvas.subplots()
        axis.plot(np.arange(1, len(values) + 1), values, color=BLUE, marker="o", markersize=4)
        axis.set_xlabel("round")
        axis.set_ylabel("objective, nats")
        from matplotlib.ticker import MaxNLocator

        axis.xaxis.set_major_locator(MaxNLocator(integer=True))

    return figure(draw, (7, 3), f"Log density of the model after each round of coordinate ascent. {ended}")

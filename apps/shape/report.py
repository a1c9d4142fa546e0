"""The report of a shape that deforms as one page: turning, its modes, its weights and errors over time."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...inference.sfm.nonrigid.learning import BasesChoice
from ..drawing.boxes import identity_colour
from ..reports.evenly_spaced import evenly_spread
from ..reports.page import Section, cards, moving_picture, write_run_page
from ..reports.plots import figure
from ..reports.time_plots import BLUE, RED, Line, over_time
from .result import LearnedShape, Numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Image = NDArray[np.uint8]

SIDES = (("from the front", 0, 1), ("from the right", 2, 1), ("from above", 0, 2))
"""Title, and which of x (right), y (down) and z (away) goes to the right and which along the other axis."""
DOWN = 1

MOST_MODES = 6
"""In the pictures, the largest."""
SWING = 2.0
"""Standard deviations to both sides of the mean, in which 95 % of weights lie."""

PICTURES, SECONDS = 60, 0.08
"""In which the shape turns once to and fro, and how long each is shown."""
SIDE = 380  # px
TURN = np.radians(60)
PAPER = 255


def write_shape_report(path: Path, found: LearnedShape, summary: Mapping[str, Any], title: str) -> None:
    """Write the report of a run as one HTML file.

    Parameters
    ----------
    path
        file to write; it appears when it is complete.
    found
        the shape and its tracks.
    summary
        the content of `summary.json`.
    title
        heading of the page.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    sections: list[Section] = [
        ("Shape", [moving_picture(turning(found), SECONDS, TURNING)]),
        ("Modes", [modes(found)]),
        ("Over time", [curves(found)]),
    ]
    if found.choice is not None:
        sections.append(("Number of bases", [held_out(found.choice)]))
    write_run_page(path, title, _figures(summary), summary["notes"], sections, summary["parameters"])


TURNING = (
    "The shapes of the film, one after the other, while the viewer goes from side to side: what lies in "
    "different depths moves against each other. What is farther away is paler."
)


def _figures(summary: Mapping[str, Any]) -> Markup:
    shown = {
        "frames": f"{summary['frames']}",
        "points": f"{summary['points']}",
        "bases": f"{summary['bases']}",
        "reprojection error per point": f"{summary['reprojection_rmse_px_per_point']:.3g} px",
        "reprojection error per coordinate": f"{summary['reprojection_rmse_px_per_coordinate']:.3g} px",
        "noise of a coordinate": f"{summary['noise_px_per_coordinate']:.3g} px",
    }
    if summary["e3d"] is not None:
        shown["error in 3-D, e3D"] = f"{summary['e3d']:.4f}"
    return cards(shown)


def turning(found: LearnedShape) -> list[Image]:
    """Pictures `(height, width, 3)` BGR of shapes of the film, seen from one side after the other."""
    known = np.flatnonzero(found.learned.frame_determined)
    chosen = known[evenly_spread(len(known), PICTURES)]
    shapes = found.shapes[chosen]
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    angles = TURN * np.sin(2 * np.pi * np.arange(len(chosen)) / len(chosen))
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    across = cosine * shapes[..., 0] - sine * shapes[..., 2]
    away = sine * shapes[..., 0] + cosine * shapes[..., 2]
    reach = 1.05 * float(np.quantile(np.linalg.norm(shapes, axis=2), 0.99))
    places = SIDE / 2 * (1 + np.stack([across, shapes[..., 1]], axis=2) / reach)
    return [_dots(one, depth / reach) for one, depth in zip(places, away, strict=True)]


def _dots(places: Numbers, depth: Numbers) -> Image:
    """Dots at places `(n, 2)` px, of depth -1 (near) to 1 `(n,)`."""
    sheet: NDArray[Any] = np.full((SIDE, SIDE, 3), PAPER, np.uint8)
    radius = 5 if len(places) <= 100 else 3
    for point in np.argsort(-depth):
        pale = 0.3 * (1 + np.clip(depth[point], -1, 1))
        ink = [round((1 - pale) * channel + pale * PAPER) for channel in identity_colour(int(point))]
        x, y = np.rint(16 * places[point]).astype(int).tolist()
        cv2.circle(sheet, (x, y), radius * 16, ink, cv2.FILLED, cv2.LINE_AA, 4)
    return np.asarray(sheet, np.uint8)


def modes(found: LearnedShape) -> Markup:
    """The mean shape from three sides, and how each mode moves its points."""
    bases = found.learned.bases
    shown = min(len(bases) - 1, MOST_MODES)

    def draw(canvas: "Figure") -> None:
        grid = canvas.subplots(shown, len(SIDES), squeeze=False)
        for k, row in enumerate(grid, start=1):
            ends = bases[0] + SWING * np.array([-1, 1])[:, None, None] * bases[k]
            for axis, (side, across, along) in zip(row, SIDES, strict=True):
                axis.plot(ends[..., across], ends[..., along], color="#808080", linewidth=0.8, zorder=1)
                for end, ink in zip(ends, (BLUE, RED), strict=True):
                    axis.scatter(end[:, across], end[:, along], s=7, color=ink, linewidths=0)
                axis.set_aspect("equal")
                axis.margins(0.08)
                if along == DOWN:
                    axis.invert_yaxis()
                axis.tick_params(labelsize=7)
                if k == 1:
                    axis.set_title(side, fontsize=10)
            row[0].set_ylabel(f"mode {k}")

    left_out = len(bases) - 1 - shown
    caption = f"From {SWING:g} standard deviations below the mean (blue) to as many above it (red)."
    caption += f" {left_out} smaller modes are not shown." if left_out else ""
    return figure(draw, (11, 3.6 * shown), caption)


def held_out(choice: BasesChoice) -> Markup:
    """Errors at positions that were withheld, over the number of bases."""

    def draw(canvas: "Figure") -> None:
        axis: Axes = canvas.subplots()
        axis.plot(choice.candidates, choice.errors, color=BLUE, marker="o", markersize=4)
        at = choice.candidates.index(choice.bases)
        axis.plot(choice.bases, choice.errors[at], color=RED, marker="o", markersize=8, fillstyle="none")
        axis.set_xlabel("bases")
        axis.set_ylabel("error of a coordinate, px")
        from matplotlib.ticker import MaxNLocator

        axis.xaxis.set_major_locator(MaxNLocator(integer=True))

    caption = (
        "Root mean square error per coordinate at positions that were withheld. Chosen (red): the fewest "
        "bases that are no worse than the best by one standard error."
    )
    return figure(draw, (7, 3), caption)


def curves(found: LearnedShape) -> Markup:
    """Weights of the modes, and the error of every frame."""
    learned = found.learned
    squares = np.where(found.observed, np.square(found.residuals).sum(axis=2), np.nan)
    known = np.isfinite(squares).any(axis=1)
    errors = np.full(len(squares), np.nan)
    errors[known] = np.sqrt(np.nanmean(squares[known], axis=1))
    weights = learned.weights.T[:MOST_MODES]
    plots = [
        *((f"weight {k}", [Line("", BLUE, values)]) for k, values in enumerate(weights, start=1)),
        ("error, px", [Line("", BLUE, errors)]),
    ]
    caption = (
        "Weights in standard deviations. Error: root mean square distance (per point, not per coordinate) "
        "between where points were seen in a frame and where the shape has them."
    )
    return over_time(list(found.numbers), plots, caption, axis="frame")

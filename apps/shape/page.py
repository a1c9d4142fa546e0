"""The page of a shape that deforms: points, the shape and its modes in space, weights over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference.sfm.nonrigid.learning import BasesChoice
from ...inference.sfm.nonrigid.shape import NonrigidShape
from ...models.files import write_atomically
from ..io.sources.open_source import DEFAULT_RATE
from ..view.page import BLUE, RED, Line, Page, Plot, Section
from ..view.points import LAYER, SIDES, FollowedPoints, colour_of, film_of_points, packed

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LearnedShape:
    """Shape and the tracks `(n_frames, n_points, 2)` px, NaN where not seen, that it was learned from.

    Frames are numbered from 1. `choice` is how the number of bases was chosen; `None` where it was given.
    """

    tracks: Numbers
    numbers: Sequence[int]
    learned: NonrigidShape
    choice: BasesChoice | None = None

    @property
    def times(self) -> Numbers:
        """`(n_frames,)` s, at the default rate: tracks have none of their own."""
        return (np.array(self.numbers, np.float64) - 1) / DEFAULT_RATE

    @property
    def observed(self) -> NDArray[np.bool_]:
        """`(n_frames, n_points)`: where a point was seen."""
        seen: NDArray[np.bool_] = ~np.isnan(self.tracks[..., 0])
        return seen

    @cached_property
    def shapes(self) -> Numbers:
        """`(n_frames, n_points, 3)` px: where points are seen, and how far behind the object's origin."""
        return self.learned.shapes()

    @cached_property
    def residuals(self) -> Numbers:
        """`(n_frames, n_points, 2)` px: observation less position; NaN where there is none."""
        away: Numbers = self.tracks - self.shapes[..., :2]
        return away

    @cached_property
    def covariances(self) -> Numbers:
        """`(n_frames, n_points, 3, 3)` px^2 of `shapes`."""
        return self.learned.shape_covariances()


SHAPES, MODEL = "shapes.npz", "model.npz"


def write_shapes(path: Path, result: LearnedShape) -> None:
    """Write `shapes.npz`, whole or not at all.

    Point j of frame t is seen at x and y of `shapes[t, j]` = `scales[t] * rotations[t] @ (bases[0, j] + sum_k
    weights[t, k] * bases[k + 1, j])`, with `translations[t]` added to x and y, and finer modes, `details`
    with `detail_weights`, added like the others. `covariance` is that of `shapes` in px^2. What is not known
    of a frame is NaN.
    """
    learned = result.learned
    with write_atomically(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            shapes=result.shapes,
            covariance=result.covariances,
            observed=result.observed,
            rotations=learned.rotations,
            scales=learned.scales,
            translations=learned.translations,
            weights=learned.weights,
            bases=learned.bases,
            details=learned.details,
            detail_weights=learned.detail_weights,
            frame=np.array(result.numbers, np.int64),
            time=result.times,
        )


MOST_MODES = 6
"""In pictures, the largest."""
SWING = 2.0
"""Standard deviations to both sides of the mean, in which 95 % of weights lie."""


def shape_page(title: str, result: LearnedShape, summary: Mapping[str, Any]) -> Page:
    """Return the page of a run."""
    learned = result.learned
    positions = result.shapes[..., :2]
    followed = FollowedPoints(positions, result.covariances[..., :2, :2], result.residuals, "shape and pose")
    film, corner = film_of_points(followed.places, result.numbers, result.times.tolist())
    shown = np.ones(len(film.numbers), np.bool_)
    mean = learned.bases[0]
    layer: dict[str, Any] = {
        "modes": len(learned.bases) - 1,
        "bases": np.concatenate([learned.bases, learned.details]).astype(np.float32),
        "triangles": learned.model().triangles.astype(np.int32),
        "inks": packed(np.array([colour_of(point) for point in range(len(mean))])),
        "rotations": learned.rotations.astype(np.float32),
        "scales": learned.scales.astype(np.float32),
        "weights": np.hstack([learned.weights, learned.detail_weights]).astype(np.float32),
        "size": float(np.nanmean(learned.scales)),
        # a shape that leans out of the mean one still fits
        "reach": 1.25 * float(np.linalg.norm(mean - mean.mean(axis=0), axis=1).max()),
    }
    weights = [
        Plot(f"weight of mode {k}", "s.d.", [Line(values)])
        for k, values in enumerate(learned.weights.T, start=1)
    ]
    sections: list[Section] = [("Modes", _modes(result))]
    if result.choice is not None:
        sections.append(("Number of bases", [_held_out(result.choice)]))
    return Page(
        title,
        cards=_cards(summary),
        notes=summary["notes"],
        film=film,
        layers={LAYER: followed.over(film, shown, corner), "shape": layer},
        timeline=followed.rows(film, shown),
        plots=[*followed.plots(), *weights],
        sections=sections,
        parameters=summary["parameters"],
        numbers=result.numbers,
        times=result.times.tolist(),
        over="frame",
    )


def _cards(summary: Mapping[str, Any]) -> dict[str, str]:
    cards = {
        "frames": f"{summary['frames']}",
        "points": f"{summary['points']}",
        "bases": f"{summary['bases']}",
        "reprojection error per point": f"{summary['reprojection_rmse_px_per_point']:.3g} px",
        "reprojection error per coordinate": f"{summary['reprojection_rmse_px_per_coordinate']:.3g} px",
        "noise of a coordinate": f"{summary['noise_px_per_coordinate']:.3g} px",
    }
    if summary["e3d"] is not None:
        cards["error in 3-D, e3D"] = f"{summary['e3d']:.4f}"
    return cards


def _modes(result: LearnedShape) -> list[Plot]:
    """How each mode moves the points of the mean shape, from three sides."""
    bases = result.learned.bases
    shown = min(len(bases) - 1, MOST_MODES)
    left_out = len(bases) - 1 - shown
    caption = f"From {SWING:g} standard deviations below the mean (blue) to as many above it (red)."
    caption += f" {left_out} smaller modes are not shown." if left_out else ""
    plots: list[Plot] = []
    for k in range(1, shown + 1):
        low, high = bases[0] - SWING * bases[k], bases[0] + SWING * bases[k]
        ways = np.stack([low, high, np.full_like(low, np.nan)], axis=1).reshape(-1, 3)
        for side, across, down in SIDES:
            lines = [
                Line(ways[:, down], "", "#808080", x=ways[:, across]),
                Line(low[:, down], "", BLUE, x=low[:, across], style="dots"),
                Line(high[:, down], "", RED, x=high[:, across], style="dots"),
            ]
            said = caption if not plots else ""
            plots.append(Plot(f"mode {k}, {side}", "xyz"[down], lines, said, axis="xyz"[across], is_map=True))
    return plots


def _held_out(choice: BasesChoice) -> Plot:
    """Errors at positions that were withheld, over the number of bases."""
    candidates, errors = np.array(choice.candidates), np.asarray(choice.errors)
    chosen = candidates == choice.bases
    lines = [Line(errors, x=candidates), Line(errors[chosen], "", RED, x=candidates[chosen], style="dots")]
    caption = (
        "Root mean square error per coordinate at positions that were withheld. Chosen (red): the fewest "
        "bases that are no worse than the best by one standard error."
    )
    return Plot("error of a coordinate", "px", lines, caption, axis="bases")

"""What a run of the shape application has found."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...inference.sfm.nonrigid.learning import BasesChoice
from ...inference.sfm.nonrigid.shape import NonrigidShape
from ...models.files import write_atomically
from ..io.sources.open_source import DEFAULT_RATE

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LearnedShape:
    """A shape and the tracks that it was learned from.

    Parameters
    ----------
    tracks
        `(n_frames, n_points, 2)` px, NaN where a point was not seen.
    numbers
        of the frames, from 1.
    learned
        the shape, its poses and its modes.
    choice
        how the number of bases was chosen; `None` where it was given.
    """

    tracks: Numbers
    numbers: Sequence[int]
    learned: NonrigidShape
    choice: BasesChoice | None = None

    @property
    def times(self) -> Numbers:
        """`(n_frames,)` s: tracks have no rate of their own, and the usual one is taken."""
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


def write_shapes(path: Path, found: LearnedShape) -> None:
    """Write `shapes.npz`, whole or not at all.

    Point j of frame t is seen at x and y of `shapes[t, j]` = `scales[t] * rotations[t] @ (bases[0, j] + sum_k
    weights[t, k] * bases[k + 1, j])`, with `translations[t]` added to x and y, and finer modes, `details`
    with `detail_weights`, added like the others. `covariance` is that of `shapes` in px^2. What is not known
    of a frame is NaN.
    """
    learned = found.learned
    with write_atomically(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            shapes=found.shapes,
            covariance=found.covariances,
            observed=found.observed,
            rotations=learned.rotations,
            scales=learned.scales,
            translations=learned.translations,
            weights=learned.weights,
            bases=learned.bases,
            details=learned.details,
            detail_weights=learned.detail_weights,
            frame=np.array(found.numbers, np.int64),
            time=found.times,
        )

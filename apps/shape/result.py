"""What a run of the shape application has found."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...inference.sfm.nonrigid.learning import BasesChoice
from ...inference.sfm.nonrigid.shape import NonrigidShape
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

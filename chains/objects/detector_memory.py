"""What is remembered of a detector: counts, and moments of its scores."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import Scores

Numbers = NDArray[np.float64]

ASSUMED = 10.0
"""True and false boxes, of each so many, as which the assumption counts that true ones have higher scores."""

APART = 1.0
"""Deviations of all scores by which true and false ones are assumed to be apart."""


@short_repr
@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Weight, mean and mean square of scores, of true and of false boxes.

    Parameters
    ----------
    weights, sums, squares
        `(2,)`: true, false.
    """

    weights: Numbers
    sums: Numbers
    squares: Numbers

    @classmethod
    def none(cls) -> Self:
        """No score was seen."""
        return cls(np.zeros(2), np.zeros(2), np.zeros(2))

    def forgotten(self, kept: float) -> Self:
        """With less weight."""
        return replace(self, weights=kept * self.weights, sums=kept * self.sums, squares=kept * self.squares)

    def with_more(self, scores: Numbers, true: Numbers) -> Self:
        """With the scores of a frame `(n,)`, each true with a probability `(n,)`."""
        share = np.stack([true, 1 - true])
        return replace(
            self,
            weights=self.weights + share.sum(axis=1),
            sums=self.sums + share @ scores,
            squares=self.squares + share @ scores**2,
        )

    def learned(self) -> Scores | None:
        """What scores mean; `None` as long as they are all alike."""
        total = self.weights.sum()
        if total <= 0:
            return None
        mean = self.sums.sum() / total
        variance = self.squares.sum() / total - mean**2
        if not variance > 1e-9 * (1 + mean**2):
            return None
        off = 0.5 * APART * np.sqrt(variance) * np.array([1, -1])
        true, false = (self.sums + ASSUMED * (mean + off)) / (self.weights + ASSUMED)
        means = np.array([true, false])
        inner = (self.squares - 2 * means * self.sums + means**2 * self.weights).sum()
        deviation = np.sqrt((inner + 2 * ASSUMED * variance) / (total + 2 * ASSUMED))
        return Scores(float(true), float(false), float(deviation))


@short_repr
@dataclass(frozen=True, eq=False)
class DetectorState:
    """What is known of a detector.

    Parameters
    ----------
    counts, exposures
        `(4,)`: objects found of those in sight, false boxes of frames, second boxes of found objects,
        newcomers of seconds.
    scores
        of true and false boxes.
    undetected
        people in the picture who were not found yet.
    area
        px of the picture.
    elapsed
        s since the detector has run.
    """

    counts: Numbers
    exposures: Numbers
    scores: ScoreMoments
    undetected: float
    area: float
    elapsed: float

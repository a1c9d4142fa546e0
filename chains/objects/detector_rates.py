"""How reliable a detector is, as a chain: what it finds, how often it errs, and what its scores mean.

Of the share pi that is found, the rates c of false boxes, d of second boxes, b of newcomers:

    pi ~ Beta, c, d, b ~ Gamma, all forgotten slowly
    p(score | true) = N(m_1, s^2), p(score | false) = N(m_0, s^2)
    u_t = u_t-1 (1 - pi) + b dt, people in the picture who were not found yet (Poisson)
    mu_{detector -> boxes} = the detector with the means of all these

It learns from who the boxes turned out to be of (`Association`): nobody sets a threshold for scores. The
undetected number is that of Poisson multi-Bernoulli filters (J. Williams, *Marginal multi-Bernoulli filters*,
2015).
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...models.core.bounds import POSITIVE, PROBABILITY, check_bounds
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BoxMessage, Scores
from ...models.objects.object_boxes import ObjectBoxes

Numbers = NDArray[np.float64]

ASSUMED = 10.0
"""True and false boxes, of each so many, as which the assumption counts that true ones have higher scores."""

APART = 1.0  # deviations of all scores by which true and false ones are assumed to be apart
UNDETECTED = 3.0  # people in the picture of whom nothing is known, before anybody has looked


@short_repr
@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Weights, sums and sums of squares `(2,)` of the scores of true and of false boxes."""

    weights: Numbers
    sums: Numbers
    squares: Numbers

    @classmethod
    def none(cls) -> Self:
        """No score was seen."""
        return cls(np.zeros(2), np.zeros(2), np.zeros(2))

    def forgotten(self, kept: float) -> Self:
        """With less weight."""
        return type(self)(kept * self.weights, kept * self.sums, kept * self.squares)

    def with_more(self, scores: Numbers, true: Numbers) -> Self:
        """With the scores of a frame `(n,)`, each true with a probability `(n,)`."""
        share = np.stack([true, 1 - true])
        weights, sums = self.weights + share.sum(axis=1), self.sums + share @ scores
        return type(self)(weights, sums, self.squares + share @ scores**2)

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
    """What is known of a detector."""

    counts: Numbers  # (4,): objects found, false boxes, second boxes, newcomers
    exposures: Numbers  # (4,): of objects in sight, frames, found objects, seconds
    scores: ScoreMoments
    undetected: float  # people in the picture who were not found yet
    area: float  # px of the picture
    elapsed: float  # s since the detector has run


@short_repr
@dataclass(frozen=True)
class DetectorRates:
    """What is known of a detector, learned while it runs.

    Parameters
    ----------
    found
        share of the time for which it notices an object that is in sight, at first.
    clutter
        false boxes in a frame, at first.
    doubles
        second boxes of an object that it finds, at first.
    newcomers
        1/s, objects that come into the picture, at first.
    memory
        s in which what was learned is forgotten.
    """

    found: float = 0.85
    clutter: float = 0.5
    doubles: float = 0.1
    newcomers: float = 0.2
    memory: float = 60.0
    name: str = "detector"

    ports = (Port(ObjectBoxes, sole="detector"),)

    def __post_init__(self) -> None:
        positive = dict.fromkeys(("clutter", "doubles", "newcomers", "memory"), POSITIVE)
        check_bounds(self, {"found": PROBABILITY, **positive})

    def initial(self, frame: Frame) -> DetectorState:
        """As it is assumed to be."""
        height, width = frame.required_image().shape[:2]
        return DetectorState(
            counts=np.zeros(4),
            exposures=np.zeros(4),
            scores=ScoreMoments.none(),
            undetected=UNDETECTED,
            area=float(height * width),
            elapsed=0.0,
        )

    def predict(self, state: DetectorState, dt: float) -> DetectorState:
        """What was learned is slowly forgotten."""
        kept = math.exp(-dt / self.memory)
        return replace(
            state,
            counts=kept * state.counts,
            exposures=kept * state.exposures,
            scores=state.scores.forgotten(kept),
            elapsed=state.elapsed + dt,
        )

    def message(self, state: DetectorState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage:
        """The detector as it is known (mu_{detector -> objects})."""
        found, clutter, doubles, arriving = self._rates(state)
        return BoxMessage(
            detector=replace(
                feature.detector,
                found=found,
                clutter=clutter / state.area,
                doubles=doubles,
                newcomers=state.undetected + state.elapsed * arriving,
                scores=state.scores.learned(),
            )
        )

    def update(self, state: DetectorState, incoming: Incoming) -> DetectorState:
        """Counts of what was found, missed and false in a frame, each by its probability."""
        association = incoming[ObjectBoxes].association
        if association is None:
            return state
        true, new = association.true, float(association.new.sum())
        hits = float(association.pairs.sum())
        false = float((1 - true - association.double).sum())
        found, _, _, arriving = self._rates(state)
        counts = np.array([hits, false, float(association.double.sum()), new])
        exposures = np.array([hits + float(association.in_sight), 1.0, hits + new, state.elapsed])
        return replace(
            state,
            counts=state.counts + counts,
            exposures=state.exposures + exposures,
            scores=state.scores.with_more(association.scores, true),
            undetected=(state.undetected + state.elapsed * arriving) * (1 - found),
            elapsed=0.0,
        )

    def _rates(self, state: DetectorState) -> tuple[float, float, float, float]:
        """Means of found, clutter, doubles and newcomers, with what is assumed as if seen before."""
        assumed = np.array([self.found, self.clutter, self.doubles, self.newcomers])
        weight = np.array([10.0, 4.0, 10.0, 5.0])
        found, clutter, doubles, newcomers = (
            (assumed * weight + state.counts) / (weight + state.exposures)
        ).tolist()
        return min(found, 0.99), clutter, doubles, newcomers

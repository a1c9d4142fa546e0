"""Reliability of a detector, as a chain: how often it detects and errs, and what its scores mean.

Of the share pi that is detected, the rates c of false boxes, d of second boxes, b of newcomers:

    pi ~ Beta, c, d, b ~ Gamma, all forgotten slowly
    false boxes in a place where the detector has erred again and again: a Poisson rate there, besides c
    p(score | true) = N(m_1, s^2), p(score | false) = N(m_0, s^2), m_1 - m_0 = 1.4 s
    u_t = u_t-1 (1 - pi) + b dt, people in the picture who were not detected yet (Poisson)
    mu_{detector -> boxes} = the detector with the means of all these

Boxes count by their association with objects (`Association`); scores need no threshold. The undetected
number is that of Poisson multi-Bernoulli filters (J. Williams, *Marginal multi-Bernoulli filters*,
2015).
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...models.core.checks import NotNegative, Positive, Probability, Shape, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BOX, Association, BoxMessage, ErrorPlaces, LogOdds, Scores
from ...models.objects.object_boxes import ObjectBoxes

Array = NDArray[np.float64]

ASSUMED, TRUE = 10.0, 0.7  # boxes, and the share of true ones among them, before any was judged
APART = 1.4
"""Deviations of either kind by which the means of true and false scores are apart.

Measured of ACF and DPM on four sequences: 1.2 to 1.6. Learned it shrinks, as false boxes count as true.
"""

CHANCE, SINCE = 5.0, 20.0
"""False boxes in one place that are there by chance, and frames without one before the first; guesses."""

ALIKE = 2.0  # deviations of its errors by which a box may be off a place
FADED = 0.1  # boxes, below which a place is forgotten

UNDETECTED = 3.0  # people in the picture at the first frame; a guess, forgotten within a few frames


@short_repr
@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Weights of true and of false boxes, and sum and sum of squares of the scores of both."""

    weights: Annotated[Array, Shape(2)]
    total: float
    squares: float

    @classmethod
    def empty(cls) -> Self:
        """Return the moments of no scores."""
        return cls(np.zeros(2), 0.0, 0.0)

    def scaled(self, kept: float) -> Self:
        """Return the moments with weights times `kept`."""
        return type(self)(kept * self.weights, kept * self.total, kept * self.squares)

    def updated(self, scores: Array, true: Array) -> Self:
        """Return the moments with the scores `(n,)` of a frame, each true with a probability `(n,)`."""
        weights = self.weights + np.array([true.sum(), (1 - true).sum()])
        return type(self)(weights, self.total + float(scores.sum()), self.squares + float((scores**2).sum()))

    def distributions(self) -> Scores | None:
        """Return the distributions of true and false scores; `None` as long as all scores are alike."""
        weight = self.weights.sum()
        if weight <= 0:
            return None
        mean, square = self.total / weight, self.squares / weight
        variance = square - mean**2
        if not variance > 1e-9 * square:  # but for rounding
            return None
        share = (self.weights[0] + ASSUMED * TRUE) / (weight + ASSUMED)
        within = np.sqrt(variance / (1 + share * (1 - share) * APART**2))
        true, false = (mean + APART * within * np.array([1 - share, -share])).tolist()
        return Scores(true, false, float(within))


@short_repr
@dataclass(frozen=True, eq=False)
class DetectorState:
    """Counts and exposures of a detector's rates, with its scores."""

    counts: Annotated[Array, Shape(4)]  # detected objects, false boxes, second boxes, newcomers
    exposures: Annotated[Array, Shape(4)]  # of objects in sight, frames, detected objects, seconds
    scores: ScoreMoments
    undetected: NotNegative  # people in the picture who were not detected yet
    places: Annotated[Array, Shape("n", 4)]  # px: boxes where the detector has erred
    # of each: errors that are over; boxes of a present candidate, and the probability that it is one
    errors: Annotated[Array, Shape("n", 3)]
    candidates: Annotated[NDArray[np.int64], Shape("n")]  # identities of those; 0: none
    area: Positive  # px of the picture
    elapsed: NotNegative  # s since the detector has run


@checked
@short_repr
@dataclass(frozen=True)
class DetectorRates:
    """Rates of a detector, learned while it runs.

    Each rate has a conjugate Beta or Gamma distribution, whose counts are the state: its means are exact. No
    generic chain fits: the state is neither Gaussian nor one of a few values.

    Parameters
    ----------
    detection_probability
        initial probability of detecting a visible object.
    clutter
        initial number of false boxes per frame.
    doubles
        initial number of second boxes per detected object.
    newcomers
        1/s, initial rate of new objects.
    memory
        s, time constant of forgetting.
    """

    detection_probability: Probability = 0.85
    clutter: Positive = 0.5
    doubles: Positive = 0.1
    newcomers: Positive = 0.2
    memory: Positive = 60.0
    name: str = "detector"

    ports = (Port(ObjectBoxes, sole="detector"),)

    def initial(self, frame: Frame) -> DetectorState:
        """Return the state without observations, with the rates of the parameters."""
        height, width = frame.required_image().shape[:2]
        return DetectorState(
            counts=np.zeros(4),
            exposures=np.zeros(4),
            scores=ScoreMoments.empty(),
            undetected=UNDETECTED,
            places=np.zeros((0, BOX)),
            errors=np.zeros((0, 3)),
            candidates=np.zeros(0, np.int64),
            area=float(height * width),
            elapsed=0.0,
        )

    def predict(self, state: DetectorState, dt: float) -> DetectorState:
        """Return the counts `dt` seconds on, with exponential forgetting."""
        kept = math.exp(-dt / self.memory)
        return replace(
            state,
            counts=kept * state.counts,
            exposures=kept * state.exposures,
            scores=state.scores.scaled(kept),
            errors=state.errors * [kept, kept, 1.0],
            elapsed=state.elapsed + dt,
        )

    def message(self, state: DetectorState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage:
        """Return the detector with the mean rates (mu_{detector -> objects})."""
        detected, clutter, doubles, arriving = self._rates(state)
        often = state.errors[:, 0] > CHANCE
        rates = (state.errors[often, 0] - CHANCE) / (SINCE + state.exposures[1])
        return BoxMessage(
            places=ErrorPlaces(state.places[often], rates),
            detector=replace(
                feature.detector,
                found=detected,
                clutter=clutter / state.area,
                doubles=doubles,
                newcomers=state.undetected + state.elapsed * arriving,
                scores=state.scores.distributions(),
            ),
        )

    def update(self, state: DetectorState, incoming: Incoming) -> DetectorState:
        """Return the counts with a frame's detected, missed and false boxes, each by its probability."""
        boxes, association = incoming[ObjectBoxes], incoming.evidence(ObjectBoxes).association
        if association is not None:
            state = self._updated(state, association, boxes.existence)
        view = boxes.view
        if view is None or view.begins is None:
            return state
        return replace(state, places=view.map.boxes(state.places))

    def _updated(self, state: DetectorState, association: Association, existence: LogOdds) -> DetectorState:
        true, new = association.true, float(association.new.sum())
        hits, false = float(association.pairs.sum()), float(association.false.sum())
        detected, _, _, arriving = self._rates(state)
        counts = np.array([hits, false, float(association.double.sum()), new])
        exposures = np.array([hits + float(association.in_sight), 1.0, hits + new, state.elapsed])
        return replace(
            _with_errors(state, association, existence),
            counts=state.counts + counts,
            exposures=state.exposures + exposures,
            scores=state.scores.updated(association.scores, true),
            undetected=(state.undetected + state.elapsed * arriving) * (1 - detected),
            elapsed=0.0,
        )

    def _rates(self, state: DetectorState) -> tuple[float, float, float, float]:
        """Means of detection probability, clutter, doubles and newcomers, given prior counts."""
        assumed = np.array([self.detection_probability, self.clutter, self.doubles, self.newcomers])
        weight = np.array([10.0, 4.0, 10.0, 5.0])
        detected, clutter, doubles, newcomers = (
            (assumed * weight + state.counts) / (weight + state.exposures)
        ).tolist()
        return min(detected, 0.99), clutter, doubles, newcomers


def _with_errors(state: DetectorState, association: Association, existence: LogOdds) -> DetectorState:
    """Return the state with the boxes of a frame that may be errors, each in its place."""
    boxes, places = association.boxes, state.places
    nobody = 1 - association.followed.sum(axis=0, keepdims=True)
    likeliest = np.concatenate([nobody, association.followed]).argmax(axis=0)
    whose = np.concatenate([[0], association.identities])[likeliest]
    known = whose > 0
    false = np.clip(1 - association.true - association.double, 0, 1)
    false[known] = 0.5 - 0.5 * np.tanh(0.5 * existence.of(whose[known]))
    off = (np.abs(boxes[:, None] - places) / np.sqrt(association.noise)[:, None]).max(axis=2)
    is_new = off.min(axis=1, initial=np.inf) > ALIKE
    nearest = np.where(is_new, len(places) - 1 + is_new.cumsum(), 0)
    nearest[~is_new] = off[~is_new].argmin(axis=1) if len(places) else 0
    more = (0, int(is_new.sum()))
    places, before = np.concatenate([places, boxes[is_new]]), np.pad(state.candidates, more)
    errors = np.pad(state.errors, (more, (0, 0)))
    candidates = np.where(np.isin(before, association.identities), before, 0)
    candidates[nearest[known]] = whose[known]
    over = candidates != before
    errors[over, 0] += errors[over, 1] * errors[over, 2]
    errors[over, 1:] = 0.0
    for identity, share in zip(whose[known].tolist(), false[known].tolist(), strict=True):
        errors[candidates == identity, 2] = share
    np.add.at(errors[:, 0], nearest, np.where(known, 0.0, false))
    np.add.at(errors[:, 1], nearest, known)
    count, sums = errors[:, 0] + errors[:, 1] * errors[:, 2], np.zeros(places.shape)
    np.add.at(sums, nearest, false[:, None] * (boxes - places[nearest]))
    places = places + sums / np.maximum(count, FADED)[:, None]
    lasting = count > FADED
    return replace(state, places=places[lasting], errors=errors[lasting], candidates=candidates[lasting])

"""Which hand is left, decided by the evidence of a whole film.

A filter may take the hands for each other where they meet or are hidden, and then go on with the wrong
names: hands never exchange in the world. Whether they are exchanged in a frame, z_t, is a Markov chain of two
states,

    p(z_t != z_t-1) = (1 - exp(-2 r dt)) / 2,    r = APART + c_t TOGETHER,
    p(I_t | z_t) ~ mean over arms of p(I_t | hands where they are, by the names of z_t; arms)

with c_t the chance that the hands could be confused. Forward-backward gives the probability of each frame,
Viterbi's algorithm the best sequence (Rabiner, "A tutorial on hidden Markov models", 1989).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ....models.body.inverse_kinematics import arm_at
from ....models.body.poses import BodyPoses
from ....models.body.upper_body import UpperBody
from ....models.core.short_repr import short_repr
from ...filters.resampling import log_sum, systematic
from ..dynamics import BodyDynamics
from ..samples import BodySamples
from ..tempering import LogDensity

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

POSES, ELBOWS = 24, 8
"""Poses of a frame whose hands are given both names, and elbows that are tried for each."""

PAIRS = 50
"""Of left and right hands that are compared; so many poses with exchanged names are kept, too."""

MOST = 10.0
"""Nats: one frame says no more than this; the likelihood is not right to that degree."""

MEMORY = 0.2
"""s: frames of so short a time say the same again, as arms hardly move and edges stay where they are."""

APART, TOGETHER = 0.002, 1.0
"""Exchanges in one second by mistake, of hands that are apart, and of hands that could be confused."""

MISTAKEN = 0.05
"""Probability that a filter has begun with the wrong names: it has weighed both."""

NEAR = 3.0
"""Hand radii: hands that are so near could be confused."""


@short_repr
@dataclass(frozen=True, eq=False)
class HandLabels:
    """Whether left and right are exchanged in each frame of a film.

    Parameters
    ----------
    numbers
        `(n,)` of the frames.
    probabilities
        `(n,)`, of an exchange: given the whole film.
    exchanged
        `(n,)`: the most probable sequence.
    so_far
        `(n,)` nats: log odds of an exchange given the film up to the frame.
    """

    numbers: NDArray[np.int64]
    probabilities: Array
    exchanged: Mask
    so_far: Array


@short_repr
@dataclass(frozen=True)
class ExchangeEvidence:
    """What one frame says of the names of the hands.

    Parameters
    ----------
    log_odds
        nats: that they are exchanged against that they are not.
    confusable
        probability that the hands are so near each other in the picture that they could be confused.
    """

    log_odds: float = 0.0
    confusable: float = 0.0


NOTHING_SAID = ExchangeEvidence()


@dataclass(eq=False)
class Labelling:
    """Gathers what frames say of the names of the hands: a few numbers each.

    Parameters
    ----------
    numbers, times
        of the frames so far; s.
    evidence
        of each.
    """

    numbers: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    evidence: list[ExchangeEvidence] = field(default_factory=list)

    def add(self, number: int, time: float, evidence: ExchangeEvidence) -> None:
        """Take in a frame, later than those before."""
        self.numbers.append(number)
        self.times.append(time)
        self.evidence.append(evidence)

    def result(self) -> HandLabels:
        """Labels of all frames so far."""
        return hand_labels(
            np.array(self.numbers, np.int64),
            np.array(self.times),
            np.array([each.log_odds for each in self.evidence]),
            np.array([each.confusable for each in self.evidence]),
        )


def both_names(
    dynamics: BodyDynamics,
    samples: BodySamples,
    log_likelihood: LogDensity | None,
    random: np.random.Generator,
) -> tuple[ExchangeEvidence, BodyPoses]:
    """What a frame says of the names of the hands, and poses with exchanged ones, evenly weighted.

    In both cases hands stay where they are in space and elbows are drawn anew. There are no poses where
    that is impossible. Without a likelihood, the frame says nothing.
    """
    body = dynamics.body
    some = samples.drawn(2 * PAIRS, random)
    hands = body.parts(some)[random.permutation(2 * PAIRS), 1:]  # far from each other if nobody knows where
    squares = np.square(hands[:PAIRS, 0] - hands[PAIRS:, 1]).sum(axis=1)
    near = float((squares < (NEAR * body.hand) ** 2).mean())
    few = some.take(random.permutation(2 * PAIRS)[:POSES].repeat(ELBOWS))
    values, drawn = [], few
    for swap in (False, True):
        drawn, possible = _with_any_elbows(body, few, swap, random)
        value = np.full(len(few), -np.inf)
        if possible.any():
            tried = drawn.take(possible)
            value[possible] = dynamics.log_posture(tried)
            if log_likelihood is not None:
                value[possible] += log_likelihood(tried)
        values.append(value)
    kept, exchanged = map(log_sum, values)
    poses = drawn.take(systematic(values[1], PAIRS, random) if np.isfinite(exchanged) else slice(0))
    if log_likelihood is None or np.isneginf([kept, exchanged]).all():
        return ExchangeEvidence(0.0, near), poses
    return ExchangeEvidence(float(np.clip(exchanged - kept, -MOST, MOST)), near), poses


def hand_labels(
    numbers: NDArray[np.int64],
    times: Array,
    log_odds: Array,
    confusable: Array,
    known: float | None = None,
) -> HandLabels:
    """Labels of all frames by what each says.

    Parameters
    ----------
    numbers, times, log_odds, confusable
        `(n,)`, of frames in the order of time, and their `ExchangeEvidence`.
    known
        nats: log odds of the first frame, given all up to it; `None` where it is the first of all.
    """
    n = len(times)
    if not n:
        return HandLabels(numbers, np.zeros(0), np.zeros(0, np.bool_), np.zeros(0))
    steps = np.diff(times, prepend=times[0] - MEMORY)
    evidence = np.zeros((n, 2))
    evidence[:, 1] = log_odds * np.minimum(steps / MEMORY, 1.0)
    evidence[0, 1] = evidence[0, 1] + np.log(MISTAKEN / (1 - MISTAKEN)) if known is None else known
    # a frame in which they could be confused lasts from the one before to the one after
    rates = APART + TOGETHER * np.maximum(confusable[1:], confusable[:-1])
    changes = -0.5 * np.expm1(-2 * rates * steps[1:])
    forward, best, origins = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2), np.int64)
    backward = np.zeros((n, 2))
    logs = [np.log([[1 - change, change], [change, 1 - change]]) for change in changes]
    for index in range(n):
        if index:
            moved = best[index - 1][:, None] + logs[index - 1]
            origins[index], best[index] = moved.argmax(axis=0), moved.max(axis=0)
            forward[index] = np.logaddexp(*(forward[index - 1][:, None] + logs[index - 1]))
        forward[index] += evidence[index]
        best[index] += evidence[index]
    for index in range(n - 2, -1, -1):
        backward[index] = np.logaddexp(*(logs[index] + backward[index + 1] + evidence[index + 1]).T)
    both = forward + backward
    labels = np.zeros(n, np.int64)
    for index in range(n - 1, -1, -1):
        labels[index] = best[-1].argmax() if index == n - 1 else origins[index + 1, labels[index + 1]]
    odds = np.clip(both[:, 1] - both[:, 0], -700, 700)
    return HandLabels(numbers, 1 / (1 + np.exp(-odds)), labels == 1, forward[:, 1] - forward[:, 0])


def _with_any_elbows(
    body: UpperBody, poses: BodyPoses, swap: bool, random: np.random.Generator
) -> tuple[BodyPoses, Mask]:
    """Poses whose hands are where they are, or where the other one is, and which of them are possible."""
    n, joints = len(poses), body.joints(poses)
    arms, within = np.empty_like(poses.arms), np.ones(n, np.bool_)
    for side in (0, 1):
        hand = joints[:, 4 + 3 * (1 - side if swap else side)]
        swivels = random.uniform(-np.pi, np.pi, n)
        arms[:, side], reached = arm_at(body, side, hand - joints[:, 2 + 3 * side], swivels)
        within &= reached
    posed = replace(poses, arms=arms)
    return posed, within & body.allowed(posed)

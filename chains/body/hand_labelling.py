"""Which hand is left, decided by the evidence of a whole film, and results with the names of hands exchanged.

A filter may take the hands for each other where they meet or are hidden, and then go on with the wrong
names: hands never exchange in the world. Whether they are exchanged in a frame, z_t, is a Markov chain of two
states,

    p(z_t != z_t-1) = (1 - exp(-2 r dt)) / 2,    r = APART + c_t TOGETHER,
    p(I_t | z_t) ~ mean over arms of p(I_t | hands where they are in the picture, by the names of z_t; arms)

with c_t the chance that the hands could be confused. Arms are any that joints allow and that bring the hands
there: both names are treated alike, as a filter's own arms have been chosen for its own names by this very
image. How usual a posture is does not count: the dynamics have weighed it, and a hand that stays on the other
side would say it anew in every frame. Forward-backward gives the probability of each frame, Viterbi's
algorithm the best sequence (Rabiner, "A tutorial on hidden Markov models", 1989).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, systematic
from ...models.body.upper_body import (
    ANGLES,
    JOINTS,
    BodyPoses,
    UpperBody,
    arm_at,
    shoulder_rotations,
    swivels,
)
from ...models.core.short_repr import short_repr
from ...models.numerics.rotations import logarithm
from .dynamics import BodyDynamics
from .proposals import half_range
from .samples import BodySamples, weighted_moments
from .tempering import LogDensity

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

POSES, ARMS, LOOKED_AT = 32, 64, 256
"""Poses of a frame whose hands are given both names, pairs of arms that are tried for each, and how many of
those that are possible are compared with the image, at most: as many for either names, since the logarithm of
a mean over few is too small on average."""

PAIRS = 50  # of left and right hands that are compared; so many poses with exchanged names are kept, too

MOST = 3.0
"""Nats: one look at the picture says no more than this, odds of 20; the likelihood is not right to a greater
degree, as arms and clothes are not quite what it takes them for."""

LOOK = 0.2
"""s: frames of so short a time count as one look. Signing hands go from one place to the next in about so
long; until then an arm is as it was, and where the likelihood errs it errs again."""

SURE = 0.99
"""Probability that has to be reached somewhere in a stretch before its names are exchanged: what a filter
says is the better answer until then, since it has weighed more than arms."""

MOST_DOUBT = 0.3  # most share of poses with exchanged names where that is not sure
APART, TOGETHER = 0.01, 0.3  # exchanges in a second by mistake, of hands apart and of confusable ones
MISTAKEN = 0.05  # probability that a filter has begun with the wrong names: it has weighed both
NEAR = 3.0  # hand radii: hands that are so near could be confused


@short_repr
@dataclass(frozen=True, eq=False)
class HandLabels:
    """Whether left and right are exchanged in each frame of a film."""

    numbers: NDArray[np.int64]  # `(n,)` of the frames
    probabilities: Array  # `(n,)`, of an exchange: given the whole film
    exchanged: Mask  # `(n,)`: the most probable sequence, without stretches that are not sure
    so_far: Array  # `(n,)` nats: log odds of an exchange given the film up to the frame

    @property
    def shares(self) -> Array:
        """`(n,)`: of an exchange, as probabilities; no more than a doubt where it is not sure."""
        return np.where(self.exchanged, self.probabilities, np.minimum(self.probabilities, MOST_DOUBT))


@short_repr
@dataclass(frozen=True)
class ExchangeEvidence:
    """What one frame says of the names of the hands."""

    log_odds: float = 0.0  # nats: that they are exchanged against that they are not
    # probability that the hands are so near each other in the picture that they could be confused
    confusable: float = 0.0


NOTHING_SAID = ExchangeEvidence()


@dataclass(eq=False)
class Labelling:
    """Gathers what frames say of the names of the hands: a few numbers each."""

    # of the frames so far; s
    numbers: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    evidence: list[ExchangeEvidence] = field(default_factory=list)  # of each

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

    Hands stay where they are in the picture; their depths and the elbows are drawn anew, for both names in
    the same way. There are no poses where that is impossible. Without a likelihood, the frame says nothing.
    """
    body = dynamics.body
    some = samples.drawn(2 * PAIRS, random)
    hands = body.parts(some)[random.permutation(2 * PAIRS), 1:]  # far from each other if nobody knows where
    squares = np.square(hands[:PAIRS, 0] - hands[PAIRS:, 1]).sum(axis=1)
    near = float((squares < (NEAR * body.hand) ** 2).mean())
    few = some.take(random.permutation(2 * PAIRS)[:POSES].repeat(ARMS))
    own, other = (_with_any_arms(body, few, swap, random) for swap in (False, True))
    # as trajectories go through these, hands stay where they are in space if they can
    poses = _with_any_arms(body, few, True, random, deep=True) or other
    if log_likelihood is None or not (len(own) or len(other)):
        return ExchangeEvidence(0.0, near), poses.take(slice(PAIRS))
    compared = min(len(own), len(other), LOOKED_AT) or LOOKED_AT
    kept, exchanged = (_log_mean(each, compared, log_likelihood) for each in (own, other))
    if len(poses):
        poses = poses.take(slice(LOOKED_AT))
        poses = poses.take(systematic(log_likelihood(poses), PAIRS, random))
    if np.isneginf([kept, exchanged]).all():
        return ExchangeEvidence(0.0, near), poses
    return ExchangeEvidence(float(np.clip(exchanged - kept, -MOST, MOST)), near), poses


def hand_labels(
    numbers: NDArray[np.int64], times: Array, log_odds: Array, confusable: Array, known: float | None = None
) -> HandLabels:
    """Labels of all frames by what each says.

    `numbers`, `times`, `log_odds`, `confusable` `(n,)`, of frames in the order of time, and their
    `ExchangeEvidence`; `known` nats: log odds of the first frame, given all up to it; `None` where it is the
    first of all.
    """
    n = len(times)
    if not n:
        return HandLabels(numbers, np.zeros(0), np.zeros(0, np.bool_), np.zeros(0))
    steps = np.diff(times, prepend=times[0] - LOOK)
    evidence = np.zeros((n, 2))
    evidence[:, 1] = log_odds * np.minimum(steps / LOOK, 1.0)
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
    probabilities = 1 / (1 + np.exp(-odds))
    exchanged = _sure(labels == 1, probabilities)
    return HandLabels(numbers, probabilities, exchanged, forward[:, 1] - forward[:, 0])


def _sure(exchanged: Mask, probabilities: Array) -> Mask:
    """Without the stretches in which an exchange is sure nowhere."""
    stretches = np.cumsum(np.diff(exchanged, prepend=exchanged[:1]))
    certain = np.unique(stretches[exchanged & (probabilities > SURE)])
    return np.asarray(exchanged & np.isin(stretches, certain))


def _with_any_arms(
    body: UpperBody, poses: BodyPoses, swap: bool, random: np.random.Generator, *, deep: bool = False
) -> BodyPoses:
    """Possible ones of the poses, shuffled, with hands in place or swapped, elbows (and depths) anywhere."""
    n, joints = len(poses), body.joints(poses)
    arms, within = np.empty_like(poses.arms), np.ones(n, np.bool_)
    for side in (0, 1):
        offsets = joints[:, 4 + 3 * (1 - side if swap else side)] - joints[:, 2 + 3 * side]
        if not deep:
            offsets[:, 2] = half_range(body, offsets) * random.uniform(-1, 1, n)
        arms[:, side], reached = arm_at(body, side, offsets, random.uniform(-np.pi, np.pi, n))
        within &= reached
    posed = replace(poses, arms=arms)
    return posed.take(random.permutation(np.flatnonzero(within & body.allowed(posed))))


def _log_mean(poses: BodyPoses, n: int, log_likelihood: LogDensity) -> float:
    """Log of the mean likelihood of all that were tried, from `n` of those that are possible."""
    if not len(poses):
        return -np.inf
    few = poses.take(slice(n))
    return log_sum(log_likelihood(few)) + float(np.log(len(poses) / (POSES * ARMS * len(few))))


Row = Mapping[str, NDArray[Any]]

SHOULDERS, ELBOWS, HANDS = (
    [JOINTS.index(f"{side}_{name}") for side in ("left", "right")] for name in ("shoulder", "elbow", "hand")
)
OF_ARMS = slice(ANGLES - 8, ANGLES)
ROWS = {
    "joints_2d", "joints_2d_covariances", "joints_3d", "joints_3d_covariances", "angles", "angle_covariances",
    "samples", "hypotheses", "hypothesis_joints", "seen", "relabelled",
}  # fmt: skip
EXCHANGED_PARTS = [0, 2, 1]


def with_names_exchanged(body: UpperBody, row: Row) -> dict[str, NDArray[Any]]:
    """A row of `poses.npz` with each hand where the other one was.

    Arms lead there with their elbows turned as they were; one that is too short ends on its way. Elbows and
    angles of arms are then those of the poses that were drawn, whose arms no longer say anything of the rest.
    """
    samples, arms = _exchanged(body, row["samples"].astype(np.float64))
    others, _ = _exchanged(body, row["hypothesis_joints"])
    joints, covariances = row["joints_3d"].copy(), row["joints_3d_covariances"].copy()
    joints[HANDS], covariances[HANDS] = joints[HANDS[::-1]], covariances[HANDS[::-1]]
    even = np.full(len(samples), 1 / len(samples))
    joints[ELBOWS], covariances[ELBOWS] = weighted_moments(samples[:, ELBOWS], even)
    rotations, flexions = shoulder_rotations(arms)
    turns = logarithm(rotations.reshape(-1, 3, 3)).reshape(len(arms), 2, 3)
    of_arms = np.concatenate([turns, flexions[..., None]], axis=2).reshape(len(arms), -1)
    angles, angle_covariances = row["angles"].copy(), row["angle_covariances"].copy()
    angles[OF_ARMS] = of_arms.mean(axis=0)
    angle_covariances[OF_ARMS] = angle_covariances[:, OF_ARMS] = 0
    angle_covariances[OF_ARMS, OF_ARMS] = np.cov(of_arms, rowvar=False, bias=True)
    return {
        **row,
        "joints_2d": joints[:, :2],
        "joints_2d_covariances": covariances[:, :2, :2],
        "joints_3d": joints,
        "joints_3d_covariances": covariances,
        "angles": angles,
        "angle_covariances": angle_covariances,
        "samples": samples.astype(np.float32),
        "hypothesis_joints": others,
        "seen": row["seen"][EXCHANGED_PARTS],
        "relabelled": ~row["relabelled"],
    }


def relabelled(
    body: UpperBody, poses: Mapping[str, NDArray[Any]], exchanged: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Columns of `poses.npz` with the names exchanged in these rows `(n,)`, and `relabelled`, which are."""
    columns = {**poses, "relabelled": np.zeros(len(exchanged), np.bool_)}
    if exchanged.any():
        columns |= {name: columns[name].copy() for name in ROWS}
    for index in np.flatnonzero(exchanged).tolist():
        row = with_names_exchanged(body, {name: columns[name][index] for name in ROWS})
        for name in ROWS:
            columns[name][index] = row[name]
    return columns


def _exchanged(body: UpperBody, joints: Array) -> tuple[Array, Array]:
    """Joints `(n, 8, 3)` px with exchanged hands, and arms `(n, 2, 2, 3)` that lead there."""
    joints, hands = joints.copy(), joints[:, HANDS[::-1]]
    lengths = np.array([body.upper_arm, body.forearm])
    arms = np.full((len(joints), 2, 2, 3), np.nan)
    there = np.isfinite(hands).all(axis=(1, 2))
    for side in (0, 1):
        shoulder, elbow, hand = (joints[there, each[side]] for each in (SHOULDERS, ELBOWS, HANDS))
        before = np.stack([elbow - shoulder, hand - elbow], axis=1) / lengths[:, None]
        arms[there, side] = arm_at(body, side, hands[there, side] - shoulder, swivels(side, before, body))[0]
        steps = np.cumsum(lengths[:, None] * arms[:, side], axis=1)
        for joint, step in ((ELBOWS[side], 0), (HANDS[side], 1)):
            joints[:, joint] = joints[:, SHOULDERS[side]] + steps[:, step]
    return joints, arms

"""Left and right hand, decided by a whole film, and results with exchanged hands.

A filter may mistake the hands for each other where they meet or are hidden, and keep the wrong labels.
Whether they are exchanged in a frame, z_t, is a Markov chain of two states,

    p(z_t != z_t-1) = (1 - exp(-2 r dt)) / 2,    r = APART + c_t TOGETHER,
    p(I_t | z_t) ~ mean over arms of p(I_t | positions of the hands in the image, labelled by z_t; arms)

with c_t the probability that the hands could be confused. Arms are drawn from all that joints allow, for both
labellings alike: the filter's own arms were chosen by this very image for its own labels. The prior of
postures is left out, since the dynamics have counted it already. Forward-backward gives the probability of
each frame, Viterbi's algorithm the best sequence (Rabiner, "A tutorial on hidden Markov models", 1989).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, systematic
from ...models.body.upper_body import (
    ANGLES,
    JOINTS,
    REFERENCE,
    BodyPoses,
    UpperBody,
    arm_at,
    shoulder_rotations,
    swivels,
)
from ...models.core.short_repr import short_repr
from ...models.numerics.rotations import logarithm
from .dynamics import BodyDynamics
from .kernels.proposals import redraw_arms
from .proposals import LEAST_DEPTH
from .samples import BodySamples, weighted_moments
from .tempering import LogDensity

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

POSES, ARMS, COMPARED = 32, 64, 256
"""Poses of a frame that are tried with both labellings, pairs of arms drawn for each, and how many possible
ones are compared with the image, at most: as many of either, since the log of a mean over few is biased."""

PAIRS = 50  # of left and right hands that are compared; number of poses with exchanged hands that are kept

MOST = 3.0
"""Nats: bound of one frame's evidence, odds of 20: the likelihood's arms and clothes are not exact."""

CORRELATION_TIME = 0.2
"""s: frames of so short a time count as one observation. Signing hands move to the next position in about so
long; until then the likelihood's errors are the same."""

SURE = 0.99
"""Probability that has to be reached somewhere in a stretch of frames before its hands are exchanged: until
then the filter's labels are the better ones, since it has used more than arms."""

MOST_DOUBT = 0.3  # share of poses with exchanged hands, at most, where that is not sure
APART, TOGETHER = 0.01, 0.3  # rates of mistaken exchanges, 1/s, of hands apart and of confusable ones
MISTAKEN = 0.05  # probability that a filter has started with exchanged hands
NEAR = 3.0  # hand radii: hands that are so near each other could be confused


@short_repr
@dataclass(frozen=True, eq=False)
class HandLabels:
    """Whether left and right hand are exchanged in each frame of a film."""

    numbers: NDArray[np.int64]  # `(n,)` of the frames
    probabilities: Array  # `(n,)`: of an exchange, given the whole film
    exchanged: Mask  # `(n,)`: the most probable sequence, without stretches that are not sure
    filtered_log_odds: Array  # `(n,)` nats: of an exchange, given the film up to the frame

    @property
    def shares(self) -> Array:
        """`(n,)`: `probabilities`, but `MOST_DOUBT` at most in frames that are not `exchanged`."""
        return np.where(self.exchanged, self.probabilities, np.minimum(self.probabilities, MOST_DOUBT))


@short_repr
@dataclass(frozen=True)
class ExchangeEvidence:
    """Evidence of one frame that left and right hand are exchanged."""

    log_odds: float = 0.0  # nats: exchanged against not
    confusable: float = 0.0  # probability that the hands are near enough in the image to be confused


NO_EVIDENCE = ExchangeEvidence()


@dataclass(eq=False)
class Labelling:
    """Labels of the hands from the evidence of many frames."""

    numbers: list[int] = field(default_factory=list)  # of the frames so far
    times: list[float] = field(default_factory=list)  # s
    evidence: list[ExchangeEvidence] = field(default_factory=list)

    def add(self, number: int, time: float, evidence: ExchangeEvidence) -> None:
        """Add a frame, later than those before."""
        self.numbers.append(number)
        self.times.append(time)
        self.evidence.append(evidence)

    def result(self) -> HandLabels:
        """Label the hands in all frames so far."""
        return label_hands(
            np.array(self.numbers, np.int64),
            np.array(self.times),
            np.array([each.log_odds for each in self.evidence]),
            np.array([each.confusable for each in self.evidence]),
        )


def exchange_evidence(
    dynamics: BodyDynamics,
    samples: BodySamples,
    log_likelihood: LogDensity | None,
    random: np.random.Generator,
) -> tuple[ExchangeEvidence, BodyPoses]:
    """Return a frame's evidence of exchanged hands, and poses with exchanged hands, equally weighted.

    Hands keep their positions in the image; depths and elbows are drawn again, for both labellings alike.
    There may be no possible pose. Without a likelihood the log odds are 0.
    """
    body = dynamics.body
    some = samples.resample(2 * PAIRS, random)
    hands = body.parts(some)[
        random.permutation(2 * PAIRS), 1:
    ]  # of different poses: uncertain hands are apart
    squares = np.square(hands[:PAIRS, 0] - hands[PAIRS:, 1]).sum(axis=1)
    near = float((squares < (NEAR * body.hand) ** 2).mean())
    few = some.take(random.permutation(2 * PAIRS)[:POSES])
    own, other = (_draw_arms(body, few, swap, random) for swap in (False, True))
    # trajectories go through these: hands keep their depths if they can
    poses = _first(_draw_arms(body, few, True, random, deep=True), COMPARED) or _first(other, COMPARED)
    if log_likelihood is None or not (len(own[1]) or len(other[1])):
        return ExchangeEvidence(0.0, near), poses.take(slice(PAIRS))
    compared = min(len(own[1]), len(other[1]), COMPARED) or COMPARED
    kept, exchanged = (_log_mean(each, compared, log_likelihood) for each in (own, other))
    if len(poses):
        poses = poses.take(systematic(log_likelihood(poses), PAIRS, random))
    if np.isneginf([kept, exchanged]).all():
        return ExchangeEvidence(0.0, near), poses
    return ExchangeEvidence(float(np.clip(exchanged - kept, -MOST, MOST)), near), poses


def label_hands(
    numbers: NDArray[np.int64],
    times: Array,
    log_odds: Array,
    confusable: Array,
    first_log_odds: float | None = None,
) -> HandLabels:
    """Label the hands of frames in the order of time by the `ExchangeEvidence` of each, arrays `(n,)`.

    `first_log_odds` nats: of the first frame, given all up to it; `None` if the film begins there.
    """
    n = len(times)
    if not n:
        return HandLabels(numbers, np.zeros(0), np.zeros(0, np.bool_), np.zeros(0))
    steps = np.diff(times, prepend=times[0] - CORRELATION_TIME)
    evidence = np.zeros((n, 2))
    evidence[:, 1] = log_odds * np.minimum(steps / CORRELATION_TIME, 1.0)
    begun = evidence[0, 1] + np.log(MISTAKEN / (1 - MISTAKEN))
    evidence[0, 1] = begun if first_log_odds is None else first_log_odds
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
    exchanged = _keep_sure(labels == 1, probabilities)
    return HandLabels(numbers, probabilities, exchanged, forward[:, 1] - forward[:, 0])


def _keep_sure(exchanged: Mask, probabilities: Array) -> Mask:
    """Drop the stretches in which an exchange is sure nowhere."""
    stretches = np.cumsum(np.diff(exchanged, prepend=exchanged[:1]))
    certain = np.unique(stretches[exchanged & (probabilities > SURE)])
    return np.asarray(exchanged & np.isin(stretches, certain))


Draws = tuple[BodyPoses, NDArray[np.intp]]  # and which of them are possible, in random order


def _draw_arms(
    body: UpperBody, poses: BodyPoses, swap: bool, random: np.random.Generator, *, deep: bool = False
) -> Draws:
    """Draw elbows, and depths unless `deep`, `ARMS` times for each pose, with hands in place or swapped."""
    rows = np.arange(len(poses)).repeat(ARMS)
    arms, possible = np.empty((len(rows), 2, 2, 3)), np.empty(len(rows), np.bool_)
    evens = random.uniform(-1, 1, (len(rows), 4))
    redraw_arms(
        rows, body.joints(poses), poses.torsos, poses.necks, swap, deep, evens, REFERENCE, LEAST_DEPTH,
        *body.limits, arms, possible,
    )  # fmt: skip
    drawn = BodyPoses.made((*(each.take(rows, 0) for each in poses.arrays[:3]), arms))
    return drawn, random.permutation(np.flatnonzero(possible))


def _first(draws: Draws, n: int) -> BodyPoses:
    """Return the first of the possible poses."""
    return draws[0].take(draws[1][:n])


def _log_mean(draws: Draws, n: int, log_likelihood: LogDensity) -> float:
    """Estimate the log of the mean likelihood over all draws from `n` of the possible poses."""
    possible = len(draws[1])
    if not possible:
        return -np.inf
    few = _first(draws, n)
    return log_sum(log_likelihood(few)) + float(np.log(possible / (len(draws[0]) * len(few))))


Row = Mapping[str, NDArray[Any]]

SHOULDERS, ELBOWS, HANDS = (
    [JOINTS.index(f"{side}_{name}") for side in ("left", "right")] for name in ("shoulder", "elbow", "hand")
)
OF_ARMS = slice(ANGLES - 8, ANGLES)
ROWS = {
    "joints_2d", "joints_2d_covariances", "joints_3d", "joints_3d_covariances", "angles", "angle_covariances",
    "samples", "hypotheses", "hypothesis_joints", "seen", "seen_probability", "relabelled",
}  # fmt: skip
EXCHANGED_PARTS = [0, 2, 1]


def exchange_hands(body: UpperBody, row: Row) -> dict[str, NDArray[Any]]:
    """Exchange the hands in a row of `poses.npz`.

    Arms reach there with their old swivels, as far as they can. Elbows and angles of arms become those of the
    drawn poses, without correlation with the other angles.
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
        "seen_probability": row["seen_probability"][EXCHANGED_PARTS],
        "relabelled": ~row["relabelled"],
    }


def relabel_hands(
    body: UpperBody, poses: Mapping[str, NDArray[Any]], exchanged: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Exchange the hands in some rows `(n,)` of the columns of `poses.npz`; add the column `relabelled`."""
    columns = {**poses, "relabelled": np.zeros(len(exchanged), np.bool_)}
    if exchanged.any():
        columns |= {name: columns[name].copy() for name in ROWS}
    for index in np.flatnonzero(exchanged).tolist():
        row = exchange_hands(body, {name: columns[name][index] for name in ROWS})
        for name in ROWS:
            columns[name][index] = row[name]
    return columns


def _exchanged(body: UpperBody, joints: Array) -> tuple[Array, Array]:
    """Return joints `(n, 8, 3)` px with exchanged hands, and arms `(n, 2, 2, 3)` that reach them."""
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

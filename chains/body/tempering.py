"""Resampling that keeps improbable modes (strata), and tempering of weighted poses with Metropolis moves.

Poses with hands in about the same positions are a stratum, which keeps its weight but gets a share of the
samples of its own: a mode of probability 0.001 survives and collects evidence from frame to frame (Vermaak,
Doucet and Perez, "Maintaining multi-modality through mixture tracking", 2003).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, normalised, systematic
from ...models.body.upper_body import REFERENCE, BodyPoses, UpperBody
from .dynamics import BodyDynamics
from .kernels.proposals import NEVER, cut, move_blocks

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MOST_STRATA = 12  # at 1000 samples, each has 40 or more
NARROW = 0.3  # head heights: standard deviation of hands below which a stratum is not cut
EVENLY = 0.5  # share of the samples that is divided evenly among strata
LEAST_MASS = 1e-9  # weight below which a stratum is dropped
ROUNDS = 4  # iterations of 2-means along an axis


@dataclass(frozen=True, eq=False)
class Strata:
    """Numbers of strata, `(n,)`, from 0."""

    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, body: UpperBody, poses: BodyPoses) -> "Strata":
        """Cut the widest stratum in two, repeatedly, across its widest axis of both hands' positions."""
        points = body.parts(poses)[:, 1:].reshape(len(poses), 4) / body.head_height
        numbers = np.empty(len(points), np.int64)
        cut(points, NARROW**2, ROUNDS, np.empty((MOST_STRATA, 4)), numbers)
        return cls(numbers)

    def balanced(self, log_weights: Array) -> Array:
        """Return log probabilities `(n,)` of resampling: half by weight, half evenly over the strata."""
        shares = np.bincount(self.numbers, np.exp(normalised(log_weights)))
        alive = shares > LEAST_MASS
        wanted = np.where(alive, (1 - EVENLY) * shares + EVENLY / alive.sum(), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            boost = np.where(alive, np.log(wanted / shares), -np.inf)
        return normalised(log_weights + boost[self.numbers])


LogDensity = Callable[[BodyPoses], Array]

KEPT = 0.3  # share of effective samples that is left by a step of tempering
MOST_STEPS = 3  # of tempering; the last one reaches power 1
MOVES = 4  # Metropolis moves of every sample after each step
SCALES = (0.1, 0.25, 0.6, 1.2)  # of moves over the dynamics' in `MOVE_TIME`: peaks may be narrow
MOVE_TIME = 0.04  # s

BLOCKS = 6
"""Coordinates that move together: position and neck; left or right arm; either arm with its hand fixed in the
image; the torso with both hands and the swivels of the elbows fixed."""


@runtime_checkable
class StagedLikelihood(Protocol):
    """Log likelihood of poses, `(n,)` nats, as a sum of two terms, of which the second is expensive."""

    def __call__(self, poses: BodyPoses, /) -> Array: ...  # noqa: D102
    def first(self, poses: BodyPoses, /) -> Array: ...  # noqa: D102
    def rest(self, poses: BodyPoses, /) -> Array: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Tempered:
    """Samples of the posterior."""

    poses: BodyPoses  # n of them
    log_weights: Array  # `(n,)`, normalised
    log_evidence: float  # log of the mean of the likelihood under the prior


def temper(
    dynamics: BodyDynamics,
    poses: BodyPoses,
    log_weights: Array,
    log_prior: Callable[[BodyPoses, Indices], Array],
    log_likelihood: LogDensity | StagedLikelihood,
    n: int,
    random: np.random.Generator,
    preselected: int | None = None,
) -> Tempered:
    """Draw samples of the posterior from weighted samples of the prior, by a few steps of tempering.

    Each step raises the likelihood's power b towards 1, as far as enough effective samples are left;
    resamples over all `Strata`; and applies Metropolis moves that leave prior x likelihood^b invariant. A
    move is accepted by one term of the likelihood after the other, so that the second one is computed for
    few (Christen and Fox, "Markov chain Monte Carlo using an approximation", 2005).

    `poses`, `log_weights`: m samples of the prior, with weights of sum 1; `log_prior`: of poses and the
    indices, 0 to m - 1, of the samples that they descend from: up to a constant of each index, minus infinity
    where a pose is impossible; `log_likelihood`: of poses; `n`: samples that are returned; `preselected`:
    samples of the prior for which the second term of a `StagedLikelihood` is computed, chosen by the first
    one (`preselect`); `None` for all.
    """
    owners, stages = np.arange(len(poses)), [log_likelihood]
    if isinstance(log_likelihood, StagedLikelihood):
        stages = [log_likelihood.first, log_likelihood.rest]
    terms = [stages[0](poses)]
    if preselected is not None and len(stages) > 1:
        owners, log_weights = preselect(dynamics.body, poses, log_weights, terms[0], preselected, random)
        poses, terms = poses.take(owners), [terms[0][owners]]
    if len(stages) > 1:
        _, firsts, copies = np.unique(owners, return_index=True, return_inverse=True)  # many are alike
        terms.append(stages[1](poses.take(firsts))[copies])
    power = 0.0
    for step in range(MOST_STEPS):
        rest = 1 - power
        likelihood = np.asarray(sum(terms))
        rise = rest if step == MOST_STEPS - 1 else _rise(log_weights, likelihood, rest)
        power += rise
        log_weights = log_weights + rise * likelihood
        total = log_sum(log_weights)
        choice = Strata.of(dynamics.body, poses).balanced(log_weights)
        chosen = systematic(choice, n, random)
        poses, terms, owners = poses.take(chosen), [term[chosen] for term in terms], owners[chosen]
        log_weights = normalised(log_weights[chosen] - choice[chosen]) + total
        prior = log_prior(poses, owners)
        for _ in range(MOVES):
            moved, correction = perturb(dynamics, poses, random)
            new_prior = log_prior(moved, owners)
            gain = new_prior - prior + correction
            rows = np.flatnonzero(np.isfinite(gain))
            gain, moved, new = gain[rows], moved.take(rows), []
            for stage, old in zip(stages, terms, strict=True):
                new.append(stage(moved))
                gain = gain + power * (new[-1] - old[rows])
                takes = np.flatnonzero(np.log(random.random(len(rows))) < gain)
                rows, moved, new = rows[takes], moved.take(takes), [each[takes] for each in new]
                gain = np.zeros(len(rows))
            poses = poses.with_rows(rows, moved)
            prior[rows] = new_prior[rows]
            for old, of_rows in zip(terms, new, strict=True):
                old[rows] = of_rows
        if power >= 1:
            break
    return Tempered(poses, normalised(log_weights), log_sum(log_weights))


def preselect(
    body: UpperBody,
    poses: BodyPoses,
    log_weights: Array,
    log_scores: Array,
    n: int,
    random: np.random.Generator,
) -> tuple[NDArray[np.int64], Array]:
    """Draw `(n,)` indices by weights times scores, and return them with their log weights.

    Whatever the scores `(m,)` nats, sums with the new weights have the expectation of those with the old
    ones: an expensive likelihood term is computed only where the others are good.
    """
    choice = Strata.of(body, poses).balanced(log_weights + log_scores)
    chosen = systematic(choice, n, random)
    return chosen, log_weights[chosen] - choice[chosen] - np.log(n)


def _effective(log_weights: Array) -> float:
    weights = np.exp(log_weights - log_weights.max())
    return float(weights.sum() ** 2 / (weights**2).sum())


def _rise(log_weights: Array, likelihood: Array, most: float) -> float:
    """Find by bisection how much the power may rise, at most `most`."""
    wanted = min(KEPT * len(likelihood), 0.5 * _effective(log_weights))
    if _effective(log_weights + most * likelihood) >= wanted:
        return most
    low, high = 0.0, most
    for _ in range(12):
        middle = 0.5 * (low + high)
        if _effective(log_weights + middle * likelihood) >= wanted:
            low = middle
        else:
            high = middle
    return max(low, 0.02 * most)


def perturb(dynamics: BodyDynamics, poses: BodyPoses, random: np.random.Generator) -> tuple[BodyPoses, Array]:
    """Propose a change of each pose in one of the `BLOCKS`, with the log of its Hastings ratio `(n,)`."""
    n, body = len(poses), dynamics.body
    changed = BodyPoses.made(each.copy() for each in poses.arrays)
    reach = np.hypot(body.upper_arm * dynamics.upper_arm, body.forearm * dynamics.forearm)
    rates = np.array(
        [
            dynamics.place * body.head_height, dynamics.neck, *dynamics.turn_stds[:3],
            dynamics.upper_arm, dynamics.forearm, reach, 2 * dynamics.upper_arm,
        ]
    )  # fmt: skip
    correction = np.empty(n)
    move_blocks(
        random.integers(BLOCKS, size=n), np.array(SCALES)[random.integers(len(SCALES), size=n)],
        random.standard_normal((n, 5)), random.random((n, 4)), np.sqrt(MOVE_TIME) * rates,
        np.array([body.shoulder_width / 2, body.upper_arm, body.forearm]), REFERENCE,
        *changed.arrays, correction,
    )  # fmt: skip
    correction[correction <= NEVER] = -np.inf
    return changed, correction

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
from ...models.body.upper_body import BodyPoses, UpperBody, arm_at, log_volume, swivels
from .dynamics import BodyDynamics, draw_directions
from .kernels import cut

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
    resamples over all `Strata`; and applies Metropolis moves that leave prior x likelihood^b invariant.

    `poses`, `log_weights`: m samples of the prior, with weights of sum 1; `log_prior`: of poses and the
    indices, 0 to m - 1, of the samples that they descend from: up to a constant of each index, minus infinity
    where a pose is impossible; `log_likelihood`: of poses; `n`: samples that are returned; `preselected`:
    samples of the prior for which the second term of a `StagedLikelihood` is computed, chosen by the first
    one (`preselect`); `None` for all.
    """
    owners = np.arange(len(poses))
    if preselected is not None and isinstance(log_likelihood, StagedLikelihood):
        first = log_likelihood.first(poses)
        owners, log_weights = preselect(dynamics.body, poses, log_weights, first, preselected, random)
        poses = poses.take(owners)
        likelihood = first[owners] + log_likelihood.rest(poses)
    else:
        likelihood = log_likelihood(poses)
    power = 0.0
    for step in range(MOST_STEPS):
        rest = 1 - power
        rise = rest if step == MOST_STEPS - 1 else _rise(log_weights, likelihood, rest)
        power += rise
        log_weights = log_weights + rise * likelihood
        total = log_sum(log_weights)
        choice = Strata.of(dynamics.body, poses).balanced(log_weights)
        chosen = systematic(choice, n, random)
        poses, likelihood, owners = poses.take(chosen), likelihood[chosen], owners[chosen]
        log_weights = normalised(log_weights[chosen] - choice[chosen]) + total
        prior = log_prior(poses, owners)
        for _ in range(MOVES):
            moved, correction = perturb(dynamics, poses, random)
            new_prior = log_prior(moved, owners)
            gain = new_prior - prior + correction
            thresholds = np.log(random.random(n))
            rows = np.flatnonzero(np.isfinite(gain))
            moved = moved.take(rows)
            new = log_likelihood(moved)
            takes = thresholds[rows] < gain[rows] + power * (new - likelihood[rows])
            rows = rows[takes]
            poses = poses.with_rows(rows, moved.take(takes))
            likelihood[rows], prior[rows] = new[takes], new_prior[rows]
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
    block = random.integers(BLOCKS, size=n)
    scale = np.array(SCALES)[random.integers(len(SCALES), size=n)]
    pace = np.sqrt(MOVE_TIME)
    roots, torsos, necks, arms = (each.copy() for each in poses.arrays)
    correction = np.zeros(n)
    whole = np.flatnonzero(block == 0)
    size = scale[whole, None]
    roots[whole] += size * dynamics.place * body.head_height * pace * random.standard_normal((len(whole), 2))
    necks[whole] += size * dynamics.neck * pace * random.standard_normal((len(whole), 3))
    leaning = np.flatnonzero(block == 5)
    steps = dynamics.turn_stds[:3] * random.standard_normal((len(leaning), 3))
    torsos[leaning] += scale[leaning, None] * pace * steps
    shifts = body.shoulders(poses) - body.shoulders(BodyPoses(roots, torsos, necks, arms))
    for side in (0, 1):
        free = np.flatnonzero(block == 1 + side)
        for part, rate in enumerate((dynamics.upper_arm, dynamics.forearm)):
            std = scale[free] * rate * pace
            arms[free, side, part] = draw_directions(arms[free, side, part], 1 / std**2, random)
        kept = np.flatnonzero((block == 3 + side) | (block == 5))
        size = np.where(block[kept] == 5, 0.0, scale[kept] * pace)
        offsets = body.upper_arm * arms[kept, side, 0] + body.forearm * arms[kept, side, 1]
        angles = swivels(side, arms[kept, side], body)
        angles = angles + 2 * dynamics.upper_arm * size * random.standard_normal(len(kept))
        before = log_volume(body, offsets)
        reach = np.hypot(body.upper_arm * dynamics.upper_arm, body.forearm * dynamics.forearm)
        offsets += shifts[kept, side]
        offsets[:, 2] += reach * size * random.standard_normal(len(kept))
        arms[kept, side], within = arm_at(body, side, offsets, angles)
        correction[kept] += np.where(within, before - log_volume(body, offsets), -np.inf)
    return BodyPoses(roots, torsos, necks, arms), correction

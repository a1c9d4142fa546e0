"""Resampling that keeps improbable modes (strata), and tempering of weighted poses with Metropolis moves.

Poses whose hands are in about the same places are a stratum. Each keeps its weight, but has a share of the
samples that does not follow it: a mode of one in a thousand goes on to be followed, with all that speaks for
it added up from frame to frame (Vermaak, Doucet and Perez, "Maintaining multi-modality through mixture
tracking", 2003).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, normalised, systematic
from ...models.body.upper_body import BodyPoses, UpperBody, arm_at, log_volume, swivels
from .dynamics import BodyDynamics, around
from .kernels import cut

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MOST_STRATA = 12

NARROW = 0.3  # head heights: standard deviation of hands within which poses say the same
EVENLY = 0.5  # share of the samples that is divided evenly among strata
LEAST_MASS = 1e-9  # of a stratum's weight: less is forgotten
ROUNDS = 4  # of finding the middle between two halves


@dataclass(frozen=True, eq=False)
class Strata:
    """Numbers of strata, `(n,)`, from 0."""

    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, body: UpperBody, poses: BodyPoses) -> "Strata":
        """The widest stratum is cut in two, again and again, across the axis along which it is widest: of
        the places of both hands in the picture."""
        points = body.parts(poses)[:, 1:].reshape(len(poses), 4) / body.head_height
        numbers = np.empty(len(points), np.int64)
        cut(points, NARROW**2, MOST_STRATA, ROUNDS, numbers)
        return cls(numbers)

    def balanced(self, log_weights: Array) -> Array:
        """Log probabilities `(n,)` by which samples with `log_weights` are to be drawn.

        Half of the draws go by weight, the others evenly to all strata.
        """
        shares = np.bincount(self.numbers, np.exp(normalised(log_weights)))
        alive = shares > LEAST_MASS
        wanted = np.where(alive, (1 - EVENLY) * shares + EVENLY / alive.sum(), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            boost = np.where(alive, np.log(wanted / shares), -np.inf)
        return normalised(log_weights + boost[self.numbers])


LogDensity = Callable[[BodyPoses], Array]

KEPT = 0.3  # effective share of the samples that a step of tempering leaves
MOST_STEPS = 3  # of tempering; the last one goes all the way
MOVES = 4  # Metropolis moves of every sample after each step
SCALES = (0.1, 0.25, 0.6, 1.2)  # of moves over the dynamics' in a frame: peaks may be narrow
A_FRAME = 0.04  # s

BLOCKS = 6
"""What moves at a time: place and neck; left or right arm; either arm while its hand is seen where it was;
the torso while both hands and the swivels of the elbows stay."""


@runtime_checkable
class StagedLikelihood(Protocol):
    """The log likelihood of poses, `(n,)` nats, as a sum of two terms, of which the second is expensive."""

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
    looked_at: int | None = None,
) -> Tempered:
    """Bring weighted samples of a prior to the posterior in a few steps.

    In each step the likelihood is taken to a power b that grows to 1, by as much as leaves enough samples
    with weight; samples are drawn again, from all `Strata`, and moved by Metropolis steps that keep prior
    times likelihood^b as it is.

    `poses`, `log_weights`: m samples of the prior, with weights of sum 1; `log_prior`: of poses and the
    numbers of the samples, 0 to m - 1, that they go back to: up to a constant of such a number, minus
    infinity where a pose is impossible; `log_likelihood`: of poses; `n`: samples that are left; `looked_at`:
    samples of the prior for which all of a likelihood in stages is worked out, chosen by the first one
    (`preselected`); without, all of them.
    """
    owners = np.arange(len(poses))
    if looked_at is not None and isinstance(log_likelihood, StagedLikelihood):
        first = log_likelihood.first(poses)
        owners, log_weights = preselected(dynamics.body, poses, log_weights, first, looked_at, random)
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
            moved, correction = perturbed(dynamics, poses, random)
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


def preselected(
    body: UpperBody,
    poses: BodyPoses,
    log_weights: Array,
    first_look: Array,
    n: int,
    random: np.random.Generator,
) -> tuple[NDArray[np.int64], Array]:
    """`(n,)` of the samples, drawn by their weights times a first look at the likelihood, and log weights.

    Sums with the new weights have the expectation of those with the old ones, whatever the first look, so
    that what is expensive in a likelihood is worked out only where the rest of it is good.

    `first_look` `(m,)` nats.
    """
    choice = Strata.of(body, poses).balanced(log_weights + first_look)
    chosen = systematic(choice, n, random)
    return chosen, log_weights[chosen] - choice[chosen] - np.log(n)


def _effective(log_weights: Array) -> float:
    weights = np.exp(log_weights - log_weights.max())
    return float(weights.sum() ** 2 / (weights**2).sum())


def _rise(log_weights: Array, likelihood: Array, most: float) -> float:
    """How much the power may rise, at most `most`, by bisection."""
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


def perturbed(
    dynamics: BodyDynamics, poses: BodyPoses, random: np.random.Generator
) -> tuple[BodyPoses, Array]:
    """Each pose changed in one of the blocks, and the log of what makes the change symmetric (`(n,)`)."""
    n, body = len(poses), dynamics.body
    block = random.integers(BLOCKS, size=n)
    scale = np.array(SCALES)[random.integers(len(SCALES), size=n)]
    pace = np.sqrt(A_FRAME)
    roots, torsos, necks, arms = (each.copy() for each in poses.arrays)
    correction = np.zeros(n)
    whole = np.flatnonzero(block == 0)
    size = scale[whole, None]
    roots[whole] += size * dynamics.place * body.head_height * pace * random.standard_normal((len(whole), 2))
    necks[whole] += size * dynamics.neck * pace * random.standard_normal((len(whole), 3))
    leaning = np.flatnonzero(block == 5)
    steps = dynamics.turn_spreads[:3] * random.standard_normal((len(leaning), 3))
    torsos[leaning] += scale[leaning, None] * pace * steps
    shifts = body.shoulders(poses) - body.shoulders(BodyPoses(roots, torsos, necks, arms))
    for side in (0, 1):
        free = np.flatnonzero(block == 1 + side)
        for part, rate in enumerate((dynamics.upper_arm, dynamics.forearm)):
            spread = scale[free] * rate * pace
            arms[free, side, part] = around(arms[free, side, part], 1 / spread**2, random)
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

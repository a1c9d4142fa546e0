"""Metropolis moves of poses whose past and future are known, for smoothing by backward simulation.

Backward simulation alone chooses among poses that a filter has drawn: too few in so many dimensions. Bunch
and Godsill, "Improved particle approximations to the joint smoothing distribution using Markov chain Monte
Carlo" (2013), move each pose x_t where it is

    p(x_t | x_t+1, I_1..t) ~ p(x_t | I_1..t-1) p(I_t | x_t) p(x_t+1 | x_t)
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import systematic
from ...models.body.poses import BodyPoses
from .dynamics import Ancestors, BodyDynamics, around, concentration
from .samples import BodySamples
from .tempering import LogDensity, perturbed

Array = NDArray[np.float64]

SCALES = np.array([0.1, 0.3, 0.7, 1.2])
"""Sizes of an arm's move away from where it is in the next frame, over those of the dynamics."""

CENTRES = 64
"""Poses of the filter about whose arms others are drawn."""

BREADTH = 0.5
"""How far from these, over what the dynamics move it."""

NEXT = 0.3
"""Share of arms that are drawn near the next frame's: so where a hand was found goes back to where it was
lost."""

LEAST_DENSITY, IMPOSSIBLE = 1e-30, -1e300
"""Of an arm that is drawn; nats of a pose that joints do not allow, which any other replaces."""


@dataclass(frozen=True, eq=False)
class ArmProposal:
    """Arms drawn near those that the filter has, as they fit what comes next, or near the next frame's.

    p(arm) = NEXT mean_s vMF(arm; next, s) + (1 - NEXT) sum_k v_k vMF(arm; arm_k, BREADTH),
    v_k ~ p(next | arm_k)

    Parameters
    ----------
    centres, near
        `(k, 2, 3)` arms of the filter, `(n, 2, 3)` of the next frame.
    shares
        `(n, k)`, with sums 1.
    concentrations, scaled
        of both segments, `(2,)` about the centres, and `(4, 2)` about the next frame's.
    """

    centres: Array
    near: Array
    shares: Array
    concentrations: Array
    scaled: Array

    @classmethod
    def of(cls, dynamics: BodyDynamics, elapsed: float, centres: Array, near: Array) -> "ArmProposal":
        """What is to be drawn `elapsed` s before `near`."""
        rates = np.array([dynamics.upper_arm, dynamics.forearm]) ** 2 * elapsed
        walk = _log_kernels(near, centres, concentration(rates))
        shares = np.exp(np.maximum(walk - walk.max(axis=1, keepdims=True), -20.0))
        shares /= shares.sum(axis=1, keepdims=True)
        scaled = concentration(SCALES[:, None] ** 2 * rates)
        return cls(centres, near, shares, concentration(BREADTH**2 * rates), scaled)

    def draw(self, random: np.random.Generator) -> Array:
        """`(n, 2, 3)`: one arm for each of the next frame."""
        n = len(self.near)
        ends = np.cumsum(self.shares, axis=1)
        chosen = (random.random((n, 1)) * ends[:, -1:] >= ends[:, :-1]).sum(axis=1)
        follows = random.random(n) < NEXT
        middles = np.where(follows[:, None, None], self.near, self.centres[chosen])
        kappas = np.where(
            follows[:, None], self.scaled[random.integers(len(SCALES), size=n)], self.concentrations
        )
        return np.stack([around(middles[:, part], kappas[:, part], random) for part in (0, 1)], axis=1)

    def log_density(self, arms: Array) -> Array:
        """`(n,)` nats, of one arm for each of the next frame."""
        about = (self.shares * np.exp(_log_kernels(arms, self.centres, self.concentrations))).sum(axis=1)
        cosines = (arms * self.near).sum(axis=2) - 1
        near = np.mean([np.exp(cosines @ kappa) * _peak(kappa) for kappa in self.scaled], axis=0)
        return np.asarray(np.log(NEXT * near + (1 - NEXT) * about + LEAST_DENSITY))


def moved_between(
    dynamics: BodyDynamics,
    poses: BodyPoses,
    past: Ancestors,
    samples: BodySamples,
    later: BodyPoses,
    elapsed: float,
    log_likelihood: LogDensity,
    moves: int,
    random: np.random.Generator,
) -> BodyPoses:
    """Move each pose between a past that all share and a next pose of its own.

    Half of the moves are of whole arms, half are small ones.

    Parameters
    ----------
    poses
        n of them, which may have been drawn from `samples`.
    past
        of the frame before.
    samples
        what the filter knows of this frame.
    later, elapsed
        `n` poses of the next frame; s from this one to it.
    log_likelihood
        of this frame's image.
    moves
        of every pose.
    """
    n = len(poses)

    def log_target(tried: BodyPoses) -> Array:
        total = dynamics.log_density(tried, past) + dynamics.log_step(later, tried, elapsed)
        allowed = np.flatnonzero(dynamics.body.allowed(tried))
        if len(allowed):
            total[allowed] += log_likelihood(tried.take(allowed))
        possible = np.full(n, -np.inf)
        possible[allowed] = total[allowed]
        return possible

    centres = samples.poses.arms[systematic(samples.log_weights, CENTRES, random)]
    proposals = [ArmProposal.of(dynamics, elapsed, centres[:, side], later.arms[:, side]) for side in (0, 1)]
    value = np.maximum(log_target(poses), IMPOSSIBLE)
    for move in range(moves):
        if move % 2:
            tried, correction = perturbed(dynamics, poses, random)
        else:
            tried, correction = _with_arms(poses, proposals, random)
        new = log_target(tried)
        takes = np.log(random.random(n)) < new - value + correction
        poses, value = poses.replaced(takes, tried), np.where(takes, new, value)
    return poses


def _with_arms(
    poses: BodyPoses, proposals: list[ArmProposal], random: np.random.Generator
) -> tuple[BodyPoses, Array]:
    """Left, right or both arms drawn anew, and the log of the densities' ratio, backwards over forwards."""
    n = len(poses)
    which = random.integers(3, size=n)
    arms, correction = poses.arms.copy(), np.zeros(n)
    for side, proposal in enumerate(proposals):
        drawn = proposal.draw(random)
        ratio = proposal.log_density(poses.arms[:, side]) - proposal.log_density(drawn)
        changes = which != 1 - side
        arms[changes, side] = drawn[changes]
        correction[changes] += ratio[changes]
    return replace(poses, arms=arms), correction


def _log_kernels(arms: Array, centres: Array, concentrations: Array) -> Array:
    """`(n, k)` nats: von Mises and Fisher's densities of both segments of `arms` about `centres`."""
    n, k = len(arms), len(centres)
    scaled = (centres * concentrations[:, None]).reshape(k, 6)
    cosines = arms.reshape(n, 6) @ scaled.T - concentrations.sum()
    return np.asarray(cosines + np.log(_peak(concentrations)))


def _peak(concentrations: Array) -> float:
    """Of both segments' densities."""
    return float(np.prod(concentrations / (2 * np.pi * -np.expm1(-2 * concentrations))))

"""Proposals of poses: completed from positions of head and hands, or guided by them from the frame before.

Likelihood sampling (RSMCM paper §4.1; Taycher and Darrell, "Bayesian articulated tracking using single frame
pose sampling", 2003): positions of head and hands are drawn from their mixtures. Once torso, neck and hands
are given, an arm has two degrees of freedom left, which inverse kinematics completes.

Guided sampling (Isard and Blake, "ICondensation", 1998): most poses are moved by the dynamics alone. In the
others one hand is drawn at a place that its message names, from a pose that had it near there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from ...inference.smc import normalised, systematic
from ...models.body.upper_body import BodyPoses, UpperBody, arm_at, log_volume, swivels
from ...models.core.gaussian_mixtures import GaussianMixtures
from .dynamics import Ancestors, BodyDynamics
from .kernels import choose, closeness_to, guided_values
from .tempering import Strata

Array = NDArray[np.float64]

MOST_ROUNDS = 40
"""Of drawing again what the joints do not allow, which is left out before it costs much. The density of what
is left is the same but for a factor that is common to all."""

LEAST_DEPTH = 1.0  # px: smallest half range of a hand's depth, so that a stretched arm has a density


@dataclass(frozen=True, eq=False)
class Proposal:
    """Poses and the density from which they were drawn."""

    poses: BodyPoses  # all within reach and limits
    log_density: Array  # `(n,)` nats, in the measure of `BodyDynamics.log_density_anywhere`
    tried: float  # how many were drawn, those that are impossible among them


def draw_from_likelihood(
    dynamics: BodyDynamics,
    mixtures: GaussianMixtures,
    n: int,
    random: np.random.Generator,
    rounds: int = MOST_ROUNDS,
) -> Proposal:
    """Draw `n` poses, or as many as turn out to be possible in so many rounds of `n`.

    Torso and neck are as in the long run; depth of a hand, from its shoulder, and swivel of an elbow evenly
    over all that the arm can reach. `mixtures`: of head, left and right hand; without flat components.
    """
    found: list[BodyPoses] = []
    while sum(map(len, found)) < n and len(found) < rounds:
        found.append(_possible(dynamics, mixtures, n, random))
    every = BodyPoses.concatenated(found)
    poses = every.take(slice(n))
    tried = len(found) * n * len(poses) / max(len(every), 1)
    return Proposal(poses, _log_density(dynamics, poses, mixtures), tried)


def _possible(
    dynamics: BodyDynamics, mixtures: GaussianMixtures, n: int, random: np.random.Generator
) -> BodyPoses:
    """At most `n` poses within reach and limits, of as many draws."""
    body = dynamics.body
    places = np.stack([draw_mixture(mixtures, part, n, random) for part in range(3)], axis=1)
    turns = dynamics.turn_spreads * random.standard_normal((n, 6))
    torsos, necks = turns[:, :3].copy(), turns[:, 3:].copy()
    trunks = BodyPoses(np.zeros((n, 2)), torsos, necks, np.zeros((n, 2, 2, 3)))
    roots = places[:, 0] - body.parts(trunks)[:, 0]
    shoulders = body.shoulders(trunks)[:, :, :2] + roots[:, None]
    arms = np.empty((n, 2, 2, 3))
    possible = np.ones(n, np.bool_)
    for side in (0, 1):
        offsets = np.zeros((n, 3))
        offsets[:, :2] = places[:, 1 + side] - shoulders[:, side]
        offsets[:, 2] = half_range(body, offsets) * random.uniform(-1, 1, n)
        arms[:, side], within = arm_at(body, side, offsets, random.uniform(-np.pi, np.pi, n))
        possible &= within
    poses = BodyPoses(roots, torsos, necks, arms).take(possible)
    return poses.take(body.allowed(poses))


def _log_density(dynamics: BodyDynamics, poses: BodyPoses, mixtures: GaussianMixtures) -> Array:
    body = dynamics.body
    joints = body.joints(poses)
    spreads = dynamics.turn_spreads
    total = mixtures.log_values(joints[:, [0, 4, 7], :2]).sum(axis=1) - mixtures.log_masses.sum()
    total -= 0.5 * ((poses.turns / spreads) ** 2).sum(axis=1) + np.log(spreads).sum() + 3 * np.log(2 * np.pi)
    for side in (0, 1):
        offsets = joints[:, 4 + 3 * side] - joints[:, 2 + 3 * side]
        total += log_volume(body, offsets) - np.log(4 * np.pi * half_range(body, offsets))
    return np.asarray(total)


def half_range(body: UpperBody, offsets: Array) -> Array:
    """`(n,)` px: greatest depth of a hand at `offsets` `(n, 2 or 3)` px from its shoulder, either way."""
    reach = body.upper_arm + body.forearm
    return np.asarray(np.sqrt(np.maximum(reach**2 - (offsets[:, :2] ** 2).sum(axis=1), LEAST_DEPTH**2)))


def draw_mixture(mixtures: GaussianMixtures, part: int, n: int, random: np.random.Generator) -> Array:
    """`(n, 2)` px: positions of one part, whose components are all proper, in random order."""
    chosen = random.permutation(systematic(mixtures.log_weights[part], n, random))
    roots = np.linalg.cholesky(mixtures.covariances[part])[chosen]
    steps = np.einsum("nxy,ny->nx", roots, random.standard_normal((n, 2)))
    return np.asarray(mixtures.means[part][chosen] + steps)


GUIDED = 0.35  # share of the poses of which a hand is drawn where it is seen
ANYWHERE = 0.2  # share of these whose depth and swivel are drawn without the past, which may be wrong
FARAWAY = 1e-3  # how readily a pose is chosen whose hand is far away, over one whose hand is there: arms jump
HANDS = (4, 7)  # of `models.body.upper_body.JOINTS`


@dataclass(frozen=True, eq=False)
class Guided:
    """Draws of poses."""

    poses: BodyPoses  # n of them, all possible; none, if no draw was
    log_weights: Array  # `(n,)`, normalised: p(x_t | past) of pose and ancestor over their draw's density
    ancestors: NDArray[np.int64]  # `(n,)` int64: of each, the pose of the past that it was drawn from


@dataclass(frozen=True, eq=False)
class _Targets:
    """Places, of all hands together, that something is said of: Gaussians in the picture."""

    sides: NDArray[np.int64]  # (k,) 0 left, 1 right
    shares: Array  # (k,) of all draws, with sum `GUIDED`
    means: Array  # (k, 2) px
    covariances: Array  # (k, 2, 2) px^2

    @classmethod
    def of(cls, said: Sequence[tuple[GaussianMixtures, float]]) -> "_Targets":
        """All components that are not flat; half by their weights, half evenly."""
        sides, shares, means, covariances = [], [], [], []
        for mixtures, share in said:
            for side in (0, 1):
                part = 1 + side
                known = np.flatnonzero(np.isfinite(mixtures.log_weights[part]) & ~mixtures.flat[part])
                if not len(known):
                    continue
                weights = np.exp(normalised(mixtures.log_weights[part, known]))
                sides.append(np.full(len(known), side))
                shares.append(0.5 * GUIDED * share * (0.5 * weights + 0.5 / len(known)))
                means.append(mixtures.means[part, known])
                covariances.append(mixtures.covariances[part, known])
        if not sides:
            return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)))
        return cls(*map(np.concatenate, (sides, shares, means, covariances)))


def draw_guided(
    dynamics: BodyDynamics,
    past: Ancestors,
    said: Sequence[tuple[GaussianMixtures, float]],
    n: int,
    random: np.random.Generator,
) -> Guided:
    """Draw `n` poses and leave out those that are impossible.

    `past`: k weighted poses of the frame before, which are drawn from all `Strata`; `said`: of head and
    hands, with the shares, of sum 1, of the poses that these guide; flat components guide nobody.
    """
    body, elapsed = dynamics.body, past.elapsed
    with np.errstate(divide="ignore"):
        log_weights = np.log(past.weights)
    log_choice = Strata.of(body, past.poses).balanced(log_weights)
    joints = body.joints(past.poses)
    hidden = _HiddenCoordinates.of(dynamics, past.poses, joints, elapsed)
    targets = _Targets.of(said)
    choice = np.exp(log_choice)
    closeness = _closeness(targets, joints, hidden.step, choice)
    chosen, target = _chosen(choice, targets.shares, closeness, n, random)
    poses = dynamics.draw(past.poses.take(chosen), elapsed, random)
    possible = _guide(body, poses, chosen, target, targets, hidden, random)
    possible &= body.allowed(poses)
    poses, chosen = poses.take(possible), chosen[possible]
    parents = past.poses.take(chosen)
    walks = dynamics.log_arm_steps(poses, parents, elapsed)
    drawn = _log_drawn(body, poses, chosen, targets, closeness, hidden, walks)
    log_weights = log_weights[chosen] - log_choice[chosen] + walks.sum(axis=1) - drawn
    log_weights += dynamics.log_posture(poses, elapsed)
    return Guided(poses, normalised(log_weights), chosen)


def _closeness(targets: _Targets, joints: Array, step: float, choice: Array) -> Array:
    """`(k_targets, k_past)`: how readily a pose is chosen for a target, over how it is chosen else."""
    wide = np.linalg.inv(targets.covariances + step**2 * np.eye(2))
    closeness = np.empty((len(targets.sides), len(joints)))
    hands = np.ascontiguousarray(joints[:, HANDS, :2])
    closeness_to(hands, targets.sides, targets.means, wide, FARAWAY, choice, closeness)
    return closeness


def _guide(
    body: UpperBody,
    poses: BodyPoses,
    chosen: NDArray[np.int64],
    target: NDArray[np.int64],
    targets: _Targets,
    hidden: "_HiddenCoordinates",
    random: np.random.Generator,
) -> NDArray[np.bool_]:
    """Put arms of `poses` in place to their targets; the result, `(n,)`, is whether they reach them."""
    possible = np.ones(len(poses), np.bool_)
    shoulders = body.shoulders(poses)[:, :, :2]
    roots = np.linalg.cholesky(targets.covariances)
    goals = np.append(targets.sides, -1)[target]  # the last one stands for no target
    for side in (0, 1):
        rows = np.flatnonzero(goals == side)
        if not len(rows):
            continue
        goal, parent, count = target[rows], chosen[rows], len(rows)
        places = targets.means[goal] + np.einsum(
            "nxy,ny->nx", roots[goal], random.standard_normal((count, 2))
        )
        offsets = np.zeros((count, 3))
        offsets[:, :2] = places - shoulders[rows, side]
        half = half_range(body, offsets)
        near = random.random(count) >= ANYWHERE
        offsets[:, 2] = np.where(
            near,
            hidden.depths[parent, side] + hidden.step * random.standard_normal(count),
            half * random.uniform(-1, 1, count),
        )
        angles = np.where(
            near,
            hidden.swivels[parent, side] + random.vonmises(0.0, hidden.concentration, count),
            random.uniform(-np.pi, np.pi, count),
        )
        poses.arms[rows, side], possible[rows] = arm_at(body, side, offsets, angles)
    return possible


def _log_drawn(
    body: UpperBody,
    poses: BodyPoses,
    chosen: NDArray[np.int64],
    targets: _Targets,
    closeness: Array,
    hidden: "_HiddenCoordinates",
    walks: Array,
) -> Array:
    """`(n,)` nats: density of a draw given its ancestor, over what all draws have in common."""
    joints = body.joints(poses)
    completions = np.empty((len(poses), 2))
    for side in (0, 1):
        offsets = joints[:, HANDS[side]] - joints[:, HANDS[side] - 2]
        angles = swivels(side, poses.arms[:, side], body)
        near = hidden.log_density(chosen, side, offsets[:, 2], angles)
        evenly = np.log(ANYWHERE / (4 * np.pi)) - np.log(half_range(body, offsets))
        completions[:, side] = np.logaddexp(np.log1p(-ANYWHERE) + near, evenly) + log_volume(body, offsets)
    precisions = np.linalg.inv(targets.covariances)
    heights = targets.shares * np.sqrt(np.linalg.det(precisions)) / (2 * np.pi)
    values = np.empty(len(poses))
    guided_values(
        np.ascontiguousarray(joints[:, HANDS, :2]), chosen, walks, completions,
        targets.sides, targets.means, precisions, np.append(heights, 1.0 - targets.shares.sum()),
        closeness, values,
    )  # fmt: skip
    return values


@dataclass(frozen=True, eq=False)
class _HiddenCoordinates:
    """Of each arm what a hand's place in the picture does not tell: its depth, and the elbow's swivel."""

    depths: Array  # (k, 2) px, from the shoulder
    swivels: Array  # (k, 2) rad
    step: float  # px that a hand moves along an axis, standard deviation
    concentration: float  # of a swivel around another

    @classmethod
    def of(
        cls, dynamics: BodyDynamics, poses: BodyPoses, joints: Array, elapsed: float
    ) -> "_HiddenCoordinates":
        body = dynamics.body
        angles = np.stack([swivels(side, poses.arms[:, side], body) for side in (0, 1)], axis=1)
        scale = np.sqrt(elapsed)
        step = scale * np.hypot(body.upper_arm * dynamics.upper_arm, body.forearm * dynamics.forearm)
        # an elbow turns about the line to the hand, from which it is half an upper arm away, say
        turn = scale * 2 * dynamics.upper_arm
        return cls(joints[:, [4, 7], 2] - joints[:, [2, 5], 2], angles, float(step), 1 / turn**2)

    def log_density(self, rows: NDArray[np.int64], side: int, depths: Array, angles: Array) -> Array:
        """`(n,)` nats, of a depth and a swivel around those of the poses `rows`."""
        away = (depths - self.depths[rows, side]) / self.step
        turned = self.concentration * (np.cos(angles - self.swivels[rows, side]) - 1)
        normal = np.sqrt(2 * np.pi) * self.step * 2 * np.pi * i0e(self.concentration)
        return np.asarray(-0.5 * away**2 + turned - np.log(normal))


def _chosen(
    choice: Array, shares: Array, closeness: Array, n: int, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`(n,)` ancestors and `(n,)` targets, -1 for none."""
    ends = np.floor(n * np.cumsum(shares) + random.random()).astype(np.int64)
    counts = np.diff(ends, prepend=0)
    counts = np.append(counts, n - counts.sum())
    chosen = np.empty(n, np.int64)
    choose(choice, closeness, counts, random.random(len(counts)), chosen)
    return chosen, np.repeat(np.append(np.arange(len(shares)), -1), counts)


ANEW = 0.1  # least share of candidates without a past: who comes back elsewhere must be drawn to be found


@dataclass(frozen=True, eq=False)
class Candidates:
    """Weighted samples of p(x_t | past), each with the pose it goes back to."""

    # of the body; `(height, width)` px of the picture; s since the frame before
    dynamics: BodyDynamics
    size: tuple[int, int]
    elapsed: float
    poses: BodyPoses  # n of them, all possible
    log_weights: Array  # `(n,)`; they sum to 1 once others have `weighed` them
    ancestors: BodyPoses  # n poses of the frame before; those that begin anew are their own
    anew: NDArray[np.bool_]  # `(n,)`: which ones do

    @classmethod
    def at_first(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        said: GaussianMixtures,
        n: int,
        random: np.random.Generator,
        rounds: int = MOST_ROUNDS,
    ) -> Self:
        """Of somebody of whom nothing is known, drawn from proper mixtures of head and hands."""
        proposal = draw_from_likelihood(dynamics, said, n, random, rounds)
        log_weights = dynamics.log_density_anywhere(proposal.poses, size) - proposal.log_density
        log_weights -= np.log(max(proposal.tried, 1.0))
        count = len(proposal.poses)
        return cls(
            dynamics, size, np.inf, proposal.poses, log_weights, proposal.poses, np.ones(count, np.bool_)
        )

    @classmethod
    def after(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        past: Ancestors,
        guides: Sequence[tuple[GaussianMixtures, float]],
        said: GaussianMixtures,
        n: int,
        random: np.random.Generator,
    ) -> Self:
        """Of somebody who was seen before: most go on, guided (`draw_guided`), some begin anew."""
        log_elsewhere, log_stays = dynamics.log_returns(past.elapsed)
        anew = round(max(ANEW, np.exp(log_elsewhere)) * n)
        begun = cls.at_first(dynamics, size, said, anew, random, rounds=1)
        went_on = draw_guided(dynamics, past, guides, max(n - anew, 1), random)
        return cls(
            dynamics,
            size,
            past.elapsed,
            BodyPoses.concatenated([begun.poses, went_on.poses]),
            np.concatenate([begun.log_weights + log_elsewhere, went_on.log_weights + log_stays]),
            BodyPoses.concatenated([begun.poses, past.poses.take(went_on.ancestors)]),
            np.arange(len(begun.poses) + len(went_on.poses)) < len(begun.poses),
        )

    def weighed(self, log_factors: Array) -> Self:
        """With factors `(n,)` that others say; weights are normalised."""
        return replace(self, log_weights=normalised(self.log_weights + log_factors))

    def log_prior(self, poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
        """`(m,)` nats of poses that go back to what candidates `owners` `(m,)` go back to, up to a constant
        of each; minus infinity where joints forbid them."""
        dynamics, anew = self.dynamics, self.anew[owners]
        prior = np.full(len(poses), -np.inf)
        begun, gone_on = np.flatnonzero(anew), np.flatnonzero(~anew)
        if len(begun):
            prior[begun] = dynamics.log_density_anywhere(poses.take(begun), self.size)
        if len(gone_on):
            before = self.ancestors.take(owners[gone_on])
            prior[gone_on] = dynamics.log_step(poses.take(gone_on), before, self.elapsed)
        return np.where(dynamics.body.allowed(poses), prior, -np.inf)

"""Proposals of poses: completed from positions of head and hands, or guided by them from the frame before.

Likelihood sampling (RSMCM paper §4.1; Taycher and Darrell, "Bayesian articulated tracking using single frame
pose sampling", 2003): head and hands are drawn from their mixtures. Given torso, neck and hands, an arm has
two degrees of freedom left, which are drawn and completed by inverse kinematics.

Guided sampling (Isard and Blake, "ICondensation", 1998): most poses are drawn from the dynamics alone. In the
others one hand is drawn from its mixture, given an ancestor with the hand near there. Elbows of bare arms
look like hands: some draws have either at such a place, so that an arm that is reversed turns round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e, logsumexp

from ...inference.smc import normalised, systematic
from ...models.body.upper_body import (
    PART_JOINTS,
    REFERENCE,
    BodyPoses,
    UpperBody,
    arm_at,
    log_volume,
    swivels,
)
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.numerics.threads import over_bands
from .dynamics import Ancestors, BodyDynamics
from .kernels.proposals import choose, closeness_to, completion_terms, guided_values
from .tempering import Strata

Array = NDArray[np.float64]

MOST_ROUNDS = 40  # of rejection sampling of possible poses, whose density changes by a constant only
AT_ELBOWS = 0.4  # share of draws of a bare arm whose elbow, too, is drawn where a hand may be
LEAST_COSINES = 1e-12  # of a limb across the line of sight, whose density is 0
WORTH_THREADS = 2000  # poses from which several threads are faster than one
LEAST_DEPTH = 1.0  # px: half range of a hand's depth at least, so that a stretched arm has a density


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
    bare: float = 0.0,
) -> Proposal:
    """Draw `n` possible poses, or as many as there are in so many rounds of `n` draws.

    Torso and neck have their stationary distribution; the depth of a hand and the swivel of an elbow are
    uniform within reach, or both ends of a bare forearm are drawn from the hand's mixture. `mixtures`: of
    head, left and right hand; without flat components; `bare`: probability of bare forearms.
    """
    drawn: list[BodyPoses] = []
    while sum(map(len, drawn)) < n and len(drawn) < rounds:
        drawn.append(_possible(dynamics, mixtures, n, random, AT_ELBOWS * bare))
    every = BodyPoses.concatenated(drawn)
    poses = every.take(slice(n))
    tried = len(drawn) * n * len(poses) / max(len(every), 1)
    return Proposal(poses, _log_density(dynamics, poses, mixtures, AT_ELBOWS * bare), tried)


def _possible(
    dynamics: BodyDynamics, mixtures: GaussianMixtures, n: int, random: np.random.Generator, at_elbows: float
) -> BodyPoses:
    """Draw `n` poses and return those within reach and joint limits."""
    body = dynamics.body
    places = np.stack([draw_mixture(mixtures, part, n, random) for part in range(3)], axis=1)
    turns = dynamics.turn_stds * random.standard_normal((n, 6))
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
        if at_elbows > 0:
            moved = np.flatnonzero(random.random(n) < at_elbows)
            elbows = draw_mixture(mixtures, 1 + side, n, random)[moved]
            upper, fore = elbows - shoulders[moved, side], places[moved, 1 + side] - elbows
            arms[moved, side], within[moved] = _through(body, upper, fore, random)
        possible &= within
    poses = BodyPoses(roots, torsos, necks, arms).take(possible)
    return poses.take(body.allowed(poses))


def _through(
    body: UpperBody, upper: Array, fore: Array, random: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Draw arms `(n, 2, 3)` whose segments have projections `upper` and `fore` `(n, 2)` px.

    Each points to the viewer or away from him. Also returns whether they are that long, `(n,)`.
    """
    lengths = np.array([body.upper_arm, body.forearm])
    arms = np.zeros((len(upper), 2, 3))
    arms[..., :2] = np.stack([upper, fore], axis=1) / lengths[:, None]
    rest = 1 - np.square(arms[..., :2]).sum(axis=2)
    arms[..., 2] = np.sqrt(np.maximum(rest, 0)) * random.choice([-1.0, 1.0], rest.shape)
    return arms, np.asarray((rest > 0).all(axis=1))


def _or_through(body: UpperBody, completions: Array, elbows: Array, arms: Array, at_elbows: float) -> Array:
    """`(n,)` nats: log density of arms, given their hands, that are completed or drawn by `_through`.

    `completions`, `elbows` `(n,)` nats: log densities of the first way, over directions, and of the elbow in
    the picture in the second one; `arms` `(n, 2, 3)`; `at_elbows`: share of the second.
    """
    # d(elbow x, y) d(hand x, y) = |z| of both directions times squared lengths; two ways for each
    depths = np.maximum(np.abs(arms[..., 2]).prod(axis=1), LEAST_COSINES)
    through = elbows + np.log(depths * (0.5 * body.upper_arm * body.forearm) ** 2)
    shares = np.log1p(-at_elbows), np.log(at_elbows)
    return np.asarray(np.logaddexp(shares[0] + completions, shares[1] + through))


def _log_density(
    dynamics: BodyDynamics, poses: BodyPoses, mixtures: GaussianMixtures, at_elbows: float
) -> Array:
    body = dynamics.body
    joints = body.joints(poses)
    stds = dynamics.turn_stds
    total = mixtures.log_values(joints[:, PART_JOINTS, :2]).sum(axis=1) - mixtures.log_masses.sum()
    total -= 0.5 * ((poses.turns / stds) ** 2).sum(axis=1) + np.log(stds).sum() + 3 * np.log(2 * np.pi)
    for side in (0, 1):
        offsets = joints[:, 4 + 3 * side] - joints[:, 2 + 3 * side]
        completions = log_volume(body, offsets) - np.log(4 * np.pi * half_range(body, offsets))
        if at_elbows > 0:
            of_part = mixtures.take([1 + side])
            elbows = of_part.log_values(joints[:, None, 3 + 3 * side, :2])[:, 0] - of_part.log_masses[0]
            completions = _or_through(body, completions, elbows, poses.arms[:, side], at_elbows)
        total += completions
    return np.asarray(total)


def half_range(body: UpperBody, offsets: Array) -> Array:
    """`(n,)` px: greatest depth of a hand at `offsets` `(n, 2 or 3)` px from its shoulder, either way."""
    reach = body.upper_arm + body.forearm
    return np.asarray(np.sqrt(np.maximum(reach**2 - (offsets[:, :2] ** 2).sum(axis=1), LEAST_DEPTH**2)))


def draw_mixture(mixtures: GaussianMixtures, part: int, n: int, random: np.random.Generator) -> Array:
    """Draw `(n, 2)` px of one part, whose components are all proper, in random order."""
    chosen = random.permutation(systematic(mixtures.log_weights[part], n, random))
    roots = np.linalg.cholesky(mixtures.covariances[part])[chosen]
    steps = np.einsum("nxy,ny->nx", roots, random.standard_normal((n, 2)))
    return np.asarray(mixtures.means[part][chosen] + steps)


GUIDED = 0.35  # share of the poses of which a hand is drawn from its mixture
ANYWHERE = 0.2  # share of these whose depth and swivel ignore the ancestor, which may be wrong
FARAWAY = 1e-3  # weight of an ancestor whose hand is far from the target, over one at it: arms jump
HANDS = (4, 7)  # of `models.body.upper_body.JOINTS`


@dataclass(frozen=True, eq=False)
class Guided:
    """Guided draws, with importance weights."""

    poses: BodyPoses  # n possible ones, maybe 0
    log_weights: Array  # `(n,)`, normalised: p(x_t, ancestor | past) over the density of the draw
    ancestors: NDArray[np.int64]  # `(n,)`: index of the past pose that each was drawn from


@dataclass(frozen=True, eq=False)
class _Targets:
    """Gaussians in the image at which hands are drawn, of both hands together."""

    sides: NDArray[np.int64]  # (k,) 0 left, 1 right
    shares: Array  # (k,) of all draws, with sum `GUIDED`
    means: Array  # (k, 2) px
    covariances: Array  # (k, 2, 2) px^2
    at_elbows: float  # share of their draws whose elbow is at a target, too

    @classmethod
    def of(cls, guides: Sequence[tuple[GaussianMixtures, float]], bare: float) -> "_Targets":
        """Collect the components that are not flat, with shares half by weight, half even."""
        sides, shares, means, covariances = [], [], [], []
        for mixtures, share in guides:
            for side in (0, 1):
                part = 1 + side
                proper = np.flatnonzero(np.isfinite(mixtures.log_weights[part]) & ~mixtures.flat[part])
                if not len(proper):
                    continue
                weights = np.exp(normalised(mixtures.log_weights[part, proper]))
                sides.append(np.full(len(proper), side))
                shares.append(0.5 * GUIDED * share * (0.5 * weights + 0.5 / len(proper)))
                means.append(mixtures.means[part, proper])
                covariances.append(mixtures.covariances[part, proper])
        if not sides:
            return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.0)
        return cls(
            np.concatenate(sides),
            np.concatenate(shares),
            np.concatenate(means),
            np.concatenate(covariances),
            AT_ELBOWS * bare,
        )

    def log_mean_density(self, side: int, places: Array) -> Array:
        """`(n,)` nats: log of the mean of the Gaussians of a side at `places` `(n, 2)` px."""
        own = np.flatnonzero(self.sides == side)
        precisions = np.linalg.inv(self.covariances[own])
        apart = places[:, None] - self.means[own]
        squares = np.einsum("nkx,kxy,nky->nk", apart, precisions, apart)
        heights = np.log(np.sqrt(np.linalg.det(precisions)) / (2 * np.pi * len(own)))
        return np.asarray(logsumexp(heights - 0.5 * squares, axis=1))


def draw_guided(
    dynamics: BodyDynamics,
    past: Ancestors,
    guides: Sequence[tuple[GaussianMixtures, float]],
    n: int,
    random: np.random.Generator,
    bare: float = 0.0,
) -> Guided:
    """Draw `n` poses and leave out those that are impossible.

    `past`: k weighted poses of the frame before, resampled over all `Strata`; `guides`: mixtures of head and
    hands, with the shares, of sum 1, of the poses that they guide; flat components are ignored; `bare`:
    probability that forearms are bare, so that elbows look like hands.
    """
    body, elapsed = dynamics.body, past.elapsed
    with np.errstate(divide="ignore"):
        log_weights = np.log(past.weights)
    log_choice = Strata.of(body, past.poses).balanced(log_weights)
    joints = body.joints(past.poses)
    hidden = _HiddenCoordinates.of(dynamics, past.poses, joints, elapsed)
    targets = _Targets.of(guides, bare)
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
    """`(k_targets, k_past)`: weight of each past pose for a target, over its weight without one."""
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
    """Move arms of `poses`, in place, to draws from their targets; return whether they reach, `(n,)`."""
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
        if targets.at_elbows > 0:
            moved = np.flatnonzero(random.random(count) < targets.at_elbows)
            ends = random.choice(np.flatnonzero(targets.sides == side), len(moved))
            steps = random.standard_normal((len(moved), 2))
            elbows = targets.means[ends] + np.einsum("nxy,ny->nx", roots[ends], steps)
            upper, fore = elbows - shoulders[rows[moved], side], places[moved] - elbows
            poses.arms[rows[moved], side], possible[rows[moved]] = _through(body, upper, fore, random)
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
    """`(n,)` nats: log density of the arms of a draw given its ancestor, up to factors that all share."""
    joints = body.joints(poses)
    completions, values = np.empty((len(poses), 2)), np.empty(len(poses))
    concentration = np.array([hidden.concentration, 2 * np.pi * i0e(hidden.concentration)])
    lengths = np.array([body.upper_arm, body.forearm])

    def complete(first: int, end: int) -> None:
        completion_terms(
            joints[first:end], poses.arms[first:end], chosen[first:end], hidden.depths, hidden.swivels,
            hidden.step, concentration, ANYWHERE, lengths, LEAST_DEPTH, REFERENCE, completions[first:end],
        )  # fmt: skip

    over_bands(complete, len(poses), worth=len(poses) >= WORTH_THREADS)
    for side in (0, 1):
        if targets.at_elbows > 0 and (targets.sides == side).any():
            elbows = targets.log_mean_density(side, joints[:, HANDS[side] - 1, :2])
            completions[:, side] = _or_through(
                body, completions[:, side], elbows, poses.arms[:, side], targets.at_elbows
            )
    precisions = np.linalg.inv(targets.covariances)
    heights = targets.shares * np.sqrt(np.linalg.det(precisions)) / (2 * np.pi)
    heights = np.append(heights, 1.0 - targets.shares.sum())
    hands = np.ascontiguousarray(joints[:, HANDS, :2])

    def guided(first: int, end: int) -> None:
        guided_values(
            hands[first:end], chosen[first:end], walks[first:end], completions[first:end], targets.sides,
            targets.means, precisions, heights, closeness, values[first:end],
        )  # fmt: skip

    over_bands(guided, len(poses), worth=len(poses) >= WORTH_THREADS)
    return values


@dataclass(frozen=True, eq=False)
class _HiddenCoordinates:
    """Coordinates of arms that a hand's position in the image leaves open: its depth, the elbow's swivel."""

    depths: Array  # (k, 2) px, from the shoulder
    swivels: Array  # (k, 2) rad
    step: float  # px: standard deviation of a hand's step along an axis
    concentration: float  # of a swivel's von Mises density about the ancestor's

    @classmethod
    def of(
        cls, dynamics: BodyDynamics, poses: BodyPoses, joints: Array, elapsed: float
    ) -> "_HiddenCoordinates":
        body = dynamics.body
        angles = np.stack([swivels(side, poses.arms[:, side], body) for side in (0, 1)], axis=1)
        scale = np.sqrt(elapsed)
        step = scale * np.hypot(body.upper_arm * dynamics.upper_arm, body.forearm * dynamics.forearm)
        # an elbow turns about the line to the hand, from which it is about half an upper arm away
        turn = scale * 2 * dynamics.upper_arm
        return cls(joints[:, [4, 7], 2] - joints[:, [2, 5], 2], angles, float(step), 1 / turn**2)


def _chosen(
    choice: Array, shares: Array, closeness: Array, n: int, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Draw `(n,)` ancestors and their targets `(n,)`, -1 for none."""
    ends = np.floor(n * np.cumsum(shares) + random.random()).astype(np.int64)
    counts = np.diff(ends, prepend=0)
    counts = np.append(counts, n - counts.sum())
    chosen = np.empty(n, np.int64)
    choose(choice, closeness, counts, random.random(len(counts)), chosen)
    return chosen, np.repeat(np.append(np.arange(len(shares)), -1), counts)


RESTARTED = 0.1  # share of candidates without a past, at least: a body that reappears elsewhere needs them


@dataclass(frozen=True, eq=False)
class Candidates:
    """n weighted samples of p(x_t | past), each with the pose it descends from."""

    dynamics: BodyDynamics  # of the body
    size: tuple[int, int]  # `(height, width)` px of the image
    elapsed: float  # s since the frame before
    poses: BodyPoses  # all possible
    log_weights: Array  # `(n,)`; normalised after `weighted`
    ancestors: BodyPoses  # n poses of the frame before; restarted poses are their own
    restarted: NDArray[np.bool_]  # `(n,)`: which ones were drawn without a past

    @classmethod
    def of_first_frame(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        starts: GaussianMixtures,
        n: int,
        random: np.random.Generator,
        rounds: int = MOST_ROUNDS,
        bare: float = 0.0,
    ) -> Self:
        """Draw poses without a past, from proper mixtures `starts` of head and hands."""
        proposal = draw_from_likelihood(dynamics, starts, n, random, rounds, bare)
        log_weights = dynamics.log_density_anywhere(proposal.poses, size) - proposal.log_density
        log_weights -= np.log(max(proposal.tried, 1.0))
        count = len(proposal.poses)
        return cls(
            dynamics, size, np.inf, proposal.poses, log_weights, proposal.poses, np.ones(count, np.bool_)
        )

    @classmethod
    def of_next_frame(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        past: Ancestors,
        guides: Sequence[tuple[GaussianMixtures, float]],
        starts: GaussianMixtures,
        n: int,
        random: np.random.Generator,
        bare: float = 0.0,
    ) -> Self:
        """Draw most poses from the past, guided (`draw_guided`), and some without, from `starts`."""
        log_elsewhere, log_stays = dynamics.log_returns(past.elapsed)
        n_restarted = round(max(RESTARTED, np.exp(log_elsewhere)) * n)
        fresh = cls.of_first_frame(dynamics, size, starts, n_restarted, random, rounds=1, bare=bare)
        continued = draw_guided(dynamics, past, guides, max(n - n_restarted, 1), random, bare)
        return cls(
            dynamics,
            size,
            past.elapsed,
            BodyPoses.concatenated([fresh.poses, continued.poses]),
            np.concatenate([fresh.log_weights + log_elsewhere, continued.log_weights + log_stays]),
            BodyPoses.concatenated([fresh.poses, past.poses.take(continued.ancestors)]),
            np.arange(len(fresh.poses) + len(continued.poses)) < len(fresh.poses),
        )

    def weighted(self, log_factors: Array) -> Self:
        """Multiply the weights by factors `(n,)` nats, and normalise them."""
        return replace(self, log_weights=normalised(self.log_weights + log_factors))

    def log_prior(self, poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
        """`(m,)` nats: log prior of poses given the ancestors of candidates `owners` `(m,)`, up to a constant
        of each; minus infinity where joints forbid a pose."""
        dynamics, restarted = self.dynamics, self.restarted[owners]
        prior = np.full(len(poses), -np.inf)
        fresh, continued = np.flatnonzero(restarted), np.flatnonzero(~restarted)
        if len(fresh):
            prior[fresh] = dynamics.log_density_anywhere(poses.take(fresh), self.size)
        if len(continued):
            before = self.ancestors.take(owners[continued])
            prior[continued] = dynamics.log_step(poses.take(continued), before, self.elapsed)
        return np.where(dynamics.body.allowed(poses), prior, -np.inf)

"""Poses of a frame drawn from those of the frame before, some of them towards what is seen of the hands.

Isard and Blake, "ICondensation" (1998), with likelihood sampling (RSMCM paper §4.1; Taycher and Darrell 2003)
as what guides: most poses are moved by the dynamics alone; in the others one hand is drawn at a place that is
said of it, from a pose that had it near there, and the arm is completed by inverse kinematics.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from ...inference.smc import normalised
from ...models.body.inverse_kinematics import arm_at, log_volume, swivels
from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from ...models.core.gaussian_mixtures import GaussianMixtures
from .dynamics import Ancestors, BodyDynamics
from .kernels.guided_sampling import choose, closeness_to, guided_values
from .likelihood_sampling import half_range
from .strata import Strata

Array = NDArray[np.float64]

GUIDED = 0.35
"""Share of the poses of which a hand is drawn where it is seen."""

ANYWHERE = 0.2
"""Share of these whose depth and swivel are drawn without regard to the past, which may be wrong of them."""

FARAWAY = 1e-3
"""How readily a pose is chosen whose hand is far away, over one whose hand is there: arms jump."""

HANDS = (4, 7)
"""Of `models.body.upper_body.JOINTS`."""


@dataclass(frozen=True, eq=False)
class Guided:
    """Draws of poses.

    Parameters
    ----------
    poses
        n of them, all possible; none, if no draw was.
    log_weights
        `(n,)` of the prediction p(x_t | past): what it says of a pose and its ancestor together, over the
        density of their draw; normalised.
    ancestors
        `(n,)` int64: of each, the pose of the past that it was drawn from.
    """

    poses: BodyPoses
    log_weights: Array
    ancestors: NDArray[np.int64]


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


@dataclass(frozen=True)
class GuidedSampler:
    """Draws poses from weighted poses of the frame before and from mixtures of places of the hands.

    Parameters
    ----------
    dynamics
        of the body.
    """

    dynamics: BodyDynamics

    @property
    def body(self) -> UpperBody:
        """Whose poses are drawn."""
        return self.dynamics.body

    def draw(
        self,
        past: Ancestors,
        said: Sequence[tuple[GaussianMixtures, float]],
        n: int,
        random: np.random.Generator,
    ) -> Guided:
        """Draw `n` poses and leave out those that are impossible.

        Parameters
        ----------
        past
            k weighted poses of the frame before, which are drawn from all `Strata`.
        said
            of head and hands, with the shares, of sum 1, of the poses that these guide; flat components guide
            nobody.
        """
        body, dynamics, elapsed = self.body, self.dynamics, past.elapsed
        with np.errstate(divide="ignore"):
            log_weights = np.log(past.weights)
        log_choice = Strata.of(body, past.poses).balanced(log_weights)
        joints = body.joints(past.poses)
        hidden = _HiddenCoordinates.of(dynamics, past.poses, joints, elapsed)
        targets = _Targets.of(said)
        choice = np.exp(log_choice)
        closeness = self._closeness(targets, joints, hidden.step, choice)
        chosen, target = _chosen(choice, targets.shares, closeness, n, random)
        poses = dynamics.draw(past.poses.take(chosen), elapsed, random)
        possible = self._guide(poses, chosen, target, targets, hidden, random)
        possible &= body.allowed(poses)
        poses, chosen = poses.take(possible), chosen[possible]
        parents = past.poses.take(chosen)
        walks = dynamics.log_arm_steps(poses, parents, elapsed)
        drawn = self._log_drawn(poses, chosen, targets, closeness, hidden, walks)
        log_weights = log_weights[chosen] - log_choice[chosen] + walks.sum(axis=1) - drawn
        log_weights += dynamics.log_posture(poses, elapsed)
        return Guided(poses, normalised(log_weights), chosen)

    def _closeness(self, targets: _Targets, joints: Array, step: float, choice: Array) -> Array:
        """`(k_targets, k_past)`: how readily a pose is chosen for a target, over how it is chosen else."""
        wide = np.linalg.inv(targets.covariances + step**2 * np.eye(2))
        closeness = np.empty((len(targets.sides), len(joints)))
        hands = np.ascontiguousarray(joints[:, HANDS, :2])
        closeness_to(hands, targets.sides, targets.means, wide, FARAWAY, choice, closeness)
        return closeness

    def _guide(
        self,
        poses: BodyPoses,
        chosen: NDArray[np.int64],
        target: NDArray[np.int64],
        targets: _Targets,
        hidden: "_HiddenCoordinates",
        random: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Put arms of `poses` in place to their targets; the result, `(n,)`, is whether they reach them."""
        body = self.body
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
        self,
        poses: BodyPoses,
        chosen: NDArray[np.int64],
        targets: _Targets,
        closeness: Array,
        hidden: "_HiddenCoordinates",
        walks: Array,
    ) -> Array:
        """`(n,)` nats: density of a draw given its ancestor, over what all draws have in common."""
        body = self.body
        joints = body.joints(poses)
        completions = np.empty((len(poses), 2))
        for side in (0, 1):
            offsets = joints[:, HANDS[side]] - joints[:, HANDS[side] - 2]
            angles = swivels(side, poses.arms[:, side], body)
            near = hidden.log_density(chosen, side, offsets[:, 2], angles)
            evenly = np.log(ANYWHERE / (4 * np.pi)) - np.log(half_range(body, offsets))
            completions[:, side] = np.logaddexp(np.log1p(-ANYWHERE) + near, evenly) + log_volume(
                body, offsets
            )
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

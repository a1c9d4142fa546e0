"""Drawing poses from what is said of head and hands, completed by inverse kinematics: a proposal.

Taycher and Darrell, "Bayesian articulated tracking using single frame pose sampling" (2003), and RSMCM paper
§4.1: positions of head and hands are drawn from their mixtures; once neck and hands are given, an arm has two
degrees of freedom left.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from ...models.body.inverse_kinematics import arm_at, log_volume, swivels
from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from ...models.core.gaussian_mixtures import GaussianMixtures
from ..filters.resampling import systematic
from .dynamics import Ancestors, BodyDynamics
from .kernels.dynamics import completion_values, least_squares_to_rows

Array = NDArray[np.float64]

MOST_ROUNDS = 40
"""Of drawing again what the joints do not allow, which is left out before it costs much. The density of what
is left is the same but for a factor that is common to all."""

LEAST_DEPTH = 1.0
"""px: smallest half range of a hand's depth, so that a stretched arm has a density."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Poses and the density from which they were drawn.

    Parameters
    ----------
    poses
        all within reach and limits.
    log_density
        `(n,)` nats, in the measure of `BodyDynamics.log_density`, up to a constant.
    """

    poses: BodyPoses
    log_density: Array


@dataclass(frozen=True)
class LikelihoodSampler:
    """Draws poses from mixtures of head and hands.

    Torso and neck are drawn from their dynamics. Depth of a hand, from its shoulder, and swivel of an elbow
    are drawn around those of a pose of the frame before, or else evenly over all that the arm can reach,
    which finds an arm again of which the past is wrong. (The paper draws them without the past.)

    Parameters
    ----------
    dynamics
        of the body.
    anywhere
        probability that an arm's depth and swivel are drawn without regard to the past.
    breadth
        standard deviations of depth and swivel around a past pose, over those of the dynamics.
    """

    dynamics: BodyDynamics
    anywhere: float = 0.3
    breadth: float = 1.0

    @property
    def body(self) -> UpperBody:
        """Whose poses are drawn."""
        return self.dynamics.body

    def draw(
        self, mixtures: GaussianMixtures, past: Ancestors | None, n: int, random: np.random.Generator
    ) -> Proposal:
        """Draw `n` poses, or as many as turn out to be possible.

        Parameters
        ----------
        mixtures
            of head, left and right hand; proper, without flat components.
        past
            `None` where nothing is known of it.
        """
        found: list[BodyPoses] = []
        missing = n
        for _ in range(MOST_ROUNDS):
            found.append(self._possible(mixtures, past, n, random).take(slice(missing)))
            missing -= len(found[-1])
            if not missing:
                break
        poses = BodyPoses.concatenated(found)
        return Proposal(poses, self._log_density(poses, mixtures, past))

    def _possible(
        self, mixtures: GaussianMixtures, past: Ancestors | None, n: int, random: np.random.Generator
    ) -> BodyPoses:
        """At most `n` poses within reach and limits, of as many draws."""
        body, dynamics = self.body, self.dynamics
        places = np.stack([draw_mixture(mixtures, part, n, random) for part in range(3)], axis=1)
        if past is None:
            near = None
            turns = dynamics.turn_spreads * random.standard_normal((n, 6))
        else:
            chosen = random.permutation(systematic(np.log(past.weights), n, random))
            kept, spread = dynamics.turn_step(past.elapsed)
            turns = kept * past.poses.turns[chosen] + spread * random.standard_normal((n, 6))
            near = _Hidden.of(self, past).take(chosen)
        torsos, necks = turns[:, :3].copy(), turns[:, 3:].copy()
        trunks = BodyPoses(np.zeros((n, 2)), torsos, necks, np.zeros((n, 2, 2, 3)))
        roots = places[:, 0] - body.parts(trunks)[:, 0]
        shoulders = body.shoulders(trunks)[:, :, :2] + roots[:, None]
        arms = np.empty((n, 2, 2, 3))
        possible = np.ones(n, np.bool_)
        for side in (0, 1):
            offsets = np.zeros((n, 3))
            offsets[:, :2] = places[:, 1 + side] - shoulders[:, side]
            offsets[:, 2], angles = self._complete(side, offsets, near, random)
            arms[:, side], within = arm_at(body, side, offsets, angles)
            possible &= within
        poses = BodyPoses(roots, torsos, necks, arms).take(possible)
        return poses.take(body.allowed(poses))

    def _half_range(self, offsets: Array) -> Array:
        """`(n,)` px: greatest depth of a hand at `offsets` `(n, 2)` from its shoulder, either way."""
        reach = self.body.upper_arm + self.body.forearm
        return np.asarray(np.sqrt(np.maximum(reach**2 - (offsets**2).sum(axis=1), LEAST_DEPTH**2)))

    def _complete(
        self, side: int, offsets: Array, near: "_Hidden | None", random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Depth of the hand and swivel of the elbow, each `(n,)`."""
        count = len(offsets)
        half = self._half_range(offsets[:, :2])
        depths = half * random.uniform(-1, 1, count)
        angles = random.uniform(-np.pi, np.pi, count)
        if near is not None:
            close = random.random(count) >= self.anywhere
            depth = near.depths[:, side] + near.spread * random.standard_normal(count)
            angle = near.swivels[:, side] + random.vonmises(0.0, near.concentration, count)
            depths, angles = np.where(close, depth, depths), np.where(close, angle, angles)
        return depths, angles

    def _log_density(self, poses: BodyPoses, mixtures: GaussianMixtures, past: Ancestors | None) -> Array:
        body, dynamics = self.body, self.dynamics
        joints = body.joints(poses)
        total = mixtures.log_values(joints[:, [0, 4, 7], :2]).sum(axis=1)
        evenly = np.empty((len(poses), 2))
        for side in (0, 1):
            offsets = joints[:, 4 + 3 * side] - joints[:, 2 + 3 * side]
            total += log_volume(body, offsets)
            evenly[:, side] = 1 / (4 * np.pi * self._half_range(offsets[:, :2]))
        if past is None:
            square = ((poses.turns / dynamics.turn_spreads) ** 2).sum(axis=1)
            return np.asarray(total - 0.5 * square + np.log(evenly).sum(axis=1))
        here, there = _Hidden.of(self, Ancestors(poses, past.weights, past.elapsed)), _Hidden.of(self, past)
        kept, spread = dynamics.turn_step(past.elapsed)
        turns = (poses.turns / spread).astype(np.float32)
        rows = np.ascontiguousarray((kept * past.poses.turns / spread).T, np.float32)
        least = np.empty(len(poses), np.float32)
        least_squares_to_rows(turns, rows, least)
        peak = (1 - self.anywhere) * here.peak
        values = np.empty(len(poses), np.float32)
        completion_values(
            turns, rows, least,
            here.coordinates.astype(np.float32), np.ascontiguousarray(there.coordinates.T, np.float32),
            past.weights.astype(np.float32), (self.anywhere * evenly / peak).astype(np.float32), values,
        )  # fmt: skip
        return np.asarray(total + np.log(values.astype(np.float64)) - 0.5 * least)


@dataclass(frozen=True, eq=False)
class _Hidden:
    """Of each arm what head and hands in the picture do not tell: depth of the hand, swivel of the elbow."""

    depths: Array  # (n, 2) px, from the shoulder
    swivels: Array  # (n, 2) rad
    spread: float  # px, of a depth around another
    concentration: float  # of a swivel around another

    @classmethod
    def of(cls, sampler: LikelihoodSampler, past: Ancestors) -> "_Hidden":
        body, dynamics = sampler.body, sampler.dynamics
        joints = body.joints(past.poses)
        angles = np.stack([swivels(side, past.poses.arms[:, side], body) for side in (0, 1)], axis=1)
        scale = sampler.breadth * np.sqrt(past.elapsed)
        spread = scale * np.hypot(body.upper_arm * dynamics.upper_arm, body.forearm * dynamics.forearm)
        # an elbow turns about the line to the hand, from which it is half an upper arm away, say
        turn = scale * 2 * dynamics.upper_arm
        return cls(joints[:, [4, 7], 2] - joints[:, [2, 5], 2], angles, float(spread), 1 / turn**2)

    def take(self, chosen: NDArray[np.int64]) -> "_Hidden":
        return _Hidden(self.depths[chosen], self.swivels[chosen], self.spread, self.concentration)

    @property
    def coordinates(self) -> Array:
        """`(n, 6)`: per arm, numbers whose half squared distances are the exponents of the density."""
        root = np.sqrt(self.concentration)
        each = (self.depths / self.spread, root * np.cos(self.swivels), root * np.sin(self.swivels))
        return np.stack(each, axis=2).reshape(len(self.depths), 6)

    @property
    def peak(self) -> float:
        """Largest density of depth and swivel around another's."""
        normal = np.sqrt(2 * np.pi) * self.spread
        return float(1 / (normal * 2 * np.pi * i0e(self.concentration)))


def draw_mixture(mixtures: GaussianMixtures, part: int, n: int, random: np.random.Generator) -> Array:
    """`(n, 2)` px: positions of one part, whose components are all proper, in random order."""
    chosen = random.permutation(systematic(mixtures.log_weights[part], n, random))
    roots = np.linalg.cholesky(mixtures.covariances[part])[chosen]
    steps = np.einsum("nxy,ny->nx", roots, random.standard_normal((n, 2)))
    return np.asarray(mixtures.means[part][chosen] + steps)

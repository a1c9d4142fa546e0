"""Drawing poses from what is said of head and hands, completed by inverse kinematics: a proposal.

Taycher and Darrell, "Bayesian articulated tracking using single frame pose sampling" (2003), and RSMCM paper
§4.1: positions of head and hands are drawn from their mixtures; once torso, neck and hands are given, an arm
has two degrees of freedom left. Where a past is known, `guided_sampling` draws with regard to it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import systematic
from ...models.body.inverse_kinematics import arm_at, log_volume
from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from ...models.core.gaussian_mixtures import GaussianMixtures
from .dynamics import BodyDynamics

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
        `(n,)` nats, in the measure of `BodyDynamics.log_density_anywhere`.
    tried
        how many were drawn, those that are impossible among them.
    """

    poses: BodyPoses
    log_density: Array
    tried: float


@dataclass(frozen=True)
class LikelihoodSampler:
    """Draws poses of somebody of whom nothing is known from mixtures of head and hands.

    Torso and neck are drawn as they are in the long run; depth of a hand, from its shoulder, and swivel of an
    elbow evenly over all that the arm can reach.

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
        self, mixtures: GaussianMixtures, n: int, random: np.random.Generator, rounds: int = MOST_ROUNDS
    ) -> Proposal:
        """Draw `n` poses, or as many as turn out to be possible in so many rounds of `n`.

        Parameters
        ----------
        mixtures
            of head, left and right hand; proper, without flat components.
        """
        found: list[BodyPoses] = []
        while sum(map(len, found)) < n and len(found) < rounds:
            found.append(self._possible(mixtures, n, random))
        every = BodyPoses.concatenated(found)
        poses = every.take(slice(n))
        tried = len(found) * n * len(poses) / max(len(every), 1)
        return Proposal(poses, self._log_density(poses, mixtures), tried)

    def _possible(self, mixtures: GaussianMixtures, n: int, random: np.random.Generator) -> BodyPoses:
        """At most `n` poses within reach and limits, of as many draws."""
        body = self.body
        places = np.stack([draw_mixture(mixtures, part, n, random) for part in range(3)], axis=1)
        turns = self.dynamics.turn_spreads * random.standard_normal((n, 6))
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

    def _log_density(self, poses: BodyPoses, mixtures: GaussianMixtures) -> Array:
        body = self.body
        joints = body.joints(poses)
        spreads = self.dynamics.turn_spreads
        total = mixtures.log_values(joints[:, [0, 4, 7], :2]).sum(axis=1) - mixtures.log_masses.sum()
        total -= (
            0.5 * ((poses.turns / spreads) ** 2).sum(axis=1) + np.log(spreads).sum() + 3 * np.log(2 * np.pi)
        )
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

"""Weighted samples of an upper body's pose, the state of chains that track one, and what they come to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ...inference.smc import copied, log_sum, normalised, systematic
from ...models.body.parts import PartMessage
from ...models.body.upper_body import JOINTS, PARTS, BodyPoses, UpperBody
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.core.short_repr import short_repr
from .dynamics import Ancestors, BodyDynamics

Array = NDArray[np.float64]

MISTAKEN = 0.2  # chance that a part is where the samples do not expect it, as others are told
A_MOMENT = 0.04  # s: poses to start from are as uncertain as after so long a time
LONGEST = 60.0  # s: after so long without a frame no more is forgotten of a pose
LEAST_SPREAD = 1.0  # px: standard deviation that is added to a part's, since samples may coincide


@short_repr
@dataclass(frozen=True, eq=False)
class BodySamples:
    """Weighted poses."""

    poses: BodyPoses  # n of them
    log_weights: Array  # `(n,)`, of weights that sum to 1
    size: tuple[int, int]  # `(height, width)` px of the picture
    random: np.random.Generator  # generator of the draws to come
    # of a prediction, poses of the frame before, and some of them with exchanged hands; `poses` are draws of
    # their mixture. `None` in a posterior, before the first frame, and where they are not kept.
    ancestors: Ancestors | None = None
    # of a prediction, the samples from which it was made, and s since then
    before: "BodySamples | None" = None
    elapsed: float = 0.0
    # nats: log of the mean likelihood of the frame, up to a constant; 0 without an image
    log_evidence: float = 0.0
    # whether the frame said nothing of any part, so that the poses are only predicted
    stationary: bool = False

    @classmethod
    def even(cls, poses: BodyPoses, size: tuple[int, int], random: np.random.Generator) -> Self:
        """Of equal weight, without ancestors."""
        n = len(poses)
        return cls(poses, np.full(n, -np.log(n)), size, random)

    @cached_property
    def weights(self) -> Array:
        """`(n,)`, with sum 1."""
        return np.exp(normalised(self.log_weights))

    def origin(self, dt: float) -> tuple["BodySamples", float]:
        """Samples to predict from, and s from then to `dt` s after these; at most `LONGEST`.

        The prediction of a prediction starts anew from what that one was made of, so that it is a function of
        the seconds and not of the number of steps.
        """
        return self.before or self, min(self.elapsed + dt, LONGEST)

    @property
    def effective(self) -> float:
        """Number of equally weighted samples that would say as much."""
        return float(1 / (self.weights**2).sum())

    def drawn(self, n: int, random: np.random.Generator) -> BodyPoses:
        """`n` poses of equal weight, drawn systematically."""
        return self.poses.take(systematic(self.log_weights, n, random))

    def reweighed(self, log_factors: Array) -> "BodySamples":
        """A posterior: weights are multiplied by factors, whose mean is the evidence."""
        log_weights = self.log_weights + log_factors
        evidence = log_sum(log_weights)
        if not np.isfinite(evidence):  # nothing fits: the prediction is kept
            log_weights, evidence = self.log_weights, 0.0
        return BodySamples(self.poses, log_weights - evidence, self.size, self.random, log_evidence=evidence)


def first(
    dynamics: BodyDynamics,
    n: int,
    size: tuple[int, int],
    random: np.random.Generator,
    start: BodyPoses | None = None,
) -> BodySamples:
    """`n` poses at the first frame: about those of `start`, as if these were from a moment before, or else
    those of a person of whom only is known that the picture of `size` (height, width) shows them."""
    if start is None:
        poses, ancestors = dynamics.draw_anywhere(n, size, random), None
    else:
        poses = dynamics.draw(start.take(np.arange(n) % len(start)), A_MOMENT, random)
        ancestors = Ancestors(start, np.full(len(start), 1 / len(start)), A_MOMENT)
    return replace(BodySamples.even(poses, size, random), ancestors=ancestors, stationary=True)


def predicted(dynamics: BodyDynamics, state: BodySamples, n: int, dt: float) -> BodySamples:
    """`n` draws of the dynamics around the poses of `state`, `dt` seconds on (mu_{X(t-1) -> X(t)}).

    Hands may be exchanged before (`with_exchanged`). What joints do not allow has no weight, and unusual
    postures have little. A prediction of a prediction starts where the first one did.
    """
    state, dt = state.origin(dt)
    random = copied(state.random)
    ancestors = dynamics.with_exchanged(Ancestors(state.poses, state.weights, dt), random)
    with np.errstate(divide="ignore"):
        drawn = systematic(np.log(ancestors.weights), n, random)
    poses = dynamics.draw(ancestors.poses.take(drawn), dt, random)
    possible = np.where(dynamics.body.allowed(poses), dynamics.log_posture(poses, dt), -np.inf)
    return BodySamples(poses, normalised(possible), state.size, random, ancestors, state, dt)


def stationary(state: BodySamples, log_factors: Array) -> BodySamples:
    """The prediction as the posterior of a frame that says nothing, weighted by what others tell."""
    return replace(state.reweighed(log_factors), log_evidence=0.0, stationary=True)


@short_repr
@dataclass(frozen=True, eq=False)
class BodyMoments:
    """Means and covariances of weighted poses."""

    # `(8, 3)` px and `(8, 3, 3)` px^2, in the order of `models.body.upper_body.JOINTS`
    joints: Array
    joint_covariances: Array
    # `(16,)` and `(16, 16)`, px and rad, of `BodyPoses.angles`
    angles: Array
    angle_covariances: Array


def body_moments(body: UpperBody, samples: BodySamples) -> BodyMoments:
    """Means and covariances of joints and angles."""
    weights = samples.weights
    mean, covariance = weighted_moments(body.joints(samples.poses), weights)
    angles = samples.poses.angles
    typical = np.einsum("n,na->a", weights, angles)
    away = angles - typical
    return BodyMoments(mean, covariance, typical, np.einsum("n,na,nb->ab", weights, away, away))


def weighted_moments(places: Array, weights: Array) -> tuple[Array, Array]:
    """Means `(k, d)` and covariances `(k, d, d)` of `places` `(n, k, d)` with `weights` `(n,)` of sum 1."""
    mean = np.einsum("n,nkx->kx", weights, places)
    apart = places - mean
    return mean, np.einsum("n,nkx,nky->kxy", weights, apart, apart)


def part_message(body: UpperBody, poses: BodyPoses, weights: Array, groups: int) -> PartMessage:
    """What weighted poses say of the parts: for each a mixture of a few Gaussians, which integrates to 1.

    Along the direction in which a part is most uncertain the poses are cut into `groups` of equal numbers;
    each becomes a Gaussian with its moments, so that those of the whole stay what they are. A broad one is
    added: samples of somebody who is mistaken know nothing of it.
    """
    places = body.parts(poses)
    reach = 0.5 * (body.upper_arm + body.forearm)
    broad = np.square([body.head_height, reach, reach])
    log_weights: list[Array] = []
    means: list[Array] = []
    covariances: list[Array] = []
    for part in range(len(PARTS)):
        masses, centres, spreads = _grouped(places[:, part], weights, groups)
        log_weights.append(np.append(masses + np.log1p(-MISTAKEN), np.log(MISTAKEN)))
        means.append(np.concatenate([centres, np.einsum("n,nx->x", weights, places[:, part])[None]]))
        covariances.append(np.concatenate([spreads, broad[part] * np.eye(2)[None]]))
    return PartMessage(GaussianMixtures.of_parts(log_weights, means, covariances))


def _grouped(places: Array, weights: Array, groups: int) -> Sequence[Array]:
    # einsum, since sums of linear algebra depend on its number of threads
    mean = np.einsum("n,nx->x", weights, places)
    apart = places - mean
    axes = np.linalg.eigh(np.einsum("n,nx,ny->xy", weights, apart, apart))[1]
    order = np.argsort(np.einsum("nx,x->n", apart, axes[:, 1]), kind="stable")
    n = len(order) // groups * groups
    # the few that are left over go to the last group
    numbers = np.minimum(np.arange(len(order)) // max(n // groups, 1), groups - 1)
    membership = np.zeros((groups, len(order)))
    membership[numbers, order] = weights[order]
    mass = membership.sum(axis=1)
    used = mass > 0
    share = membership[used] / mass[used, None]
    means = np.einsum("gn,nx->gx", share, places)
    steps = places - means[:, None]
    covariances = np.einsum("gn,gnx,gny->gxy", share, steps, steps) + LEAST_SPREAD**2 * np.eye(2)
    return np.log(mass[used]), means, covariances


MOST = 4  # hypotheses of a frame that are told apart
WORTH_SAYING = 0.1  # probability from which a second answer is shown
ENOUGH = 200  # poses that tell them

HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Answers for one frame, the most probable first."""

    weights: Array  # `(4,)` probabilities, 0 where there are fewer; what is missing to 1 is of further ones
    joints: Array  # `(4, 8, 3)` px: the mean pose of each, NaN where there are fewer
    apart: float  # px: hands that are farther than this from the first answer's are elsewhere

    @property
    def second(self) -> Array | None:
        """`(8, 3)` px: the second best answer, where it is worth saying."""
        return self.joints[1] if self.weights[1] >= WORTH_SAYING else None

    @property
    def unsure(self) -> Array:
        """`(2,)`: probability that left and right hand are elsewhere than in the first answer."""
        away = np.linalg.norm(self.joints[:, HANDS, :2] - self.joints[0, HANDS, :2], axis=2)
        return np.asarray(self.weights @ (away > self.apart))


def hypotheses(body: UpperBody, samples: BodySamples, random: np.random.Generator) -> Hypotheses:
    """Gather poses of which one leads to the next by steps that move no hand by more than its radius.

    So a hand that may be anywhere within a region is one answer, and two of a hand's places are two if no
    poses lie between them. Of many samples some are drawn, by `random`.
    """
    poses, weights = samples.poses, samples.weights
    if len(poses) > ENOUGH:
        poses, weights = samples.drawn(ENOUGH, random), np.full(ENOUGH, 1 / ENOUGH)
    joints = body.joints(poses)
    hands = joints[:, HANDS, :2]
    steps = np.linalg.norm(hands[:, None] - hands, axis=3).max(axis=2)
    count, group = connected_components(steps <= body.hand, directed=False)
    masses = np.bincount(group, weights, count)
    best = np.argsort(-masses, kind="stable")[:MOST]
    best = best[masses[best] > 0]
    found = np.zeros(MOST)
    found[: len(best)] = masses[best]
    means = np.full((MOST, *joints.shape[1:]), np.nan)
    for place, chosen in enumerate(best):
        share = np.where(group == chosen, weights, 0) / masses[chosen]
        means[place] = np.einsum("n,njx->jx", share, joints)
    return Hypotheses(found, means, body.hand)

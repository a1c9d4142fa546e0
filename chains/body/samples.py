"""Weighted samples of an upper body's pose, their moments, message and hypotheses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ...inference.smc import copied, log_sum, normalised, systematic
from ...models.body.parts import PartMessage
from ...models.body.upper_body import JOINTS, PARTS, BodyPoses, UpperBody
from ...models.core.checks import LOG_WEIGHTS, NEAR, Bound, NotNegative, Shape, SizesOf, checked
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.core.short_repr import short_repr
from .dynamics import Ancestors, BodyDynamics

Array = NDArray[np.float64]

MISTAKEN = 0.2  # probability in messages that a part is not where the samples have it
START_TIME = 0.04  # s: given poses are as uncertain as poses so long ago
LONGEST = 60.0  # s without a frame after which a prediction widens no more
SAMPLE_STD = 1.0  # px: standard deviation added to a part's, since samples may coincide


@short_repr
@dataclass(frozen=True, eq=False)
class BodySamples:
    """Weighted poses."""

    poses: Annotated[BodyPoses, Bound(lambda poses: NEAR.holds(poses.roots), NEAR.expected)]  # n of them
    log_weights: Annotated[Array, Shape("n", finite=False), LOG_WEIGHTS]  # of weights that sum to 1
    size: Annotated[tuple[int, int], SizesOf("height", "width")]  # px of the picture
    random: np.random.Generator  # generator of the draws to come
    # of a prediction: poses of the frame before, some of them with exchanged hands, whose mixture was drawn
    # from; `None` in a posterior, before the first frame, and where they are not kept
    ancestors: Ancestors | None = None
    # of a prediction, the samples from which it was made, and s since then
    before: "BodySamples | None" = None
    elapsed: NotNegative = 0.0
    # nats: log of the mean likelihood of the frame, up to a constant; 0 without an image
    log_evidence: float = 0.0
    stationary: bool = False  # whether the frame showed no part, so that the poses are only predicted

    def require_fit(self) -> None:
        """Raise a `ValueError` if not every pose has a weight."""
        if len(self.poses) != len(self.log_weights):
            raise ValueError(f"poses: got {len(self.poses)}, expected {len(self.log_weights)} with weights")
        if self.ancestors is not None and len(self.ancestors.poses) != len(self.ancestors.weights):
            raise ValueError(f"ancestors: got {len(self.ancestors.poses)} poses, expected each with a weight")

    @classmethod
    def even(cls, poses: BodyPoses, size: tuple[int, int], random: np.random.Generator) -> Self:
        """Weight the poses equally."""
        n = len(poses)
        return cls(poses, np.full(n, -np.log(n)), size, random)

    @cached_property
    def weights(self) -> Array:
        """`(n,)`, with sum 1."""
        return np.exp(normalised(self.log_weights))

    def origin(self, dt: float) -> tuple["BodySamples", float]:
        """Return the samples to predict from, and s from them to `dt` s ahead, at most `LONGEST`.

        A prediction is predicted from its own origin, so that the number of steps does not matter.
        """
        return self.before or self, min(self.elapsed + dt, LONGEST)

    @property
    def effective(self) -> float:
        """Effective number of samples, 1 / sum of squared weights."""
        return float(1 / (self.weights**2).sum())

    def resample(self, n: int, random: np.random.Generator) -> BodyPoses:
        """Draw `n` poses of equal weight by systematic resampling."""
        return self.poses.take(systematic(self.log_weights, n, random))

    def reweighed(self, log_factors: Array) -> "BodySamples":
        """Return the samples with weights times factors; the mean factor is the evidence."""
        log_weights = self.log_weights + log_factors
        evidence = log_sum(log_weights)
        if not np.isfinite(evidence):  # no sample fits: the prediction is kept
            log_weights, evidence = self.log_weights, 0.0
        return BodySamples(self.poses, log_weights - evidence, self.size, self.random, log_evidence=evidence)


def initial_samples(
    dynamics: BodyDynamics,
    n: int,
    size: tuple[int, int],
    random: np.random.Generator,
    start: BodyPoses | None = None,
) -> BodySamples:
    """Draw `n` poses at the first frame, about those of `start`, or from the prior in an image of `size`."""
    if start is None:
        poses, ancestors = dynamics.draw_anywhere(n, size, random), None
    else:
        poses = dynamics.draw(start.take(np.arange(n) % len(start)), START_TIME, random)
        ancestors = Ancestors(start, np.full(len(start), 1 / len(start)), START_TIME)
    return replace(BodySamples.even(poses, size, random), ancestors=ancestors, stationary=True)


def predict_samples(dynamics: BodyDynamics, state: BodySamples, n: int, dt: float) -> BodySamples:
    """Draw `n` poses `dt` seconds ahead of `state` (mu_{X(t-1) -> X(t)}).

    Hands may be exchanged before (`with_exchanged`). Poses that joints forbid have no weight, unusual ones
    less. A prediction of a prediction starts from the first one's samples.
    """
    state, dt = state.origin(dt)
    random = copied(state.random)
    ancestors = dynamics.with_exchanged(Ancestors(state.poses, state.weights, dt), random)
    with np.errstate(divide="ignore"):
        chosen = systematic(np.log(ancestors.weights), n, random)
    poses = dynamics.draw(ancestors.poses.take(chosen), dt, random)
    possible = np.where(dynamics.body.allowed(poses), dynamics.log_posture(poses, dt), -np.inf)
    return BodySamples(poses, normalised(possible), state.size, random, ancestors, state, dt)


def stationary_samples(state: BodySamples, log_factors: Array) -> BodySamples:
    """Return the prediction as the posterior of a frame without evidence, weighted by other chains."""
    return replace(state.reweighed(log_factors), log_evidence=0.0, stationary=True)


@short_repr
@dataclass(frozen=True, eq=False)
class BodyMoments:
    """Means and covariances of weighted poses."""

    joints: Array  # `(8, 3)` px, in the order of `JOINTS`
    joint_covariances: Array  # `(8, 3, 3)` px^2
    angles: Array  # `(16,)` px and rad, of `BodyPoses.angles`
    angle_covariances: Array  # `(16, 16)`


@checked
def body_moments(body: UpperBody, samples: BodySamples) -> BodyMoments:
    """Return means and covariances of joints and angles."""
    weights = samples.weights
    mean, covariance = weighted_moments(body.joints(samples.poses), weights)
    angles = samples.poses.angles
    typical = np.einsum("n,na->a", weights, angles)
    away = angles - typical
    return BodyMoments(mean, covariance, typical, np.einsum("n,na,nb->ab", weights, away, away))


def weighted_moments(places: Array, weights: Array) -> tuple[Array, Array]:
    """Return means `(k, d)` and covariances `(k, d, d)` of `places` `(n, k, d)`, weights `(n,)` of sum 1."""
    mean = np.einsum("n,nkx->kx", weights, places)
    apart = places - mean
    return mean, np.einsum("n,nkx,nky->kxy", weights, apart, apart)


def part_message(body: UpperBody, poses: BodyPoses, weights: Array, groups: int) -> PartMessage:
    """Return a mixture of a few Gaussians for each part, which integrates to 1, from weighted poses.

    Along the principal axis of a part's positions the poses are cut into `groups` of equal numbers, each of
    which becomes a Gaussian with its moments, so that the moments of the whole are kept. A broad Gaussian is
    added, for the case that all samples are wrong.
    """
    places = body.parts(poses)
    reach = 0.5 * (body.upper_arm + body.forearm)
    broad = np.square([body.head_height, reach, reach])
    log_weights: list[Array] = []
    means: list[Array] = []
    covariances: list[Array] = []
    for part in range(len(PARTS)):
        masses, centres, within = _grouped(places[:, part], weights, groups)
        log_weights.append(np.append(masses + np.log1p(-MISTAKEN), np.log(MISTAKEN)))
        means.append(np.concatenate([centres, np.einsum("n,nx->x", weights, places[:, part])[None]]))
        covariances.append(np.concatenate([within, broad[part] * np.eye(2)[None]]))
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
    covariances = np.einsum("gn,gnx,gny->gxy", share, steps, steps) + SAMPLE_STD**2 * np.eye(2)
    return np.log(mass[used]), means, covariances


MOST = 4  # hypotheses of a frame
WORTH_SAYING = 0.1  # probability from which a second hypothesis is shown
ENOUGH = 200  # poses that are clustered: a hypothesis of 0.1 has 20 of them

HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses of one frame's pose that differ in where the hands are, the most probable first."""

    weights: Array  # `(4,)` probabilities, 0 where there are fewer; further ones make up the rest to 1
    joints: Array  # `(4, 8, 3)` px: the mean pose of each, NaN where there are fewer
    apart: float  # px: hands that are farther than this from those of the first hypothesis are elsewhere

    @property
    def second(self) -> Array | None:
        """`(8, 3)` px: the second hypothesis; `None` if it is less probable than `WORTH_SAYING`."""
        return self.joints[1] if self.weights[1] >= WORTH_SAYING else None

    @property
    def unsure(self) -> Array:
        """`(2,)`: probability that left and right hand are elsewhere than in the first hypothesis."""
        away = np.linalg.norm(self.joints[:, HANDS, :2] - self.joints[0, HANDS, :2], axis=2)
        return np.asarray(self.weights @ (away > self.apart))


def hypotheses(body: UpperBody, samples: BodySamples, random: np.random.Generator) -> Hypotheses:
    """Cluster poses by single linkage: linked poses differ by a hand's radius at most, in both hands.

    A hand that may be anywhere within a region is one hypothesis; two separate positions are two. More than
    `ENOUGH` samples are resampled.
    """
    poses, weights = samples.poses, samples.weights
    if len(poses) > ENOUGH:
        poses, weights = samples.resample(ENOUGH, random), np.full(ENOUGH, 1 / ENOUGH)
    joints = body.joints(poses)
    hands = joints[:, HANDS, :2]
    steps = np.linalg.norm(hands[:, None] - hands, axis=3).max(axis=2)
    count, group = connected_components(steps <= body.hand, directed=False)
    masses = np.bincount(group, weights, count)
    best = np.argsort(-masses, kind="stable")[:MOST]
    best = best[masses[best] > 0]
    probabilities = np.zeros(MOST)
    probabilities[: len(best)] = masses[best]
    means = np.full((MOST, *joints.shape[1:]), np.nan)
    for place, chosen in enumerate(best):
        share = np.where(group == chosen, weights, 0) / masses[chosen]
        means[place] = np.einsum("n,njx->jx", share, joints)
    return Hypotheses(probabilities, means, body.hand)

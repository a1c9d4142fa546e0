"""Tempering and moving of poses, against plain importance sampling and against what must not change."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body import tempering
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics
from rsmcm.chains.body.tempering import Strata, Tempered, preselect, temper
from rsmcm.inference.smc import normalised
from rsmcm.models.body.upper_body import JOINTS, BodyPoses, UpperBody
from scipy.stats import ks_2samp

Array = NDArray[np.float64]
LogDensity = Callable[[BodyPoses], Array]

BODY = UpperBody.from_head(90.0)
SIZE = (360, 640)
DT = 0.04
HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]
RUNS = 16
SIGMAS = 6.0
"""Standard errors, of `RUNS` runs and of what they are compared with, that a difference may have."""


class Past:
    """A few poses of the frame before, and the prior that the dynamics make of them."""

    def __init__(self, seed: int, jumps: float = 2.0, elapsed: float = 4 * DT) -> None:
        random = np.random.default_rng(seed)
        self.dynamics = BodyDynamics(BODY, jumps=jumps)
        middle = self.dynamics.draw_anywhere(1, SIZE, random)
        self.poses = self.dynamics.draw(middle.take(np.zeros(5, np.int64)), DT, random)
        self.weights = random.dirichlet(np.full(5, 2.0))
        self.elapsed = elapsed

    def drawn(self, n: int, random: np.random.Generator) -> BodyPoses:
        """Poses of the prior: allowed by the joints, unusual postures as seldom as they are."""
        found: list[BodyPoses] = []
        while sum(map(len, found)) < n:
            ancestors = self.poses.take(random.choice(5, n, p=self.weights))
            poses = self.dynamics.draw(ancestors, self.elapsed, random)
            usual = random.random(n) < np.exp(self.dynamics.log_posture(poses, self.elapsed))
            found.append(poses.take(BODY.allowed(poses) & usual))
        return BodyPoses.concatenated(found).take(slice(n))

    def log_density(self, poses: BodyPoses, owners: NDArray[np.int64] | None = None) -> Array:
        """Minus infinity where joints forbid a pose; the same whatever samples it goes back to."""
        density = self.dynamics.log_density(poses, Ancestors(self.poses, self.weights, self.elapsed))
        return np.where(BODY.allowed(poses), density, -np.inf)

    def log_steps(self, chosen: NDArray[np.int64]) -> Callable[[BodyPoses, NDArray[np.int64]], Array]:
        """The prior of a pose whose sample was drawn from one of the poses, by its number in `chosen`."""

        def log_prior(poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
            before = self.poses.take(chosen[owners])
            density = self.dynamics.log_step(poses, before, self.elapsed)
            return np.where(BODY.allowed(poses), density, -np.inf)

        return log_prior


def looks(places: Array, spread: float) -> LogDensity:
    """Log likelihood of both hands seen at `places` `(2, 2)` px, with Gaussian errors."""

    def log_likelihood(poses: BodyPoses) -> Array:
        off = BODY.parts(poses)[:, 1:] - places
        return np.asarray(-0.5 * (off**2).sum(axis=(1, 2)) / spread**2)

    return log_likelihood


def nothing(poses: BodyPoses) -> Array:
    """Log likelihood of an image that says nothing."""
    return np.zeros(len(poses))


def hands(poses: BodyPoses) -> Array:
    """`(n, 6)` px: both hands in space."""
    return BODY.joints(poses)[:, HANDS].reshape(len(poses), 6)


def summary(poses: BodyPoses, weights: Array) -> Array:
    """Means and covariances of the hands, `(27,)`."""
    places = hands(poses)
    mean = weights @ places
    covariance = np.cov(places.T, aweights=weights, ddof=0)
    return np.concatenate([mean, covariance[np.triu_indices(6)]])


def even(n: int) -> Array:
    """Log weights of draws of the prior."""
    return np.full(n, -np.log(n))


@dataclass
class InTwoTerms:
    """A likelihood of two terms, of which the second one takes back a part of the first."""

    likelihood: LogDensity

    def __call__(self, poses: BodyPoses) -> Array:
        return self.likelihood(poses)

    def first(self, poses: BodyPoses) -> Array:
        return 1.5 * self.likelihood(poses)

    def rest(self, poses: BodyPoses) -> Array:
        return -0.5 * self.likelihood(poses)


def tempered(past: Past, likelihood: LogDensity, n: int, seed: int) -> Tempered:
    """Each sample moves under the prior of its own ancestor; together they are of the same mixture."""
    random = np.random.default_rng(seed)
    chosen = random.choice(5, 3 * n, p=past.weights)
    poses = past.dynamics.draw(past.poses.take(chosen), past.elapsed, random)
    possible = BODY.allowed(poses)
    poses, chosen = poses.take(possible), chosen[possible]
    log_weights = normalised(past.dynamics.log_posture(poses, past.elapsed))
    return temper(past.dynamics, poses, log_weights, past.log_steps(chosen), likelihood, n, random)


@pytest.mark.parametrize("staged", [False, True])
def test_posterior_and_evidence_are_those_of_importance_sampling(staged: bool) -> None:
    """Hands' means and covariances over runs, and those of weighted draws of the prior in 20 pieces."""
    past = Past(0, jumps=0.5)
    random = np.random.default_rng(100)
    target = np.median(BODY.parts(past.drawn(1000, random))[:, 1:], axis=0) + 10.0
    likelihood = looks(target, 15.0)

    draws = past.drawn(150_000, random)
    weights = np.exp(likelihood(draws))
    assert weights.sum() ** 2 / (weights**2).sum() > 200
    pieces = np.array_split(np.arange(len(draws)), 20)
    parts = [summary(draws.take(piece), weights[piece] / weights[piece].sum()) for piece in pieces]
    expected = summary(draws, weights / weights.sum())
    error = np.std(parts, axis=0) / np.sqrt(len(parts))

    by_which = InTwoTerms(likelihood) if staged else likelihood
    runs = [tempered(past, by_which, 1000, number) for number in range(RUNS)]
    means = np.stack([summary(one.poses, np.exp(one.log_weights)) for one in runs])
    bar = SIGMAS * np.hypot(means.std(axis=0, ddof=1) / np.sqrt(RUNS), error)
    std = np.sqrt(expected[6:][np.cumsum([0, 6, 5, 4, 3, 2])])
    assert (np.abs(means.mean(axis=0) - expected) < bar + 0.02 * np.abs(expected).max()).all()
    assert np.median(bar[:6] / std) < 0.5, "so that the bars mean something"

    evidence = np.log(weights.mean())
    relative = weights.std() / weights.mean() / np.sqrt(len(weights))
    own = np.array([one.log_evidence for one in runs])
    assert abs(own.mean() - evidence) < SIGMAS * np.hypot(own.std(ddof=1) / np.sqrt(RUNS), relative) + 0.02


def test_moves_leave_the_prior_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """After 40 of them independent draws of the prior are still such draws: Kolmogorov and Smirnov.

    In one stratum each is drawn once, since all weigh the same; hence they stay independent.
    """
    monkeypatch.setattr(tempering, "MOVES", 40)
    monkeypatch.setattr(Strata, "of", lambda body, poses: Strata(np.zeros(len(poses), np.int64)))
    past, random = Past(0), np.random.default_rng(0)
    poses, others = (past.drawn(2000, random) for _ in range(2))
    found = temper(past.dynamics, poses, even(2000), past.log_density, nothing, 2000, random)
    np.testing.assert_allclose(found.log_weights, even(2000))
    stayed = np.isin(found.poses.arms[:, 0, 0, 0], poses.arms[:, 0, 0, 0])
    assert stayed.mean() < 0.3

    def features(some: BodyPoses) -> Array:
        flexions = (some.arms[:, :, 0] * some.arms[:, :, 1]).sum(axis=2)
        joints = BODY.joints(some).reshape(len(some), -1)
        return np.concatenate([joints, some.turns, flexions], axis=1)

    after, fresh = features(found.poses), features(others)
    varies = fresh.std(axis=0) > 0
    values = [ks_2samp(after[:, one], fresh[:, one]).pvalue for one in np.flatnonzero(varies)]
    assert min(values) > 1e-5 / len(values)


# --- what is worth a second look ---


def scene_of_hands(seed: int) -> tuple[BodyPoses, Array]:
    """Weighted poses of a prior of several modes, unevenly."""
    past = Past(seed, elapsed=10 * DT)
    random = np.random.default_rng(seed)
    poses = past.drawn(3000, random)
    return poses, normalised(random.normal(0, 1, 3000))


@pytest.mark.parametrize("kind", ["nothing", "right", "wrong"])
def test_sums_over_preselected_poses_have_the_same_expectation(kind: str) -> None:
    """Whatever the first look says: mass, means and evidence over many draws, five standard errors."""
    poses, log_weights = scene_of_hands(11)
    places = np.median(BODY.parts(poses)[:, 1:], axis=0)
    log_likelihood = looks(places, 200.0)(poses)  # no stratum is so improbable that it is forgotten
    first_look = {"nothing": nothing(poses), "right": log_likelihood, "wrong": -0.05 * log_likelihood}[kind]
    values = np.column_stack([np.ones(3000), hands(poses), np.exp(log_likelihood)])
    found = []
    for run in range(60):
        chosen, after = preselect(BODY, poses, log_weights, first_look, 500, np.random.default_rng(run))
        assert chosen.shape == after.shape == (500,)
        found.append(np.exp(after) @ values[chosen])
    bar = SIGMAS * np.std(found, axis=0, ddof=1) / np.sqrt(60)
    expected = np.exp(log_weights) @ values
    assert (np.abs(np.mean(found, axis=0) - expected) < bar + 1e-9).all()
    assert bar[-1] < expected[-1]


@dataclass(frozen=True)
class InStages:
    """A likelihood of which one hand is looked at first."""

    target: Array

    def __call__(self, poses: BodyPoses) -> Array:
        return self.first(poses) + self.rest(poses)

    def first(self, poses: BodyPoses) -> Array:
        off = BODY.parts(poses)[:, 1] - self.target[0]
        return np.asarray(-0.5 * (off**2).sum(axis=1) / 20.0**2)

    def rest(self, poses: BodyPoses) -> Array:
        return looks(self.target, 15.0)(poses) - self.first(poses)


def test_evidence_and_posterior_of_a_likelihood_in_stages() -> None:
    """They are those of the whole, though the second term is not computed for all candidates."""
    past = Past(13, jumps=0.5)
    random = np.random.default_rng(13)
    target = np.median(BODY.parts(past.drawn(1000, random))[:, 1:], axis=0) + 10.0
    likelihood = looks(target, 15.0)
    draws = past.drawn(150_000, random)
    weights = np.exp(likelihood(draws))
    evidence, shares = np.log(weights.mean()), weights / weights.sum()
    expected = shares @ hands(draws)
    error = np.sqrt(shares**2 @ (hands(draws) - expected) ** 2)
    relative = weights.std() / weights.mean() / np.sqrt(len(weights))

    found = []
    for run in range(RUNS):
        random = np.random.default_rng(run)
        poses = past.drawn(4000, random)
        after = temper(
            past.dynamics, poses, even(4000), past.log_density, InStages(target), 700, random, 1400
        )
        found.append([after.log_evidence, *(np.exp(after.log_weights) @ hands(after.poses))])
    bar = SIGMAS * np.hypot(np.std(found, axis=0, ddof=1) / np.sqrt(RUNS), [relative, *error]) + 0.02
    assert np.median(bar[[0, 1, 2, 4, 5]]) < 4.0, "nats, and px in the image; depth is less certain"
    # the log of a mean is biased by half its variance
    assert (np.abs(np.mean(found, axis=0) - [evidence, *expected]) < bar + 0.05).all()

"""Candidates with their weights are samples of the prediction, whether they go on or begin anew."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics, draw_usual_arms
from rsmcm.chains.body.proposals import RESTARTED, Candidates
from rsmcm.models.body.upper_body import BodyPoses, UpperBody
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures

BODY = UpperBody.from_head(90.0)
SIZE = (360, 640)
DT = 0.04
RUNS = 24


def past_of(seed: int) -> Ancestors:
    random = np.random.default_rng(seed)
    dynamics = BodyDynamics(BODY)
    middle = replace(dynamics.draw_anywhere(1, SIZE, random), roots=np.array([[320.0, 150.0]]))
    poses = dynamics.draw(middle.take(np.zeros(20, np.int64)), DT, random)
    return Ancestors(poses, random.dirichlet(np.ones(20)), DT)


def broad(poses: BodyPoses, weight: float) -> GaussianMixtures:
    """One Gaussian a part about where they are in `poses`, each of that mass."""
    places = BODY.parts(poses)
    means = [places[:, part].mean(axis=0)[None] for part in range(3)]
    covariances = [(np.cov(places[:, part].T) + 40.0**2 * np.eye(2))[None] for part in range(3)]
    return GaussianMixtures.of_parts([[np.log(weight)]] * 3, means, covariances)


def anywhere(n: int, random: np.random.Generator) -> tuple[BodyPoses, float]:
    """Draws of `draw_anywhere`, and the mean of the factor by which unusual ones count less."""
    dynamics = BodyDynamics(BODY)
    poses = dynamics.draw_anywhere(n, SIZE, random)
    return poses, float(np.exp(dynamics.log_posture(poses)).mean())


@pytest.mark.parametrize(("weight", "bare"), [(1.0, 0.0), (50.0, 0.0), (1.0, 1.0)])
def test_the_mass_of_what_begins_anew_is_that_of_the_prior(weight: float, bare: float) -> None:
    """Sums of weights, by whatever mixtures: the chance that the joints allow a draw times its posture's."""
    dynamics, random = BodyDynamics(BODY), np.random.default_rng(1)
    poses, usual = anywhere(20_000, random)
    turns = dynamics.turn_stds * random.standard_normal((20_000, 6))
    every = BodyPoses(
        poses.roots, turns[:, :3], turns[:, 3:], draw_usual_arms(np.tile([0, 1], (20_000, 1)), random)
    )
    expected = usual * BODY.allowed(every).mean()
    found = []
    for run in range(RUNS):
        one = Candidates.of_first_frame(
            dynamics, SIZE, broad(poses, weight), 20_000, np.random.default_rng(run), rounds=1, bare=bare
        )
        inside = ((one.poses.roots >= 0) & (one.poses.roots <= SIZE[::-1])).all(axis=1)
        found.append(np.exp(one.log_weights)[inside].sum())
        assert one.restarted.all()
    error = np.std(found, ddof=1) / np.sqrt(RUNS)
    assert abs(np.mean(found) - expected) < 5 * np.hypot(error, 0.5 / np.sqrt(20_000))
    assert 5 * error < 0.5 * expected


def test_most_go_on_and_some_begin_anew() -> None:
    past, dynamics = past_of(2), BodyDynamics(BODY, returns=0.5)
    nothing = [(GaussianMixtures.uniform(3), 1.0)]
    poses, _ = anywhere(3000, np.random.default_rng(2))
    found = Candidates.of_next_frame(
        dynamics, SIZE, past, nothing, broad(poses, 1.0), 8000, np.random.default_rng(3)
    )
    n = len(found.poses)
    assert len(found.log_weights) == len(found.ancestors) == len(found.restarted) == n
    assert 0 < np.count_nonzero(found.restarted) <= RESTARTED * 8000
    weights = np.exp(found.log_weights)
    assert weights[~found.restarted].sum() == pytest.approx(np.exp(-0.5 * DT))
    assert weights[found.restarted].sum() < 1 - np.exp(-0.5 * DT)
    np.testing.assert_array_equal(found.ancestors.roots[found.restarted], found.poses.roots[found.restarted])
    assert np.isin(found.ancestors.roots[~found.restarted, 0], past.poses.roots[:, 0]).all()
    even = found.weighted(np.zeros(n))
    assert np.exp(even.log_weights).sum() == pytest.approx(1.0)


def test_priors_are_those_of_what_a_pose_goes_back_to() -> None:
    """A step from the ancestor, or anywhere; minus infinity where the joints forbid it."""
    past, dynamics = past_of(5), BodyDynamics(BODY)
    poses, _ = anywhere(3000, np.random.default_rng(2))
    nothing = [(GaussianMixtures.uniform(3), 1.0)]
    found = Candidates.of_next_frame(
        dynamics, SIZE, past, nothing, broad(poses, 1.0), 6000, np.random.default_rng(6)
    )
    rows = np.random.default_rng(7).integers(len(found.poses), size=300)
    begun = np.flatnonzero(found.restarted)[:50]
    rows[: len(begun)] = begun
    moved = dynamics.draw(found.poses.take(rows), DT, np.random.default_rng(8))
    steps = dynamics.log_step(moved, found.ancestors.take(rows), DT)
    expected = np.where(found.restarted[rows], dynamics.log_density_anywhere(moved, SIZE), steps)
    expected = np.where(BODY.allowed(moved), expected, -np.inf)
    np.testing.assert_allclose(found.log_prior(moved, rows), expected)
    assert found.restarted[rows].any()
    assert np.isneginf(expected).any()

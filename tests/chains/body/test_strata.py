"""Strata of poses: weights stay what they are, and what is improbable goes on."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.tempering import EVENLY, LEAST_MASS, MOST_STRATA, Strata
from rsmcm.inference.smc import normalised
from rsmcm.models.body.upper_body import BodyPoses, UpperBody
from scipy.special import logsumexp

BODY = UpperBody.from_head(90.0)


def one_pose() -> BodyPoses:
    return BodyDynamics(BODY).draw_anywhere(1, (360, 640), np.random.default_rng(0))


def groups(
    sizes: list[int], apart: float = 200.0, spread: float = 3.0
) -> tuple[BodyPoses, NDArray[np.int64]]:
    """The same posture at as many places, `apart` px; whose place each one is."""
    random = np.random.default_rng(1)
    owners = np.repeat(np.arange(len(sizes)), sizes)
    poses = one_pose().take(np.zeros(len(owners), np.int64))
    roots = poses.roots + random.normal(0, spread, (len(owners), 2))
    roots[:, 0] += apart * owners
    order = random.permutation(len(owners))
    return replace(poses, roots=roots).take(order), owners[order]


def test_poses_with_hands_elsewhere_are_another_stratum() -> None:
    poses, owners = groups([300, 40, 5])
    numbers = Strata.of(BODY, poses).numbers
    assert len(set(zip(owners, numbers, strict=True))) == 3
    assert sorted(np.unique(numbers)) == [0, 1, 2]


def test_strata_are_no_more_than_the_constant_says_and_narrow_unless_they_are_all_used() -> None:
    poses = BodyDynamics(BODY).draw_anywhere(2000, (360, 640), np.random.default_rng(2))
    numbers = Strata.of(BODY, poses).numbers
    np.testing.assert_array_equal(np.unique(numbers), np.arange(MOST_STRATA))
    points = BODY.parts(poses)[:, 1:].reshape(-1, 4)
    within = sum(
        np.sum((points[numbers == one] - points[numbers == one].mean(axis=0)) ** 2) for one in range(12)
    )
    assert within < 0.5 * np.sum((points - points.mean(axis=0)) ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_balanced_draws_with_their_weights_have_the_same_expectation(seed: int) -> None:
    """Many draws by q, each with w / q, beside the weighted samples; five standard errors."""
    random = np.random.default_rng(seed)
    poses, owners = groups([300, 200, 50])
    values = np.column_stack([poses.roots, owners == 2, np.ones(len(owners))])
    log_weights = normalised(random.normal(0, 2, len(owners)) - 3.0 * owners)
    choice = Strata.of(BODY, poses).balanced(log_weights)
    assert logsumexp(choice) == pytest.approx(0.0, abs=1e-9)
    drawn = random.choice(len(owners), 50_000, p=np.exp(choice))
    factors = np.exp(log_weights - choice)[drawn]
    found = factors[:, None] * values[drawn]
    bar = 5 * found.std(axis=0) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - np.exp(log_weights) @ values) < bar + 1e-9).all()


def test_shares_are_half_by_weight_and_half_even() -> None:
    poses, owners = groups([100, 100, 100], spread=0.0)
    log_weights = normalised(np.log([0.7, 0.2, 0.1])[owners])
    choice = np.exp(Strata.of(BODY, poses).balanced(log_weights))
    shares = np.bincount(owners, choice)
    np.testing.assert_allclose(shares, (1 - EVENLY) * np.array([0.7, 0.2, 0.1]) + EVENLY / 3)
    # within a stratum they go by weight
    inside = choice[owners == 0]
    np.testing.assert_allclose(inside, inside[0])


def test_what_has_next_to_no_weight_is_forgotten() -> None:
    poses, owners = groups([100, 100])
    log_weights = normalised(np.where(owners == 1, np.log(0.1 * LEAST_MASS), 0.0))
    choice = Strata.of(BODY, poses).balanced(log_weights)
    assert np.isneginf(choice[owners == 1]).all()
    np.testing.assert_allclose(np.exp(choice[owners == 0]).sum(), 1.0)

"""Walk and range of poses against finite differences and scipy's densities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.inference.face.pose_dynamics import PoseDynamics, PosePrior
from scipy.stats import multivariate_normal, norm

from ...support.surfaces import poses_near

SIZE = 24.0


def prior_of(seed: int, elapsed: float = 0.04, n: int = 3, n_bases: int = 3) -> PosePrior:
    return PosePrior.after(poses_near(n, n_bases, seed), PoseDynamics(), SIZE, elapsed)


def test_a_walk_spreads_with_the_root_of_time_and_with_size() -> None:
    dynamics = PoseDynamics()
    walk = dynamics.walk(SIZE, 8, 0.04)
    np.testing.assert_allclose(dynamics.walk(SIZE, 8, 0.16), 4 * walk)
    larger = dynamics.walk(2 * SIZE, 8, 0.04)
    np.testing.assert_allclose(larger[:3], walk[:3])
    np.testing.assert_allclose(larger[3:], 4 * walk[3:])
    one_second = np.sqrt(dynamics.walk(1.0, 8, 1.0))
    np.testing.assert_allclose(
        one_second,
        [*[dynamics.rotation] * 3, *[dynamics.translation] * 2, dynamics.size, *[dynamics.morphs] * 2],
    )
    assert (dynamics.walk(SIZE, 8, 0.0) > 0).all()


@given(st.integers(0, 10**6))
def test_gradient_and_precision_are_derivatives_of_the_energy(seed: int) -> None:
    prior, owner = prior_of(seed), np.array([2, 0, 1, 1])
    random = np.random.default_rng(seed)
    # a turn only about one axis: there the tangent spaces of both poses are one
    change = np.sqrt(prior.walk) * random.normal(size=(4, 8)) * np.array([0, 1, 0, 1, 1, 1, 1, 1])
    poses = prior.previous[owner].moved(change)
    step = 1e-4 * np.sqrt(prior.walk)
    middle, gradient = prior.energy(poses, owner)
    for j in (1, 3, 4, 5, 6, 7):
        ends = [
            prior.energy(poses.moved(np.tile(sign * step[j] * np.eye(8)[j], (4, 1))), owner)[0]
            for sign in (-1, 1)
        ]
        slope, bend = (ends[1] - ends[0]) / (2 * step[j]), (ends[1] + ends[0] - 2 * middle) / step[j] ** 2
        np.testing.assert_allclose(gradient[:, j], slope, rtol=1e-5, atol=1e-6 / step[j])
        np.testing.assert_allclose(bend, prior.precision[j], rtol=1e-2)


@given(st.integers(0, 10**6))
def test_density_is_that_of_the_walk_times_the_range(seed: int) -> None:
    prior, owner = prior_of(seed), np.array([1, 2])
    change = np.sqrt(prior.walk) * np.random.default_rng(seed).normal(size=(2, 8))
    poses = prior.previous[owner].moved(change)
    walk = multivariate_normal(np.zeros(8), np.diag(prior.walk)).logpdf(change)
    size, others = norm(SIZE, PoseDynamics().size_range * SIZE), norm(0, PoseDynamics().morph_range * SIZE)
    reach = size.logpdf(poses.sizes) - size.logpdf(SIZE)
    reach = reach + (others.logpdf(poses.morphs[:, 1:]) - others.logpdf(0)).sum(axis=1)
    np.testing.assert_allclose(prior.log_density(poses, owner), walk + reach, rtol=1e-9, atol=1e-9)


def test_staying_is_the_likeliest() -> None:
    prior = prior_of(0)
    every = np.arange(3)
    energy, _ = prior.energy(prior.previous, every)
    off = prior.previous.morphs - prior.middle
    assert energy == pytest.approx(0.5 * (off**2 / prior.spread).sum(axis=1))

"""Transitions of poses against finite differences and scipy's densities."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.chains.face.pose_terms import PoseDynamics, PosePrior
from rsmcm.models.face.morphable_model import RIGID

from ...support.surfaces import poses_near

SIZE = 24.0


def prior_of(seed: int, elapsed: float = 0.04, n: int = 3, n_bases: int = 3) -> PosePrior:
    return PosePrior.after(poses_near(n, n_bases, seed), PoseDynamics(), SIZE, elapsed)


def test_a_walk_spreads_with_the_root_of_time_and_with_size() -> None:
    dynamics = PoseDynamics(size_range=1e4, morph_range=1e4)
    memory, walk = dynamics.transition(SIZE, 8, 0.04)
    np.testing.assert_allclose(memory, 1, atol=1e-6)
    np.testing.assert_allclose(dynamics.transition(SIZE, 8, 0.16)[1], 4 * walk, rtol=1e-6)
    larger = dynamics.transition(2 * SIZE, 8, 0.04)[1]
    np.testing.assert_allclose(larger[:3], walk[:3])
    np.testing.assert_allclose(larger[3:], 4 * walk[3:], rtol=1e-6)
    one_second = np.sqrt(dynamics.transition(1.0, 8, 1.0)[1])
    expected = [*[dynamics.rotation] * 3, *[dynamics.translation] * 2, dynamics.size, *[dynamics.morphs] * 2]
    np.testing.assert_allclose(one_second, expected, rtol=1e-6)
    assert (dynamics.transition(SIZE, 8, 0.0)[1] > 0).all()


@given(st.floats(1e-3, 20), st.floats(1e-3, 20))
def test_two_steps_are_one(first: float, second: float) -> None:
    dynamics, start = PoseDynamics(), poses_near(3, 3, 1)
    halfway = PosePrior.after(start, dynamics, SIZE, first)
    whole = PosePrior.after(start, dynamics, SIZE, first + second)
    memory, variance = dynamics.transition(SIZE, start.dimension, second)
    on = PosePrior.after(halfway.mean, dynamics, SIZE, second)
    np.testing.assert_allclose(on.mean.morphs, whole.mean.morphs, rtol=1e-9, atol=1e-9)
    kept = np.concatenate([np.ones(RIGID), memory])
    np.testing.assert_allclose(kept**2 * halfway.variance + variance, whole.variance, rtol=1e-9)


def test_in_the_long_run_shapes_are_as_usual() -> None:
    prior = prior_of(0, elapsed=1e4)
    usual, spread = prior.mean.morphs, np.sqrt(prior.variance[RIGID:])
    np.testing.assert_allclose(usual, np.tile([SIZE, 0, 0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(spread, SIZE * np.array([0.11, 0.8, 0.8]))


@given(st.integers(0, 10**6))
def test_gradient_and_precision_are_derivatives_of_the_energy(seed: int) -> None:
    prior, owner = prior_of(seed), np.array([2, 0, 1, 1])
    random = np.random.default_rng(seed)
    # a turn only about one axis: there the tangent spaces of both poses are one
    change = np.sqrt(prior.variance) * random.normal(size=(4, 8)) * np.array([0, 1, 0, 1, 1, 1, 1, 1])
    poses = prior.mean[owner].moved(change)
    step = 1e-4 * np.sqrt(prior.variance)
    middle, gradient = prior.energy(poses, owner)
    for j in (1, 3, 4, 5, 6, 7):
        ends = [
            prior.energy(poses.moved(np.tile(sign * step[j] * np.eye(8)[j], (4, 1))), owner)[0]
            for sign in (-1, 1)
        ]
        slope, bend = (ends[1] - ends[0]) / (2 * step[j]), (ends[1] + ends[0] - 2 * middle) / step[j] ** 2
        np.testing.assert_allclose(gradient[:, j], slope, rtol=1e-5, atol=1e-6 / step[j])
        np.testing.assert_allclose(bend, prior.precision[j], rtol=1e-2)

"""Motions against filterpy, against van Loan's integral, and two steps against one."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, kinematic_state_transition, van_loan_discretization
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.inference.kalman import LinearMotion, kinematic, ornstein_uhlenbeck_velocity

SECONDS = st.floats(0, 10) | st.floats(0, 1e-3)


@pytest.mark.parametrize("dt", [0.0, 0.04, 1.7])
@pytest.mark.parametrize("order", [2, 3])
def test_kinematic_is_filterpys(order: int, dt: float) -> None:
    motion = kinematic(order, dt)
    np.testing.assert_allclose(motion.transition, kinematic_state_transition(order - 1, dt), rtol=1e-14)
    np.testing.assert_allclose(motion.noise, Q_continuous_white_noise(order, dt), rtol=1e-14)
    axes = motion.along(2)
    ordered = Q_continuous_white_noise(order, dt, block_size=2, order_by_dim=False)
    np.testing.assert_allclose(axes.noise, ordered, rtol=1e-14)


def test_random_walk() -> None:
    assert kinematic(1, 0.3) == (np.array([[1.0]]), np.array([[0.3]]))


@pytest.mark.parametrize("dt", [1e-3, 0.009, 0.02, 0.5, 3.0])
def test_ornstein_uhlenbeck_is_van_loans_integral(dt: float) -> None:
    time_constant = 0.7
    drift = np.array([[0.0, 1.0], [0.0, -1 / time_constant]])
    push = np.array([[0.0], [np.sqrt(2 / time_constant)]])
    transition, noise = van_loan_discretization(drift, push, dt)
    motion = ornstein_uhlenbeck_velocity(dt, time_constant)
    np.testing.assert_allclose(motion.transition, transition, rtol=1e-12, atol=1e-15)
    # what van Loan's matrix exponential loses is relative to its largest numbers
    np.testing.assert_allclose(motion.noise, noise, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize(
    "motion",
    [
        lambda dt: kinematic(2, dt),
        lambda dt: kinematic(3, dt),
        lambda dt: ornstein_uhlenbeck_velocity(dt, 0.5),
    ],
)
@given(first=SECONDS, second=SECONDS)
def test_two_steps_make_one(motion, first: float, second: float) -> None:  # type: ignore[no-untyped-def]
    once: LinearMotion = motion(first + second)
    mean, covariance = np.arange(1.0, 1 + len(once.noise)), np.eye(len(once.noise))
    at_once = once.moved(mean, covariance, 3.0)
    twice = motion(second).moved(*motion(first).moved(mean, covariance, 3.0), 3.0)
    for one, two in zip(at_once, twice, strict=True):
        # numbers next to the smallest have few digits
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-300)


def test_many_states_with_their_own_densities() -> None:
    motion = kinematic(2, 0.1)
    means, covariances = np.arange(6.0).reshape(3, 2), np.tile(np.eye(2), (3, 1, 1))
    moved = motion.moved(means, covariances, np.array([1.0, 2.0, 3.0]))
    for k in range(3):
        alone = motion.moved(means[k], covariances[k], 1.0 + k)
        np.testing.assert_array_equal(moved[0][k], alone[0])
        np.testing.assert_array_equal(moved[1][k], alone[1])


def test_time_does_not_run_back() -> None:
    with pytest.raises(ValueError, match="expected 0 or more"):
        kinematic(2, -0.1)
    with pytest.raises(ValueError, match="expected 0 or more"):
        ornstein_uhlenbeck_velocity(-0.1, 1.0)

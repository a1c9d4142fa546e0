"""Weights in log space against scipy, and systematic resampling by counted frequencies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.inference.smc import log_sum, normalised, systematic
from scipy.special import logsumexp

FAR = -1e6
"""Nats: what thousands of pixels may say against a pose."""


@given(st.integers(0, 10**6), st.floats(-1e6, 1e6), st.floats(0.01, 1e4))
def test_sums_equal_those_of_scipy(seed: int, middle: float, spread: float) -> None:
    values = middle + spread * np.random.default_rng(seed).normal(size=(4, 6))
    assert log_sum(values) == pytest.approx(logsumexp(values), rel=1e-12)
    np.testing.assert_allclose(normalised(values), values - logsumexp(values), rtol=1e-9, atol=1e-9)


def test_weights_of_nothing() -> None:
    nothing = np.full(4, -np.inf)
    assert log_sum(nothing) == -np.inf
    np.testing.assert_allclose(normalised(nothing), np.log(0.25))
    one = np.array([-np.inf, FAR, -np.inf])
    np.testing.assert_array_equal(np.exp(normalised(one)), [0, 1, 0])
    assert systematic(one, 5, np.random.default_rng(0)).tolist() == [1] * 5


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 40))
def test_each_sample_is_drawn_as_often_as_its_weight_says_within_one(seed: int, m: int, n: int) -> None:
    random = np.random.default_rng(seed)
    weights = random.dirichlet(np.full(m, 0.5))
    drawn = systematic(FAR + np.log(weights + 1e-300), n, random)
    assert drawn.shape == (n,)
    assert (np.abs(np.bincount(drawn, minlength=m) - n * weights) < 1 + 1e-9).all()


def test_frequencies_are_the_weights() -> None:
    random = np.random.default_rng(3)
    weights = random.dirichlet(np.ones(6))
    repeats, n = 4000, 5
    counts = sum(np.bincount(systematic(np.log(weights), n, random), minlength=6) for _ in range(repeats))
    # a count of one draw is off by less than one, so its variance is at most 1/4
    bar = 5 * 0.5 / np.sqrt(repeats)
    np.testing.assert_allclose(counts / repeats, n * weights, atol=bar)


def test_of_no_samples_there_is_no_weight() -> None:
    assert log_sum(np.zeros(0)) == -np.inf
    assert normalised(np.zeros(0)).shape == (0,)

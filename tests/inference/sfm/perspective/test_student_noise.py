"""Student's noise against scipy's density, Monte Carlo, and errors that are drawn."""

import numpy as np
import pytest
from rsmcm.inference.sfm.perspective.bundle_adjustment import HARDLY, StudentNoise
from scipy.stats import multivariate_t


@pytest.mark.parametrize("freedom", [3.5, 20.0])
def test_log_likelihood_is_that_of_scipy(freedom: float) -> None:
    errors = np.random.default_rng(0).normal(size=(30, 2)) * 2
    weight = np.random.default_rng(1).uniform(0.5, 2, 30)
    wanted = sum(
        multivariate_t(shape=1.7 / g * np.eye(2), df=freedom).logpdf(error)
        for error, g in zip(errors, weight, strict=True)
    )
    noise = StudentNoise(1.7, freedom)
    assert noise.log_likelihood(np.sum(errors**2, axis=1), weight) == pytest.approx(wanted)


@pytest.mark.parametrize("freedom", [4.0, 8.0])
def test_finds_the_noise_that_errors_were_drawn_from(freedom: float) -> None:
    errors = multivariate_t(shape=0.09 * np.eye(2), df=freedom).rvs(20_000, random_state=0)
    found = StudentNoise.of_errors(np.sum(errors**2, axis=1), np.ones(len(errors)))
    assert found.variance == pytest.approx(0.09, rel=0.04)
    assert found.freedom == pytest.approx(freedom, rel=0.15)


@pytest.mark.parametrize("freedom", [4.0, 50.0])
def test_precision_is_that_of_the_likeliest_place(freedom: float) -> None:
    """Variance of M-estimates of a place from 40 errors each, over 400 samples."""
    n, draws = 40, 400
    errors = multivariate_t(shape=np.eye(2), df=freedom).rvs((draws, n), random_state=1)
    noise = StudentNoise(1.0, freedom)
    places = np.zeros((draws, 1, 2))
    for _ in range(60):
        squares = np.sum((errors - places) ** 2, axis=2)
        weights = noise.weights(squares, np.ones_like(squares))[..., None]
        places = np.sum(weights * errors, axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
    wanted = float(np.mean(places**2))
    squares = np.sum(errors.reshape(-1, 2) ** 2, axis=1)
    found = 1 / (n * noise.precision(squares, np.ones(len(squares)), 0))
    assert found == pytest.approx(wanted, rel=4 * np.sqrt(1 / draws))  # a variance of 800 normal numbers


def test_outliers_hardly_count() -> None:
    noise = StudentNoise(0.5, 3.0)
    squares, ones = np.array([0.0, 5.0, 13.0, 14.0, 900.0]), np.ones(5)
    share = noise.weights(squares, ones) / noise.weights(np.zeros(5), ones)
    np.testing.assert_array_equal(noise.agrees(squares, ones), share >= HARDLY)
    assert noise.agrees(squares, ones).tolist() == [True, True, True, False, False]


def test_a_few_outliers_leave_the_variance_as_it_is() -> None:
    rng = np.random.default_rng(3)
    errors = rng.normal(0, 0.3, (4000, 2))
    errors[:200] += rng.uniform(-40, 40, (200, 2))
    found = StudentNoise.of_errors(np.sum(errors**2, axis=1), np.ones(4000))
    assert 0.5 * 0.09 < found.variance < 1.2 * 0.09

"""Powers, straight lines, tables and a picture of made-up curves; observations made as lists."""

import math

import numpy as np
import pytest
from rsmcm.apps.experiments.bench.curves import (
    PIECE,
    PIECES,
    Curve,
    broken_tracks,
)

SIZES = (10.0, 100.0, 1000.0, 10_000.0)


def curve(seconds: list[float], name: str = "made up") -> Curve:
    return Curve(name, "things", list(zip(SIZES, seconds, strict=True)))


def test_a_power_is_found_and_its_error_is_that_of_a_regression() -> None:
    power, error = curve([3e-6 * size**1.5 for size in SIZES]).power
    assert power == pytest.approx(1.5)
    assert error == pytest.approx(0.0, abs=1e-9)
    noisy = [1e-3 * size * factor for size, factor in zip(SIZES, (1.1, 0.8, 1.3, 0.9), strict=True)]
    power, error = curve(noisy).power
    coefficients, covariance = np.polyfit(np.log(SIZES), np.log(noisy), 1, cov="unscaled")
    left = np.log(noisy) - np.polyval(coefficients, np.log(SIZES))
    assert power == pytest.approx(coefficients[0])
    assert error == pytest.approx(math.sqrt(covariance[0, 0] * (left @ left) / 2))
    expectation = curve(noisy).expectation(1.1)
    assert (expectation.measured, expectation.standard_error, expectation.ratio) == (power, error, True)


def test_broken_tracks_are_pieces_of_points() -> None:
    positions = broken_tracks(80)
    seen = ~np.isnan(positions).any(axis=2)
    assert positions.shape == (PIECES * PIECE, 80, 2)
    assert (seen.sum(axis=0) >= 1).all()
    assert (seen.sum(axis=0) < PIECE).all()
    of_point = seen.reshape(len(seen), PIECES, 20)
    assert (of_point.sum(axis=1) <= 1).all()  # one track of a point at a time
    assert (np.abs(np.diff(seen.astype(int), axis=0)).sum(axis=0) <= 2).all()  # in one stretch

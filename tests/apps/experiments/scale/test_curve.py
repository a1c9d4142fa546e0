"""Powers, straight lines and tables of made-up curves."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.experiments.expectations import Expectation
from rsmcm.apps.experiments.record import Record, Stopwatch, Table
from rsmcm.apps.experiments.scale.curve import Curve, Measured, of_record, tables

SIZES = (10.0, 100.0, 1000.0, 10_000.0)


def curve(seconds: list[float], name: str = "made up") -> Curve:
    points = [
        Measured(size, second, (0.9 * second, 1.2 * second), 0.5 * second, 100.0 + 8 * size)
        for size, second in zip(SIZES, seconds, strict=True)
    ]
    return Curve(name, "things", points)


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
    assert (expectation.measured, expectation.spread, expectation.ratio) == (power, error, True)


def test_fixed_costs_and_those_of_each() -> None:
    assert curve([2e-3 + 5e-6 * size for size in SIZES]).fixed_and_each == pytest.approx((2e-3, 5e-6))
    fixed, each = curve([1e-6 * size**1.2 for size in SIZES]).fixed_and_each
    assert fixed == 0.0
    assert 1e-6 < each < 1e-6 * 10_000**0.2
    assert curve([1.0] * 4).bytes_each == pytest.approx(8.0)


def test_costs_between_and_beyond_what_was_measured() -> None:
    found = curve([1e-3 * size for size in SIZES])
    assert found.at(100) == pytest.approx(0.1)
    assert found.at(300) == pytest.approx(0.3)
    assert found.at(1e6) == pytest.approx(1e3)
    assert curve([1e-3] * 4).at(1e5) == pytest.approx(1e-2)  # no less than in proportion


def test_rounds_become_quartiles() -> None:
    found = Measured.of(7, [1.0, 2.0, 3.0, 4.0, 100.0], 0.5)
    assert (found.seconds, found.quartiles) == (3.0, (2.0, 4.0))
    assert math.isnan(found.memory)


def test_curves_are_read_back_from_their_record(tmp_path: Path) -> None:
    one, other = curve([1e-3 * size for size in SIZES]), curve([1e-3] * 4, "another")
    other = replace(other, points=[replace(each, limit=math.nan, memory=math.nan) for each in other.points])
    made = tables([one, other])
    record = Record("curves", "Curves", "make bench", Stopwatch().provenance(), [], made)
    record.write(tmp_path / "curves.json")
    back = of_record(Record.read(tmp_path / "curves.json"))
    assert list(back) == [("made up", "things"), ("another", "things")]
    for ours, theirs in zip(one.points, back["made up", "things"].points, strict=True):
        assert theirs.size == ours.size
        assert (theirs.seconds, theirs.limit, theirs.memory) == pytest.approx(
            (ours.seconds, ours.limit, ours.memory)
        )
        assert theirs.quartiles == pytest.approx(ours.quartiles)
    assert math.isnan(back["another", "things"].points[0].limit)
    with pytest.raises(ValueError, match="curves: got a record without curves"):
        of_record(replace(record, expectations=[Expectation("x", 1.0)], tables=[Table(("x",), [])]))

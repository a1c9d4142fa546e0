"""Standard errors over seeds."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from rsmcm.apps.experiments.record import Expectation, over_seeds

Found = Mapping[str, Sequence[float]]


def test_the_error_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(1).normal(10.0, 2.0, 400).tolist()
    (found,) = over_seeds(lambda found: [Expectation("mean", float(np.mean(found["a"])))], {"a": values})
    assert found.measured == pytest.approx(np.mean(values))
    assert found.standard_error == pytest.approx(np.std(values) / math.sqrt(len(values)), rel=0.2)
    assert found.seeds == 400


def test_all_methods_get_the_same_seeds() -> None:
    """A ratio of two methods of which one has twice the error on every seed is sure."""
    values = [1.0, 5.0, 2.0, 9.0]

    def judge(found: Mapping[str, Found]) -> list[Expectation]:
        scene = found["scene"]
        return [
            Expectation("ratio", float(np.mean(scene["b"]) / np.mean(scene["a"]))),
            Expectation("mean", float(np.mean(scene["b"]))),
            Expectation("once", scene["once"][0]),
        ]

    scene = {"a": values, "b": [2 * value for value in values], "once": [3.0]}
    ratio, mean, once = over_seeds(judge, {"scene": scene})
    assert (ratio.measured, ratio.standard_error) == (2.0, 0.0)
    assert mean.standard_error > 1
    assert once.standard_error == 0


def test_one_seed_has_no_error_and_draws_that_fail_do_not_count() -> None:
    (alone,) = over_seeds(lambda found: [Expectation("x", found["a"][0])], {"a": [2.0]})
    assert math.isnan(alone.standard_error)
    assert alone.seeds == 1
    (found,) = over_seeds(
        lambda found: [
            Expectation("x", math.nan if len(set(found["a"])) == 1 else float(np.mean(found["a"])))
        ],
        {"a": [1.0, 2.0, 3.0]},
    )
    assert 0 < found.standard_error < 1

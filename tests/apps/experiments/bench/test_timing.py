"""Methods take turns, and the errors of ratios are those of what is measured together."""

import math

import pytest
from rsmcm.apps.experiments.bench.timing import in_turns, medians, over_rounds
from rsmcm.apps.reports.expectations import Expectation


def test_methods_take_turns_after_a_round_that_does_not_count() -> None:
    called: list[str] = []
    spent = in_turns({name: lambda name=name: called.append(name) for name in "ab"}, rounds=2, turn=3)  # type: ignore[misc]
    assert "".join(called) == 3 * "aaabbb"
    assert {name: len(seconds) for name, seconds in spent.items()} == {"a": 2, "b": 2}
    assert all(second >= 0 for seconds in spent.values() for second in seconds)


def test_a_machine_that_slows_down_for_both_leaves_their_ratio_sure() -> None:
    seconds = [1.0, 1.0, 3.0, 8.0, 1.5]
    spent = {"ours": seconds, "theirs": [2 * each for each in seconds]}
    assert medians(spent) == {"ours": 1.5, "theirs": 3.0}
    ratio, alone = over_rounds(
        lambda of: [Expectation("ratio", of["theirs"] / of["ours"]), Expectation("s", of["ours"])], spent
    )
    assert (ratio.measured, ratio.spread) == (pytest.approx(2.0), pytest.approx(0.0))
    assert alone.spread > 0.1
    assert ratio.seeds == 5
    assert not math.isnan(alone.measured)

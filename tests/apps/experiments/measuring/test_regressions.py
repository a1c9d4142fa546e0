"""Made-up records: parts are joined, and ratios that have become worse are named."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from rsmcm.apps.experiments.expectations import Expectation
from rsmcm.apps.experiments.measuring.regressions import joined, regressions
from rsmcm.apps.experiments.record import Provenance, Record, Table, joint_state

from ....support.made_up_records import MADE as SOMEWHERE

MADE = replace(SOMEWHERE, others=0.1)


def ratio(
    what: str, measured: float, quartiles: tuple[float, float] | None, relation: str = "<="
) -> Expectation:
    return Expectation(what, measured, relation, 1.0, quartiles=quartiles, ratio=True)  # type: ignore[arg-type]


def record(*expectations: Expectation, made: Provenance = MADE, name: str = "one") -> Record:
    return Record(name, name, "make bench", made, expectations, [])


OLD = record(
    ratio("less is better", 0.40, (0.38, 0.44)),
    ratio("more is better", 6.0, (5.0, 7.0), ">="),
    Expectation("ms a frame", 2.0, "<=", 3.0),
    Expectation("nothing is wanted", 1.0, ratio=True),
)


def test_what_stays_within_the_slack_is_not_worse() -> None:
    assert regressions(OLD, OLD) == []
    slower_machine = record(
        ratio("less is better", 0.54, None),  # 0.44 and a quarter: 0.55
        ratio("more is better", 4.01, None, ">="),  # 5 less a fifth: 4
        Expectation("ms a frame", 20.0, "<=", 3.0),
        Expectation("nothing is wanted", 10.0, ratio=True),
    )
    assert regressions(slower_machine, OLD) == []


def test_what_is_worse_is_named_with_what_it_was() -> None:
    new = record(
        ratio("less is better", 0.56, None), replace(ratio("more is better", 3.99, None, ">="), loaded=True)
    )
    assert regressions(new, OLD) == [
        "less is better: 0.56, was 0.4 (0.38–0.44)",
        "more is better: 3.99, was 6 (5–7), on a loaded machine",
    ]


def test_what_is_missing_or_has_failed_is_worse() -> None:
    new = record(ratio("less is better", math.nan, None))
    assert regressions(new, OLD) == [
        "less is better: –, was 0.4 (0.38–0.44)",
        "more is better: not measured any more, was 6",
    ]


def test_parts_are_joined(tmp_path: Path) -> None:
    (tmp_path / "chains").mkdir()
    for name in ("one", "two"):
        (tmp_path / "chains" / f"{name}.py").write_text("pass")
    one = replace(MADE, state=joint_state(tmp_path, MADE.modules))
    other = ["chains/two.py"]
    two = replace(
        one, date="2026-11-23T10:00:00+00:00", seconds=10.0, load=2.0, others=0.9,
        modules=other, state=joint_state(tmp_path, other),
    )  # fmt: skip
    first, second = (
        record(Expectation("a", 1.0), made=one),
        record(Expectation("b", 2.0), made=two, name="two"),
    )
    second = replace(second, tables=[Table(("x",), [[1]], "Its own.")])
    found = joined("benchmarks", "Speed", "make bench", [first, second], tmp_path)
    assert [(each.what, each.loaded) for each in found.expectations] == [("a", False), ("b", True)]
    assert (found.made.seconds, found.made.load, found.made.date) == (40.0, 2.0, two.date)
    assert found.made.others == pytest.approx(0.3)
    assert found.made.is_of(tmp_path)
    assert [row[0] for row in found.tables[-1].rows] == ["one", "two"]
    assert found.tables[0].caption == "Its own."
    (tmp_path / "chains" / "one.py").write_text("fail")
    assert not joined("benchmarks", "Speed", "make bench", [first, second], tmp_path).made.is_of(tmp_path)


def test_no_parts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="benchmarks: got no part that was measured"):
        joined("benchmarks", "Speed", "make bench", [], tmp_path)

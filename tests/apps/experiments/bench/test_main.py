"""Parts are measured one by one; one that fails is a line, and the others stay; what got worse is named."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from rsmcm.apps.experiments.bench import __main__ as bench
from rsmcm.apps.experiments.bench.__main__ import joined, regressions
from rsmcm.apps.experiments.record import Expectation, Provenance, Record, Table

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


def test_parts_are_joined() -> None:
    two = replace(MADE, date="2026-11-23T10:00:00+00:00", seconds=10.0, load=2.0, others=0.9)
    first, second = (
        record(Expectation("a", 1.0)),
        record(Expectation("b", 2.0), made=two, name="two"),
    )
    second = replace(second, tables=[Table(("x",), [[1]], "Its own.")])
    found = joined([first, second])
    assert [(each.what, each.loaded) for each in found.expectations] == [("a", False), ("b", True)]
    assert (found.made.seconds, found.made.load, found.made.date) == (40.0, 2.0, MADE.date)
    assert found.made.others == pytest.approx(0.3)
    assert [row[0] for row in found.tables[-1].rows] == ["one", "two"]
    assert found.tables[0].caption == "Its own."


def test_parts_are_kept_whatever_becomes_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    kept = record(Expectation("of another run", 1.0, "<=", 2.0), name="points")
    bench.folder_of("points").mkdir(parents=True)
    kept.write(bench.folder_of("points") / "results.json")
    monkeypatch.setitem(bench.PARTS, "nobody", "nobody:nothing")  # unknown in the process that should run it
    assert bench.main(["--only", "nobody"]) == 1
    found = Record.read(tmp_path / bench.RECORD)
    assert found.by_what["of another run"].verdict == "pass"
    bench.folder_of("nobody").rename(bench.folder_of("large"))
    assert bench.main(["--only", "nobody"]) == 1
    failed = Record.read(tmp_path / bench.RECORD).by_what["part nobody: failed, exit code 1"]
    assert math.isnan(failed.measured)
    assert failed.verdict == "short"
    assert bench.main(["--against", str(bench.RECORD)]) == 0
    assert f"no ratio is worse than in {bench.RECORD}" in capfd.readouterr().out


def test_what_cannot_be_done_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert bench.main(["--only", "points,pixel"]) == 2
    assert bench.main(["--against", "none.json"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("--only: got pixel, expected some of background,")
    assert "none.json" in said[1] or "benchmarks.json" in said[1]
    assert len(said) == 2

"""Methods take turns and ratios are those of what was measured together; parts are joined, and compared."""

import math
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.background.application import build_model
from rsmcm.apps.experiments.bench import __main__ as bench
from rsmcm.apps.experiments.bench import background
from rsmcm.apps.experiments.bench.__main__ import joined, regressions
from rsmcm.apps.experiments.bench.curves import Curve
from rsmcm.apps.experiments.bench.timing import of_chains, over_frames, over_rounds
from rsmcm.apps.experiments.record import Expectation, Provenance, Record, Table
from rsmcm.apps.io.files import write_image
from rsmcm.apps.scenes import sleeping_man
from rsmcm.models.core.frame import Frame

from ....support.made_up_records import MADE as SOMEWHERE

MADE = replace(SOMEWHERE, others=0.1)


def test_methods_get_all_frames_in_order() -> None:
    frames = [Frame(None, number / 25, number) for number in range(1, 51)]
    seen: dict[str, list[int]] = {"a": [], "b": []}
    spent = over_frames(
        {name: lambda f, name=name: seen[name].append(f.number) for name in seen},  # type: ignore[misc]
        frames,
        turn=20,
        warm_up=20,
    )
    assert seen["a"] == seen["b"] == [*range(1, 51)]
    assert {name: len(turns) for name, turns in spent.items()} == {"a": 2, "b": 2}


def test_a_machine_that_slows_down_for_both_leaves_their_ratio_sure() -> None:
    seconds = [1.0, 1.0, 3.0, 8.0, 1.5]
    spent = {"ours": seconds, "theirs": [2 * each for each in seconds]}
    ratio, alone = over_rounds(
        lambda of: [Expectation("ratio", of["theirs"] / of["ours"]), Expectation("s", of["ours"])], spent
    )
    assert (ratio.measured, ratio.quartiles, ratio.seeds) == (2.0, (2.0, 2.0), 5)
    assert (alone.measured, alone.quartiles) == (1.5, (1.0, 3.0))
    assert (ratio.ratio, alone.ratio) == (True, False)


def test_times_of_chains_are_parts_of_the_whole() -> None:
    found, _ = of_chains(build_model(), sleeping_man(6, size=(96, 72)))
    assert len(found) == 6
    for each in found:
        assert {"background", "blobs", "pixels", "objects"} <= each.keys()
        assert 0 < sum(seconds for name, seconds in each.items() if name != "whole") <= each["whole"]


def test_a_power_is_found_and_its_error_is_that_of_a_regression() -> None:
    sizes = (10.0, 100.0, 1000.0, 10_000.0)
    seconds = [3e-6 * size**1.5 * factor for size, factor in zip(sizes, (1.1, 0.8, 1.3, 0.9), strict=True)]
    power, error = Curve("made up", "things", list(zip(sizes, seconds, strict=True))).power
    coefficients, covariance = np.polyfit(np.log(sizes), np.log(seconds), 1, cov="unscaled")
    left = np.log(seconds) - np.polyval(coefficients, np.log(sizes))
    assert power == pytest.approx(coefficients[0])
    assert error == pytest.approx(math.sqrt(covariance[0, 0] * (left @ left) / 2))


def test_what_is_done_once_counts_for_the_whole_film_only() -> None:
    frames = background.LONG - background.SHORT
    spent = {"short": 0.75, "long": 0.75 + 0.01 * frames, "begun": 0.3, "engine": 0.3 + 0.008 * frames}
    rate, whole, engine, over, whole_over = (each.measured for each in background.of_commands(spent))
    assert (rate, engine, over) == pytest.approx((100, 8, 1.25))
    assert whole == pytest.approx(background.LONG / spent["long"])
    assert whole_over == pytest.approx(spent["long"] / spent["engine"])


@pytest.mark.slow
def test_the_moments_are_those_of_frames_that_are_answered(tmp_path: Path) -> None:
    film = tmp_path / "film"
    film.mkdir()
    for frame in sleeping_man(3, size=(64, 48)):
        assert frame.image is not None
        write_image(film / f"{frame.number}.png", frame.image)
    command = [sys.executable, "-m", background.__name__, "--quiet", "background", str(film)]
    before = time.time()
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "out")], check=True, capture_output=True, text=True
    )
    first, last = map(float, done.stdout.split())
    assert before < first < last < time.time()


def ratio(
    what: str, measured: float, quartiles: tuple[float, float] | None, relation: str = "<="
) -> Expectation:
    return Expectation(what, measured, relation, 1.0, quartiles=quartiles, ratio=True)  # type: ignore[arg-type]


def record(*expectations: Expectation, made: Provenance = MADE, name: str = "one") -> Record:
    return Record(name, name, "make bench", made, expectations, [])


LESS, MORE = ratio("less is better", 0.40, (0.38, 0.44)), ratio("more is better", 6.0, (5.0, 7.0), ">=")
OLD = record(
    LESS, MORE, Expectation("ms a frame", 2.0, "<=", 3.0), Expectation("nothing is wanted", 1.0, ratio=True)
)


@pytest.mark.parametrize(
    ("less", "more", "worse"),
    [
        (replace(LESS, measured=0.54), replace(MORE, measured=4.01), []),  # 0.44 and 5 with a quarter
        (
            replace(LESS, measured=0.56),
            replace(MORE, measured=3.99, loaded=True),
            [
                "less is better: 0.56, was 0.4 (0.38–0.44)",
                "more is better: 3.99, was 6 (5–7), on a loaded machine",
            ],
        ),
        (
            replace(LESS, measured=math.nan),
            Expectation("ms a frame", 20.0, "<=", 3.0),  # of a slower machine
            ["less is better: –, was 0.4 (0.38–0.44)", "more is better: not measured any more, was 6"],
        ),
    ],
)
def test_what_is_worse_or_missing_is_named(less: Expectation, more: Expectation, worse: list[str]) -> None:
    assert regressions(record(less, more), OLD) == worse


def test_parts_are_joined() -> None:
    two = replace(MADE, date="2026-11-23T10:00:00+00:00", seconds=10.0, load=2.0, others=0.9)
    first, second = record(Expectation("a", 1.0)), record(Expectation("b", 2.0), made=two, name="two")
    found = joined([first, replace(second, tables=[Table(("x",), [[1]], "Its own.")])])
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
    found = Record.read(tmp_path / bench.RECORD).by_what
    assert found["of another run"].verdict == "pass"
    assert found["part nobody: failed, exit code 1"].verdict == "missed"
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
    assert len(said) == 2

"""Parts are measured one by one; one that fails is a line, and the others stay."""

import math
from pathlib import Path

import pytest
from rsmcm.apps.experiments.bench import __main__ as bench
from rsmcm.apps.experiments.bench.part import PARTS
from rsmcm.apps.experiments.record import Record


def test_parts_are_kept_whatever_becomes_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert bench.main(["--only", "exactness"]) == 0
    monkeypatch.setitem(PARTS, "nobody", PARTS["exactness"])  # unknown in the process that should run it
    assert bench.main(["--only", "nobody"]) == 1
    record = Record.read(tmp_path / bench.RECORD)
    assert record.by_what["BP against enumeration, greatest difference"].verdict == "pass"
    failed = record.by_what["part nobody: failed, exit code 1"]
    assert math.isnan(failed.measured)
    assert failed.verdict == "short"
    assert bench.main(["--against", str(bench.RECORD)]) == 0
    assert f"no ratio is worse than in {bench.RECORD}" in capfd.readouterr().out


def test_what_cannot_be_done_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert bench.main(["--only", "exactness,pixel"]) == 2
    assert bench.main(["--against", "none.json"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("--only: got pixel, expected some of background,")
    assert "none.json" in said[1] or "benchmarks.json" in said[1]
    assert len(said) == 2

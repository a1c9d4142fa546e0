"""What is said on the way."""

import io
import logging
import sys
import time

import pytest
from rsmcm.apps.runs import progress


@pytest.fixture(autouse=True)
def not_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """As without --quiet, which a command before, in this process, may have had; with a line every 10 s."""
    monkeypatch.setattr(progress, "SPARSE_SECONDS", 10.0)
    package = logging.getLogger("rsmcm")
    monkeypatch.setattr(package, "level", package.level)
    monkeypatch.setattr(package, "handlers", [])
    package.setLevel(logging.WARNING)  # which forgets what was enabled before, too


def test_progress_without_a_terminal_is_sparse(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with progress.Progress("background", 400, done=100) as bar:
        for _ in range(250):
            now += 0.1
            bar.update()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("background: 201 of 400 frames, 10.0 frames/s, 00:19 left")
    with progress.Progress("background", None) as bar:
        bar.update()
        now += 11
        bar.update(11)
    assert capsys.readouterr().err == "background: 12 frames, 1.0 frames/s\n"


def test_the_rate_is_without_the_first_round_in_which_loops_are_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with progress.Progress("structure", 20, unit="rounds") as bar:
        now += 100
        bar.update()
        assert capsys.readouterr().err == "structure: 1 of 20 rounds\n"
        now += 12.5
        bar.update()
    assert capsys.readouterr().err == "structure: 2 of 20 rounds, 12.5 s each, 03:45 left\n"


def test_rates_are_without_the_time_of_compiling(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = compiled = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    monkeypatch.setattr(progress, "compile_seconds", lambda: compiled)
    with progress.Progress("background", 100) as bar:
        bar.update()
        now, compiled = now + 60.0, compiled + 50.0
        bar.update(10)
    assert capsys.readouterr().err == "background: 11 of 100 frames, 1.0 frames/s, 01:29 left\n"


class Terminal(io.StringIO):
    """What says that it is one."""

    def isatty(self) -> bool:
        return True


def test_a_bar_is_without_the_time_of_compiling_too(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = 0.0
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(progress, "compile_seconds", lambda: compiled)
    with progress.Progress("background", 100) as bar:
        assert bar._bar is not None
        compiled = 50.0
        before = bar._bar.format_dict["elapsed"]
        bar.update()
        assert bar._bar.format_dict["elapsed"] < before - 40.0


def test_a_notebook_has_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ipykernel", None)
    with progress.Progress("background", 100) as bar:
        assert bar._bar is not None

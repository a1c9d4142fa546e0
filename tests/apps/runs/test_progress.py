"""What is said on the way."""

import logging
import time

import pytest
from rsmcm.apps.runs import progress


@pytest.fixture(autouse=True)
def not_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """As without --quiet, which a command before, in this process, may have had; with a line every 10 s."""
    monkeypatch.setattr(progress, "SPARSE_SECONDS", 10.0)
    package = logging.getLogger("rsmcm")
    monkeypatch.setattr(package, "level", package.level)
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

"""What a run tells before its first frame."""

import logging
from pathlib import Path

import numba
import pytest
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.runs.session import Session


@pytest.mark.parametrize("is_quiet", [False, True])
def test_compilation_is_announced_once(
    is_quiet: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    package = logging.getLogger("rsmcm")
    monkeypatch.setattr(package, "level", package.level)
    package.setLevel(logging.ERROR if is_quiet else logging.WARNING)
    session = Session("background", BackgroundJob("film.mp4", out=tmp_path / "out"), {})
    with session.running():
        for number in range(2):
            assert numba.njit(lambda x, number=number: x + number)(1) == 1 + number
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == (0 if is_quiet else 1)
    assert is_quiet or lines[0].startswith("background: compiling for this machine, ")

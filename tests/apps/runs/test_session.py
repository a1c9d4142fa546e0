"""What a run tells before its first frame."""

import logging
from pathlib import Path

import numba
import pytest
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.runs.session import Session


@pytest.mark.parametrize(("is_quiet", "is_kept"), [(False, True), (True, True), (False, False)])
def test_compilation_is_announced_once(
    is_quiet: bool,
    is_kept: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Where its code is kept: of what is compiled in each process, something else is said."""
    monkeypatch.setattr("rsmcm.apps.runs.session.is_kept", lambda _: is_kept)
    package = logging.getLogger("rsmcm")
    monkeypatch.setattr(package, "level", package.level)
    package.setLevel(logging.ERROR if is_quiet else logging.WARNING)
    session = Session("background", BackgroundJob("film.mp4", out=tmp_path / "out"), {})
    with session.running():
        for number in range(2):
            assert numba.njit(lambda x, number=number: x + number)(1) == 1 + number
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == (is_kept and not is_quiet)
    assert not lines or lines[0].startswith("background: compiling for this machine, ")

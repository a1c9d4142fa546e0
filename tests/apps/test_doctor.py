"""What `rsmcm doctor` finds, and that it says what is missing."""

import pytest
from rsmcm.apps import doctor


@pytest.fixture
def no_self_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_self_test", lambda: ("left out", True))


def test_a_person_is_found_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(doctor, "SELF_TEST_FRAMES", 60)
    assert doctor.examine()
    lines = capsys.readouterr().out.splitlines()
    assert "60 frames" in next(line for line in lines if line.startswith("self test:"))
    assert lines[-1] == "all that every run needs is there"


@pytest.mark.usefixtures("no_self_test")
def test_what_an_extra_brings_may_be_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "EXTRAS", {"dask": ("no_such_package", "--dask")})
    assert doctor.examine()
    assert "needed for --dask: pip install 'rsmcm[dask]'" in capsys.readouterr().out


@pytest.mark.usefixtures("no_self_test")
def test_videos_have_to_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_has_codec", lambda name, mode: mode == "r")
    assert not doctor.examine()
    assert "wrong: videos written" in capsys.readouterr().out

"""Which page is shown of a folder, and where it is shown."""

import webbrowser
from pathlib import Path

import pytest
from rsmcm.apps.view.page import open_page

from ...conftest import Command

run = Command("view")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    asked: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(asked.append(address)))
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    return asked


def test_the_page_of_a_run_goes_before_that_of_a_batch(
    tmp_path: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    for name in ("index.html", "view.html"):
        (tmp_path / name).touch()
        assert open_page(tmp_path) == tmp_path / name
    assert opened == [(tmp_path / name).as_uri() for name in ("index.html", "view.html")]


def test_without_a_screen_the_page_is_named(
    tmp_path: Path, opened: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "view.html").touch()
    assert run(tmp_path) == 0
    assert capfd.readouterr().out == f"{tmp_path / 'view.html'}\n"
    assert not opened


@pytest.mark.parametrize("name", ["", "gone"])
def test_a_folder_without_results(
    tmp_path: Path, opened: list[str], capfd: pytest.CaptureFixture[str], name: str
) -> None:
    assert "view.html" in run.complaint(capfd, tmp_path / name)
    assert not opened

"""Every page that a command leaves, in a real browser: nothing wrong, nothing asked for, readable."""

from pathlib import Path

import pytest
from rsmcm.apps.experiments.experiment import Findings, Plot, publish
from rsmcm.apps.experiments.record import Expectation, Table

from ..conftest import Command
from ..support.browser import PHONE, Browser, landmarks, overflow
from .test_same_bytes import arguments_of

APPLICATIONS = ("background", "structure", "shape", "face", "body")


def check(browser: Browser, page: Path) -> None:
    for size in (PHONE, (1440, 900)):
        with browser.page(page, size) as opened:
            opened.wait_for_timeout(300)
            assert overflow(opened) <= 0, (page.name, size)
            mains, headings = landmarks(opened)
            assert mains == 1, page.name
            assert opened.locator("h1").count() == 1, page.name
            assert len(headings) >= 2, page.name
            assert opened.locator("img:not([alt])").count() == 0, page.name


@pytest.mark.parametrize(
    "name", ["background", *(pytest.param(name, marks=pytest.mark.slow) for name in APPLICATIONS[1:])]
)
def test_pages_of_runs(browser: Browser, tmp_path: Path, name: str) -> None:
    folder, out = tmp_path / "of", tmp_path / "out"
    folder.mkdir()
    assert Command(name)(*arguments_of(name, folder)[1:], "--out", out) == 0
    check(browser, out / "view.html")


def test_the_page_of_an_experiment(browser: Browser, tmp_path: Path) -> None:
    header = [f"measure {k}" for k in range(12)]
    plot = Plot("plot.png", lambda canvas: canvas.subplots().plot([1, 2]), (9, 4), "What is drawn.")  # type: ignore[func-returns-value]
    measured = Table(header, [[f"method {row}", *range(11)] for row in range(5)])
    wanted = [Expectation("a long sentence about what is wanted of the error " * 3, 0.3, "<=", 0.35)]
    found = Findings("An experiment", [measured], wanted, [plot])
    publish("name", "rsmcm reproduce name", tmp_path, lambda: found)
    check(browser, tmp_path / "index.html")

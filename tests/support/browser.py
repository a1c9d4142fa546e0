"""Pages in a real browser, Chromium of the system: no error on the console, no request to anybody."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    import playwright.sync_api as playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OWN = {"file", "data", "blob", "about"}
"""Schemes of what a page holds itself."""

DESKTOP, PHONE = (1440, 900), (375, 812)

QUIET = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")


def chromium() -> str:
    """Its executable; where there is none, a skip."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no Chromium: none of {', '.join(NAMES)} is on the path")
    return found


class Browser:
    """A browser without windows, in which pages of files are opened; see `browsing`."""

    def __init__(self, driven: "playwright.Browser") -> None:
        self._driven = driven

    @contextmanager
    def page(
        self, of: Path | str, size: tuple[int, int] = DESKTOP, *, dark: bool = False
    ) -> "Iterator[playwright.Page]":
        """A page, a file or what an address serves, in a window of `size` (width, height) px.

        Raises
        ------
        AssertionError
            at the end, if something was wrong on the console, an error was not caught, or something else was
            asked for than what the page holds or its own server has.
        """
        where = of if isinstance(of, str) else of.as_uri()
        width, height = size
        context = self._driven.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light"
        )
        wrong: list[str] = []
        page = context.new_page()
        page.set_default_timeout(20_000)
        page.on(
            "console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: wrong.append(str(error)))

        def asked(request: "playwright.Request") -> None:
            address = urlsplit(request.url)
            served = isinstance(of, str) and request.url.startswith(of)
            if not served and (
                address.scheme not in OWN or (address.scheme == "file" and request.url != where)
            ):
                wrong.append(f"asked for {request.url[:200]}")

        page.on("request", asked)
        try:
            page.goto(where)
            yield page
            assert not wrong, wrong
        finally:
            context.close()


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser, for as long as the block lasts."""
    executable = chromium()
    sync = pytest.importorskip("playwright.sync_api")
    with sync.sync_playwright() as playwright:
        driven = playwright.chromium.launch(executable_path=executable, args=list(QUIET))
        try:
            yield Browser(driven)
        finally:
            driven.close()


def overflow(page: "playwright.Page") -> int:
    """By how many px a page is wider than its window."""
    return int(page.evaluate("document.documentElement.scrollWidth - innerWidth"))


def reached_by_tab(page: "playwright.Page", most: int = 200) -> set[str]:
    """What the tab key reaches from the page's beginning: id of each element, or its text."""
    page.evaluate("document.activeElement.blur()")
    reached: list[str] = []
    for _ in range(most):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "(() => { const at = document.activeElement;"
            "return at === document.body ? null : at.id || at.textContent.trim() || at.tagName; })()"
        )
        if name is None or name in reached[:1]:
            break
        reached.append(name)
    return set(reached)


def landmarks(page: "playwright.Page") -> tuple[int, list[str]]:
    """How many `main` a page has, and the headings in their order."""
    headings = page.locator("h1, h2, h3").all_text_contents()
    return page.locator("main").count(), headings

"""`view.html` in a real browser: it plays, is clicked, typed at, and is read on any screen."""

import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from markupsafe import Markup
from rsmcm.apps.demo import write_scene
from rsmcm.apps.events import read_zones
from rsmcm.apps.exports import read_tracks_table
from rsmcm.apps.scenes import sleeping_man
from rsmcm.apps.view.film import Film, read_film
from rsmcm.apps.view.page import (
    MOST_FRAMES,
    Line,
    Page,
    Plot,
    TimelineRow,
    picture,
    table,
    write_page,
)

from ...conftest import Command
from ...support.browser import Browser
from ...support.records import PICTURE
from ...support.view_page import ViewPage, shown_page

if TYPE_CHECKING:
    import playwright.sync_api as playwright

N_FRAMES = 60
SIZE = (320, 240)
ZONES = """
[[zone]]
name = "whole"
polygon = [[0, 0], [320, 0], [320, 240], [0, 240]]
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    write_scene(sleeping_man(N_FRAMES, size=SIZE, enter=0), folder)
    (folder / "zones.toml").write_text(ZONES)
    out, zones = folder / "out", folder / "zones.toml"
    assert Command("background")(folder / "input", "--out", out, "--every", 25, "--zones", zones) == 0
    return folder / "out"


@pytest.fixture
def shown(browser: Browser, results: Path) -> Iterator[ViewPage]:
    with shown_page(browser, results, SIZE) as opened:
        yield opened


@pytest.fixture
def page(shown: ViewPage) -> "playwright.Page":
    return shown.page


def test_the_film_plays_and_stops_at_its_end(shown: ViewPage, page: "playwright.Page") -> None:
    assert shown.frame == 1
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("document.querySelector('video').currentTime > 0.2")
    assert page.get_by_role("button", name="Pause").is_visible()
    page.select_option("#speed", "8")
    page.wait_for_function(f"document.getElementById('clock').textContent.startsWith('frame {N_FRAMES},')")
    page.get_by_role("button", name="Play").wait_for()
    page.select_option("#speed", "1")  # or its first second is over before a busy browser looks
    page.keyboard.press(" ")  # from the beginning
    page.wait_for_function("document.querySelector('video').currentTime < 1")


def test_zones_that_are_drawn_become_a_file(shown: ViewPage, page: "playwright.Page") -> None:
    page.get_by_role("button", name="Draw a zone").click()
    corners = [(40, 50), (200, 50), (200, 180), (60, 200)]
    for x, y in corners:
        shown.click((x, y))
    shown.click((41, 51))  # the first one again
    page.get_by_role("button", name="Draw a line").click()
    shown.click((100, 20))
    shown.click((100, 220))
    page.get_by_label("name of the line").fill('the "gate"')
    page.get_by_role("button", name="Draw a zone").click()
    page.keyboard.press("Enter")  # one to be typed
    page.get_by_label("corners of zone 1").fill("1,2 30,2 30,40.5")
    page.keyboard.press("Tab")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == "zones.toml"
    content = tomllib.loads(Path(download.value.path()).read_text())
    assert [zone["name"] for zone in content["zone"]] == ["whole", "zone", "zone 1"]
    np.testing.assert_allclose(content["zone"][1]["polygon"], corners, atol=1)
    assert content["zone"][2]["polygon"] == [[1, 2], [30, 2], [30, 40.5]]
    assert content["line"][0]["name"] == 'the "gate"'
    zones = read_zones(download.value.path(), SIZE)  # as --zones does
    assert zones.plain()["zones"] == content["zone"]
    np.testing.assert_allclose(
        [content["line"][0][end] for end in ("from", "to")], [(100, 20), (100, 220)], atol=1
    )
    page.get_by_label("Remove zone 1").click()
    assert "zone 1" not in page.locator("textarea").input_value()


def test_no_text_of_the_user_is_taken_for_a_script(browser: Browser, tmp_path: Path) -> None:
    """And without a film there is a slider over time."""
    bad = '</script><script>alert("x")</script><!-- & "'
    count = 12
    film = Film(None, (64, 48), np.arange(1, count + 1), np.arange(count) / 5, np.arange(count) / 5)
    row = TimelineRow(7, bad, "#ff0000", np.array([[0, 3, 0], [4, 11, 1]]))
    values = np.where(np.arange(count) < 6, np.nan, np.arange(count))
    numbers, more = np.arange(1, 21), np.append(values, np.zeros(8))
    plots = [Plot(bad, "px", [Line(more, bad)], bad)]
    page = Page(
        bad, {bad: bad}, [bad], film, {}, [row], plots, [(bad, [table([bad], [[bad]], bad)])], {bad: bad}
    )
    write_page(tmp_path / "view.html", replace(page, numbers=numbers, times=(numbers - 1) / 5))
    with browser.page(tmp_path / "view.html") as page:
        assert page.locator("h1").text_content() == bad
        assert page.locator("video").count() == 0
        assert "12 of 20" in (page.locator("#part").text_content() or "")
        page.locator("[role=option]").first.click()
        assert page.locator("#details .who").text_content() == bad
        page.keyboard.press("Home")
        assert "–" in (page.locator(".plot .head").text_content() or ""), "nothing is known"
        page.locator("#play").click()
        page.wait_for_function(f"document.getElementById('clock').textContent.startsWith('frame {count},')")


@pytest.mark.parametrize(
    "options",
    [(), ("--engine", "coordinate-ascent"), ("--camera", "moving"), ("--engine", "stand-alone")],
    ids=str,
)
def test_what_is_drawn_are_the_results(results: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    """With every engine, and of frames as they are, where the camera moves."""
    out = tmp_path / "out"
    assert Command("background")(results.parent / "input", "--out", out, *options) == 0
    film = read_film(out)
    assert (out / "view.html").exists()
    if "stand-alone" in options:
        assert not len(film.columns["id"])
        return
    table = read_tracks_table(out)
    assert len(table["id"]) > 20
    np.testing.assert_array_equal(np.repeat(film.numbers, film.counts["id"]), table["frame"])
    np.testing.assert_array_equal(film.columns["id"], table["id"])
    sides = np.stack([table[name] for name in ("x", "y", "width", "height")], axis=1)
    np.testing.assert_allclose(film.columns["box"], sides, atol=0.006)


def test_what_the_page_holds_is_json(results: Path) -> None:
    text = (results / "view.html").read_text()
    (held,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert json.loads(held)["run"]["frames"] == N_FRAMES
    # pictures are base64, in which four letters may come by chance
    assert "http:" not in re.sub(r"http://www\.w3\.org/\d+/svg", "", text)
    assert "https:" not in text


def test_tables_escape_text_and_round_numbers() -> None:
    text = table(("a", "b"), [("<i>", 0.123456), (Markup("<b>2</b>"), True)], "x < y")
    assert "&lt;i&gt;" in text
    assert '<td class="number">0.1235</td>' in text
    assert "<td><b>2</b></td><td>True</td>" in text
    assert "x &lt; y" in text
    with pytest.raises(ValueError, match="expected 2"):
        table(("a", "b"), [(1,)])


def test_masks_are_kept_exactly() -> None:
    assert "image/png" in picture(np.where(PICTURE[..., 0] > 90, np.uint8(255), np.uint8(0)))
    assert "image/jpeg" in picture(PICTURE)


# --- plots --------------------------------------------------------------------------------------------------


def test_plots_of_long_runs_are_of_means(browser: Browser, tmp_path: Path) -> None:
    count = 2 * MOST_FRAMES + 2
    values = np.where(np.arange(count) % 3 == 0, np.nan, 7.0)
    seven = Plot("seven", "px", [Line(values)])
    long = Page("long", plots=[seven], numbers=range(1, count + 1), times=(np.arange(count) / 25).tolist())
    write_page(tmp_path / "view.html", long)
    assert (tmp_path / "view.html").stat().st_size < 1 << 20
    with browser.page(tmp_path / "view.html") as shown:
        assert shown.get_by_text("Means over 3 frames each.").is_visible()
    with pytest.raises(ValueError, match=f"got 5, expected one for each of {count}"):
        write_page(tmp_path / "view.html", replace(long, plots=[Plot("few", "", [Line(values[:5])])]))

"""A reconstruction's page: what of a run is on it, and what can be done with it in a browser."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import Cylinder
from rsmcm.apps.structure import page as module
from rsmcm.apps.structure.files import GREY, orthographic_parts
from rsmcm.apps.structure.page import film_of_tracks, structure_page, write_film
from rsmcm.apps.view import points
from rsmcm.apps.view.film import Film
from rsmcm.apps.view.page import SEEN, Page, write_page
from rsmcm.chains.reconstruction import Reconstruction

from ...support.browser import PHONE, Browser, landmarks, overflow
from ...support.reconstructions import SIZE, pictures, reconstruction, small_cylinder, without_images
from ...support.view_page import ViewPage, shown_page

N_FRAMES = 20
SUMMARY = {"frames": N_FRAMES, "notes": ["Something <odd>."], "parameters": {"a": {"b": 1}}}
COLOURS = np.random.default_rng(0).integers(0, 256, (15, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def truth() -> Cylinder:
    return small_cylinder(N_FRAMES)


@pytest.fixture(scope="module")
def found(truth: Cylinder) -> Reconstruction:
    return reconstruction(truth)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, truth: Cylinder, found: Reconstruction) -> Path:
    path, frames = tmp_path_factory.mktemp("structure"), pictures(truth, COLOURS)
    film = write_film(path, frames, 25)
    write_page(path / "view.html", structure_page("pictures", frames, found, COLOURS, SUMMARY, film))
    return path


def write_without_film(path: Path, truth: Cylinder, found: Reconstruction) -> None:
    frames = without_images(pictures(truth, COLOURS))
    film, corner = film_of_tracks(frames, found)
    page = structure_page("tracks", frames, found, np.full_like(COLOURS, GREY), SUMMARY, film, corner)
    write_page(path / "view.html", page)


@pytest.fixture
def shown(browser: Browser, folder: Path) -> Iterator[ViewPage]:
    with shown_page(browser, folder, SIZE) as page:
        yield page


def layer_of(truth: Cylinder, found: Reconstruction, numbers: NDArray[np.int64]) -> dict[str, Any]:
    film = Film(None, SIZE, numbers, numbers / 25, numbers / 25)
    page = structure_page("title", pictures(truth, COLOURS), found, COLOURS, SUMMARY, film)
    layer: dict[str, Any] = {**page.layers["points"], **page.layers["structure"]}
    for row in page.timeline:
        seen = np.zeros(len(numbers), np.bool_)
        for first, last, kind in row.spans.tolist():
            seen[first : last + 1] = kind == SEEN
        np.testing.assert_array_equal(seen, found.observed[numbers - 1, row.identity])
    return layer


@pytest.mark.parametrize("first", [8])
def test_what_is_on_the_page(truth: Cylinder, found: Reconstruction, first: int) -> None:
    """Of the frames that the film has: the last ones, if it is long."""
    numbers = np.arange(first, N_FRAMES + 1)
    layer = layer_of(truth, found, numbers)
    np.testing.assert_array_equal(layer["tracked"], np.arange(15))
    np.testing.assert_allclose(layer["positions"], found.positions[first - 1 :], atol=1e-4)
    np.testing.assert_allclose(layer["residuals"], found.residuals[first - 1 :], atol=1e-5)
    seen = ~np.isnan(layer["residuals"]).any(axis=2)
    np.testing.assert_array_equal(seen, found.observed[first - 1 :])
    np.testing.assert_array_equal(layer["counts"], np.count_nonzero(found.observed, axis=0))
    space = layer["space"]
    np.testing.assert_allclose(space["places"], found.shape, atol=1e-6)
    blue, green, red = (space["colours"] >> shift & 255 for shift in (16, 8, 0))
    np.testing.assert_array_equal(np.stack([blue, green, red], axis=1), COLOURS)
    _, rotations = orthographic_parts(found.cameras[first - 1 :])
    np.testing.assert_allclose(space["rotations"], rotations, atol=1e-6)


def test_a_page_is_bounded(truth: Cylinder, found: Reconstruction, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_POINTS", 10)
    monkeypatch.setattr(points, "MOST_PLACES", 7 * N_FRAMES)
    monkeypatch.setattr(points, "MOST_ROWS", 3)
    layer = layer_of(truth, found, np.arange(1, N_FRAMES + 1))
    assert len(layer["space"]["places"]) == 10
    assert len(layer["tracked"]) == 7
    np.testing.assert_allclose(layer["positions"], found.positions[:, layer["tracked"]], atol=1e-4)


def written(truth: Cylinder, found: Reconstruction, folder: Path, *, images: bool = True) -> tuple[Page, str]:
    frames = pictures(truth, COLOURS)
    corner = module.EDGE
    if images:
        film = write_film(folder, frames, 25, found)
    else:
        frames = without_images(frames)
        film, corner = film_of_tracks(frames, found)
    page = structure_page("title", frames, found, COLOURS, SUMMARY, film, corner)
    write_page(folder / "view.html", page)
    return page, (folder / "view.html").read_text()


def headings(page: Page) -> list[str]:
    return [heading for heading, _ in page.sections]


def test_a_page_with_everything(truth: Cylinder, found: Reconstruction, tmp_path: Path) -> None:
    page, text = written(truth, found, tmp_path)
    assert headings(page) == ["Shape", "Rounds"]
    for words in ("from the front", "from above", "Something &lt;odd&gt;.", "a.b", "points seen"):
        assert words in text
    assert "nan px" not in text
    surface = page.layers["structure"]["surface"]
    corners = np.array(surface["points"])
    np.testing.assert_allclose(surface["corners"], found.shape[corners], atol=1e-5)
    index = surface["frame"] - 1
    assert found.observed[index, corners].all()
    np.testing.assert_allclose(surface["onPicture"], found.places[index, corners], atol=1e-3)
    assert surface["triangles"].max() < len(corners)


def test_a_shape_that_is_affine_or_undetermined(
    truth: Cylinder, found: Reconstruction, tmp_path: Path
) -> None:
    affine = replace(found, geometry="affine", reason="two views")
    assert "lengths and angles are not determined" in written(truth, affine, tmp_path)[1]
    page, text = written(truth, replace(found, geometry="none", reason="static"), tmp_path)
    assert headings(page) == ["Rounds"]
    assert "undetermined" in text
    assert page.layers["structure"]["space"] is None


def test_frames_in_which_nothing_was_seen(truth: Cylinder, found: Reconstruction, tmp_path: Path) -> None:
    observed, residuals = found.observed.copy(), found.residuals.copy()
    observed[4], residuals[4] = False, np.nan
    some = replace(found, observed=observed, residuals=residuals)
    assert np.isfinite(some.reprojection_error)
    page, _ = written(truth, some, tmp_path)
    errors = page.plots[0].lines[0].values
    assert np.isnan(errors).tolist() == [index == 4 for index in range(N_FRAMES)]
    squares = [np.square(each[seen]).sum(axis=1) for each, seen in zip(residuals, observed, strict=True)]
    np.testing.assert_allclose(errors, [np.sqrt(each.mean()) if each.size else np.nan for each in squares])


# --- in a browser -------------------------------------------------------------------------------------------


def alone(places: NDArray[np.float64], least: float, few: int = 4) -> list[int]:
    """Those of places `(n, 2)` that are not near to others."""
    distances = np.linalg.norm(places[:, None] - places, axis=2) + 1e3 * np.eye(len(places))
    found = np.flatnonzero(distances.min(axis=1) > least).tolist()
    assert found
    return found[:few]


def test_a_click_on_a_point_selects_it(shown: ViewPage, found: Reconstruction) -> None:
    inside = (found.places > 0).all(axis=2) & (found.places < np.array(SIZE) - 1).all(axis=2)
    free = np.zeros_like(inside)
    for index, places in enumerate(found.places):
        free[index, alone(places, 3.0, len(places))] = True
    for kind in (found.observed, ~found.observed):
        some = np.argwhere(free & inside & kind)
        assert len(some) > 8
        for index, point in some[:: len(some) // 8].tolist():
            shown.show(index)
            shown.click(found.places[index, point])
            assert shown.selected == f"point {point + 1}"
            np.testing.assert_allclose(shown.numbers("place"), found.places[index, point], atol=0.06)
            seen = bool(found.observed[index, point])
            assert shown.details["now"].startswith("seen" if seen else "not seen")
            assert ("residual" in shown.details) == seen
            if seen:
                size = np.linalg.norm(found.residuals[index, point])
                assert shown.numbers("residual")[0] == pytest.approx(size, abs=0.03)
            times = np.count_nonzero(found.observed[:, point])
            np.testing.assert_array_equal(shown.numbers("seen in"), [times, N_FRAMES])
    shown.click((0, 0))
    assert shown.selected is None


def test_frames_of_which_nothing_is_known(
    browser: Browser, truth: Cylinder, found: Reconstruction, tmp_path: Path
) -> None:
    """Their cameras, positions and covariances are NaN."""
    holes = {}
    for name in ("positions", "covariances", "residuals", "cameras"):
        values = getattr(found, name).copy()
        values[5:8] = np.nan
        holes[name] = values
    observed = found.observed.copy()
    observed[5:8] = False
    write_without_film(tmp_path, truth, replace(found, observed=observed, **holes))
    with shown_page(browser, tmp_path, SIZE) as shown:
        shown.page.locator("#row-4 .label").click()
        for index in (4, 6, 9):
            shown.show(index)
            assert ("place" in shown.details) == (index != 6)
        for key in ("u", "r", "z"):
            shown.page.keyboard.press(key)
        shown.show(6)


def test_on_a_phone(browser: Browser, folder: Path) -> None:
    with browser.page(folder / "view.html", PHONE) as page:
        page.locator("#row-4 .label").click()
        assert overflow(page) <= 0
        count, headings = landmarks(page)
        assert count == 1
        assert "In space" in headings
        page.locator(".space").focus()
        page.keyboard.press("ArrowUp")

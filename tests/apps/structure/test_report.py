"""The report page and the drawn tracks, from reconstructions that are known."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.drawing.boxes import identity_colour
from rsmcm.apps.structure.files import point_colours
from rsmcm.apps.structure.report import write_structure_report
from rsmcm.apps.structure.track_overlay import draw_points, write_overlay
from rsmcm.models.core.frame import Frame

from ...support.reconstructions import SIZE, pictures, reconstruction, small_cylinder, without_images
from ..background.test_report import Page

TRUTH = small_cylinder()
FOUND = reconstruction(TRUTH)
FRAMES = pictures(TRUTH, np.full((15, 3), 200, np.uint8))


def written(path: Path, frames: object = FRAMES, found: object = FOUND) -> str:
    colours = point_colours(frames, found)  # type: ignore[arg-type]
    notes = ["Something <odd>."]
    write_structure_report(path, frames, found, colours, notes, {"a": {"b": 1}}, "title")  # type: ignore[arg-type]
    return path.read_text()


def test_a_page_with_everything(tmp_path: Path) -> None:
    text = written(tmp_path / "report.html")
    page = Page(text)
    assert all(address.startswith(("data:", "#")) for address in page.addresses)
    assert page.tags.count("img") == 8 + 3  # frames with tracks, and surfaces
    for words in ("from the front", "from above", "Something &lt;odd&gt;.", "a.b", "points seen"):
        assert words in text
    assert "nan px" not in text
    assert text == written(tmp_path / "report.html"), "the same page for the same run"


def test_without_images_tracks_are_plotted(tmp_path: Path) -> None:
    text = written(tmp_path / "report.html", without_images(FRAMES))
    assert "dashed: by shape and cameras" in text
    assert "data:image/jpeg" not in text


def test_without_shape(tmp_path: Path) -> None:
    text = written(tmp_path / "report.html", found=replace(FOUND, geometry="none", reason="static"))
    assert "from above" not in text
    assert "undetermined" in text


@pytest.mark.parametrize("frames", [FRAMES, without_images(FRAMES)])
def test_without_any_point(tmp_path: Path, frames: list[Frame]) -> None:
    nothing = replace(
        FOUND,
        positions=np.zeros((12, 0, 2)),
        residuals=np.zeros((12, 0, 2)),
        observed=np.zeros((12, 0), bool),
        shape=np.zeros((0, 3)),
        shape_covariances=np.zeros((0, 3, 3)),
        geometry="none",
        reason="nothing",
    )
    assert "undetermined" in written(tmp_path / "report.html", frames, nothing)


def test_affine_shapes_say_so(tmp_path: Path) -> None:
    text = written(tmp_path / "report.html", found=replace(FOUND, geometry="affine", reason="two views"))
    assert "lengths and angles mean nothing" in text


def test_frames_in_which_nothing_was_seen(tmp_path: Path) -> None:
    observed, residuals = FOUND.observed.copy(), FOUND.residuals.copy()
    observed[4], residuals[4] = False, np.nan
    found = replace(FOUND, observed=observed, residuals=residuals)
    assert np.isnan(found.reprojection_errors[4])
    assert np.isfinite(found.reprojection_error)
    written(tmp_path / "report.html", found=found)


def test_errors_are_those_of_the_residuals() -> None:
    squares = np.square(TRUTH.observed - TRUTH.positions).sum(axis=2)[TRUTH.visible]
    assert FOUND.reprojection_error == pytest.approx(25 * np.sqrt(squares.mean()))
    weights = TRUTH.visible.sum(axis=1)
    mean = np.average(FOUND.reprojection_errors**2, weights=weights)
    assert mean == pytest.approx(FOUND.reprojection_error**2)


def test_seen_points_are_dots_and_predicted_ones_rings() -> None:
    black = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    positions = np.full((1, 2, 2), 20.0)
    positions[0, 1] = 60
    found = replace(
        FOUND,
        positions=positions,
        residuals=np.zeros((1, 2, 2)),
        observed=np.array([[True, False]]),
        shape=np.zeros((2, 3)),
    )
    picture = draw_points(black, found, 0)
    assert picture[20, 20].tolist() == list(identity_colour(0))
    assert not picture[60, 60].any(), "hollow"
    assert picture[56:65, 56:65].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 5000.0])
def test_points_far_outside_are_not_drawn(value: float) -> None:
    black = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    found = replace(FOUND, positions=np.full_like(FOUND.positions, value))
    assert not draw_points(black, found, 11).any()


def test_overlay_is_a_video_of_all_frames(tmp_path: Path) -> None:
    frames = [*FRAMES]
    frames[3] = replace(frames[3], image=None)
    write_overlay(tmp_path / "overlay.mp4", frames, FOUND, 25.0)
    video = cv2.VideoCapture(str(tmp_path / "overlay.mp4"))
    count = 0
    while video.read()[0]:
        count += 1
    assert count == 12
    assert [path.name for path in tmp_path.iterdir()] == ["overlay.mp4"]

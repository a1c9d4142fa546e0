"""Tracks, points and faces drawn on frames, and the video of them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.background.page import view_row_of
from rsmcm.apps.io.tracks import TrackedBox
from rsmcm.apps.view.overlay import (
    DOT,
    LANDMARK,
    LONGEST_SIDE,
    OverlayVideo,
    PointsOverlay,
    TracksOverlay,
    caption,
    css_colour,
    draw_face,
    enlargement,
    identity_colour,
)
from rsmcm.models.core.frame import Frame, GivenBoxes

from ...support.film import frame, read_video

GREY = 90


def blank(height: int = 120, width: int = 160, grey: int = GREY) -> NDArray[np.uint8]:
    return np.full((height, width, 3), grey, np.uint8)


def test_masks_boxes_and_trails() -> None:
    image = np.full((120, 160), 100, np.uint8)
    foreground = np.zeros_like(image)
    foreground[40:80, 40:80] = 255
    before, overlay = image.copy(), TracksOverlay()
    for number, x in ((1, 60.0), (2, 90.0)):
        track = TrackedBox(4, (x, 50.0, 30.0, 40.0))
        given = GivenBoxes(np.array([[130.0, 20, 150, 40]]), np.ones(1))
        picture = overlay(image, view_row_of(foreground, [track], given), number, number / 10, missing=False)
    colour = identity_colour(4)
    np.testing.assert_array_equal(image, before)
    assert picture.shape == (120, 160, 3)
    assert picture[60, 60].tolist() == [60, 60, 160], "tinted"
    assert picture[40, 60].tolist() == [0, 0, 255], "outlined"
    assert tuple(picture[90, 80].tolist()) == colour, "from foot to foot"
    assert tuple(picture[70, 90].tolist()) == colour
    assert picture[30, 130].min() > 180, "of the detector"
    assert picture[110, 10].tolist() == [100, 100, 100]
    far = view_row_of(np.zeros_like(foreground), [TrackedBox(1, (-500.0, -90.0, 9000.0, 3.0))])
    overlay(image, far, 3, 0.3, missing=True)  # is no reason to fail


def test_trails_are_those_of_two_seconds() -> None:
    nothing, overlay, shown = np.zeros((120, 160), np.uint8), TracksOverlay(), []
    for number in range(1, 5):
        box = (20.0 * number, 20.0, 10.0, 40.0)
        row = view_row_of(nothing, [TrackedBox(4, box)])
        picture = overlay(blank(), row, number, float(number), missing=False)
        there = (picture[60] == identity_colour(4)).all(axis=1)
        shown.append(np.flatnonzero(there).min())
    assert np.allclose(shown, [20, 25, 25, 45], atol=1), "of a box alone, and of feet where it was"


def test_seen_points_are_dots_and_predicted_ones_rings() -> None:
    row = {
        "id": np.array([0, 1]),
        "points": np.array([[20.0, 20], [60, 60]]),
        "seen": np.array([True, False]),
    }
    picture = PointsOverlay()(blank(grey=0), row, 1, 0.0, missing=False)
    assert picture[20, 20].tolist() == list(identity_colour(0))
    assert not picture[60, 60].any(), "hollow"
    assert picture[56:65, 56:65].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 5000.0])
def test_points_far_outside_are_not_drawn(value: float) -> None:
    rows = [
        {"id": np.arange(3), "points": np.full((3, 2), at), "seen": np.array([True, True, False])}
        for at in (value, 40.0)
    ]
    far, near = (PointsOverlay()(blank(), row, 1, 0.0, missing=False)[25:] for row in rows)
    assert (far == GREY).all()
    assert (near != GREY).any()


def face_row(points: Any, landmarks: Any = (), lost: bool = False) -> dict[str, NDArray[Any]]:
    held = np.zeros((len(points), 5), np.float32)
    held[:, :2] = points
    return {
        "points": held,
        "landmarks": np.array(landmarks, np.float32).reshape(-1, 2),
        "states": np.array([[lost, False, False]]),
    }


FACE = np.stack(np.meshgrid(np.linspace(120, 200, 5), np.linspace(80, 160, 5)), axis=2).reshape(-1, 2)


@pytest.mark.parametrize("grey", [0, 90, 200, 255])
def test_points_of_a_face_stand_out_from_any_skin(grey: int) -> None:
    picture = draw_face(blank(240, 320, grey), face_row(FACE), 1, 0.0, missing=False)
    assert picture.shape == (480, 640, 3), "enlarged"
    x, y = np.rint(2 * (FACE + 0.5) - 0.5).astype(int).T
    assert (picture[y, x] == DOT).all()
    luma = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(int)
    contrast = cv2.dilate(np.abs(luma - grey).astype(np.uint8), np.ones((9, 9)))
    assert contrast[y, x].min() >= 60
    assert (picture[160:320, 240:400] != grey).any(axis=2).mean() < 0.5, "most of it is left to be seen"


def test_landmarks_are_drawn_where_they_are() -> None:
    landmarks = [[20.0, 100.0], [np.nan, np.nan], [-50.0, 4.0], [1e12, 1.0], [60.5, 30.25]]
    picture = draw_face(blank(240, 320), face_row(FACE, landmarks), 1, 0.0, missing=False)
    found = (picture == np.array(LANDMARK)).all(axis=2).astype(np.uint8)
    count, _, _, centres = cv2.connectedComponentsWithStats(found)
    assert count == 3, "two dots and what is none; missing ones and those far outside are left out"
    expected = 2 * (np.array(landmarks)[[4, 0]] + 0.5) - 0.5
    np.testing.assert_allclose(centres[1:], expected, atol=0.75)  # to whole pixels


def test_lost_is_said() -> None:
    found, lost = (
        draw_face(blank(240, 320), face_row(FACE, lost=lost), 7, 0.0, missing=False) for lost in (False, True)
    )
    differs = (found != lost).any(axis=2)
    assert differs[:100, 200:440].sum() > 500
    assert not differs[120:].any()


def test_identity_colours_are_stable_and_differ() -> None:
    colours = np.array([identity_colour(identity) for identity in range(12)], dtype=float)
    assert ((colours >= 0) & (colours <= 255)).all()
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 999 * np.eye(12)
    assert distances.min() > 40


def test_colours_of_pages() -> None:
    assert css_colour((255, 128, 3)) == "#0380ff", "red first"


def test_captions() -> None:
    assert caption(7, missing=False) == "frame 7"
    assert caption(8, missing=True) == "frame 8 (missing)"


@pytest.mark.parametrize(
    ("height", "width", "scale"), [(240, 320, 2), (480, 640, 1), (16, 16, 30), (1, LONGEST_SIDE, 1)]
)
def test_small_pictures_are_enlarged(height: int, width: int, scale: int) -> None:
    assert enlargement(blank(height, width), 480) == scale


# --- the video ----------------------------------------------------------------------------------------------


def plain(image: NDArray[np.uint8], *_: object, missing: bool) -> NDArray[np.uint8]:
    return image


def test_missing_frames_show_the_one_before(tmp_path: Path) -> None:
    shown: list[NDArray[np.uint8]] = []
    with OverlayVideo(tmp_path / "overlay.mp4", 10, plain, show=shown.append) as video:
        video.add(Frame(None, 0.0, 1), dict)
        video.add(frame(2), dict)
        video.add(Frame(None, 0.2, 3), dict)
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == len(shown) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["overlay.mp4"]


def test_pictures_that_are_only_shown(tmp_path: Path) -> None:
    shown: list[NDArray[np.uint8]] = []
    with OverlayVideo(None, 10, plain, show=shown.append) as video:
        video.add(frame(1), dict)
        video.checkpoint()
    assert len(shown) == 1


def test_an_error_in_the_thread_is_told(tmp_path: Path) -> None:
    def write() -> None:
        with OverlayVideo(tmp_path / "gone" / "overlay.mp4", 10, plain) as video:
            for number in range(1, 4):
                video.add(frame(number), dict)

    with pytest.raises(OSError, match=r"overlay\.mp4"):
        write()

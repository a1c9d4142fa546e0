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
    LANDMARK,
    OverlayVideo,
    PointsOverlay,
    TracksOverlay,
    draw_face,
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


def test_a_trail_is_of_its_own_point() -> None:
    """Whichever points come and go beside it."""

    def row_of(*numbers: int, x: float) -> dict[str, NDArray[Any]]:
        places = np.array([[x, 20.0 * number] for number in numbers])
        return {"id": np.array(numbers), "points": places, "seen": np.ones(len(numbers), np.bool_)}

    one, other, none = (PointsOverlay() for _ in range(3))
    one(blank(grey=0), row_of(1, 2, x=20.0), 1, 0.0, missing=False)
    other(blank(grey=0), row_of(2, x=20.0), 1, 0.0, missing=False)
    beside, alone, new = (
        each(blank(grey=0), row_of(2, 3, x=60.0), 2, 0.04, missing=False) for each in (one, other, none)
    )
    np.testing.assert_array_equal(beside, alone)
    assert alone[40, 40].any()
    assert not new[40, 40].any()


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


def test_landmarks_are_drawn_where_they_are() -> None:
    landmarks = [[20.0, 100.0], [np.nan, np.nan], [-50.0, 4.0], [1e12, 1.0], [60.5, 30.25]]
    picture = draw_face(blank(240, 320), face_row(FACE, landmarks), 1, 0.0, missing=False)
    found = (picture == np.array(LANDMARK)).all(axis=2).astype(np.uint8)
    count, _, _, centres = cv2.connectedComponentsWithStats(found)
    assert count == 3, "two dots and what is none; missing ones and those far outside are left out"
    expected = 2 * (np.array(landmarks)[[4, 0]] + 0.5) - 0.5
    np.testing.assert_allclose(centres[1:], expected, atol=0.75)  # to whole pixels


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


def test_an_error_in_the_thread_is_told(tmp_path: Path) -> None:
    def write() -> None:
        with OverlayVideo(tmp_path / "gone" / "overlay.mp4", 10, plain) as video:
            for number in range(1, 4):
                video.add(frame(number), dict)

    with pytest.raises(OSError, match=r"overlay\.mp4"):
        write()

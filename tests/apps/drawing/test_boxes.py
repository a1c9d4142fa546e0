"""Boxes, trails and masks drawn on frames."""

from pathlib import Path

import numpy as np
from rsmcm.apps.drawing.boxes import OverlayWriter, css_colour, draw_overlay, identity_colour
from rsmcm.models.core.frame import Frame

from ...support.film import Box, boxes, frame, mask, read_video


def test_overlay_marks_masks_boxes_and_trails() -> None:
    image = np.full((120, 160), 100, np.uint8)
    foreground = np.zeros_like(image)
    foreground[40:80, 40:80] = 255
    before = image.copy()
    trails = {4: np.array([[100.0, 100.0], [150.0, 100.0]])}
    track = Box(4, (90.0, 50.0, 30.0, 40.0), 0.9)
    picture = draw_overlay(image, foreground, [track], trails, "frame 1")
    colour = identity_colour(4)
    np.testing.assert_array_equal(image, before)
    assert picture.shape == (120, 160, 3)
    assert picture[60, 60].tolist() == [60, 60, 160]  # tinted
    assert picture[40, 60].tolist() == [0, 0, 255]  # outlined
    assert tuple(picture[100, 130].tolist()) == colour
    assert tuple(picture[70, 90].tolist()) == colour
    assert picture[110, 10].tolist() == [100, 100, 100]
    # An object that leaves the picture, or a box beyond it, is no reason to fail.
    draw_overlay(image, None, [Box(1, (-500.0, -90.0, 9000.0, 3.0), 1.0)], {}, "")


def test_identity_colours_are_stable_and_differ() -> None:
    colours = np.array([identity_colour(identity) for identity in range(12)], dtype=float)
    assert ((colours >= 0) & (colours <= 255)).all()
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 999 * np.eye(12)
    assert distances.min() > 40


def test_missing_frames_show_the_one_before(tmp_path: Path) -> None:
    with OverlayWriter(tmp_path / "overlay.mp4", 10) as writer:
        writer.add(Frame(None, 0.0, 1), None, [])
        writer.add(frame(2), mask(2), [])
        writer.add(Frame(None, 0.2, 3), None, boxes(3))
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == 2


def test_colours_of_pages() -> None:
    assert css_colour((255, 128, 3)) == "#0380ff", "red first"

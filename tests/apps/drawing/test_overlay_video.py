"""A video that is drawn in a thread."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.drawing.overlay_video import OverlayVideo, caption
from rsmcm.models import Frame

PICTURE = np.full((48, 64, 3), 90, np.uint8)


def write(path: Path, n_frames: int) -> None:
    with OverlayVideo(path, 25.0) as video:
        for number in range(1, n_frames + 1):
            video.write(Frame(None if number == 3 else PICTURE, number / 25, number), lambda: PICTURE)


def test_a_video_of_all_frames(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    write(path, 5)
    assert [each.name for each in tmp_path.iterdir()] == ["overlay.mp4"]
    film = cv2.VideoCapture(str(path))
    assert sum(iter(lambda: film.read()[0], False)) == 5


def test_an_error_in_the_thread_is_told(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"overlay\.mp4"):
        write(tmp_path / "gone" / "overlay.mp4", 3)


def test_captions() -> None:
    assert caption(Frame(PICTURE, 0.0, 7)) == "frame 7"
    assert caption(Frame(None, 0.0, 8)) == "frame 8 (missing)"

"""Frames with the points that a detector finds."""

import numpy as np
import pytest
from rsmcm.apps.io import with_keypoints
from rsmcm.models import Frame

IMAGE = np.zeros((40, 60, 3), np.uint8)
FRAMES = [Frame(None if number == 4 else IMAGE, 0.1 * number, number) for number in range(1, 9)]


def test_a_detector_is_called_with_every_frame_that_has_an_image() -> None:
    called = []

    def detector(frame: Frame) -> object:
        called.append(frame.number)
        return None if frame.number == 2 else {"left_wrist": (frame.number, 5)}

    frames = list(with_keypoints(FRAMES, detector))
    assert called == [1, 2, 3, 5, 6, 7, 8]
    assert [frame.keypoints is None for frame in frames] == [number in (2, 4) for number in range(1, 9)]
    assert frames[6].keypoints is not None
    assert frames[6].keypoints.positions[0, 8].tolist() == [7, 5]
    assert frames[6].image is FRAMES[6].image
    third = list(with_keypoints(FRAMES, lambda _: [], every=3))
    assert [frame.number for frame in third if frame.keypoints is not None] == [1, 5, 8]


def test_what_a_detector_returns_wrongly_is_said() -> None:
    with pytest.raises(ValueError, match=r"frame 1: keypoints: got \(1, 2, 3\), expected"):
        list(with_keypoints(FRAMES, lambda _: np.zeros((2, 3))))
    with pytest.raises(TypeError, match="detector: got list, expected something to call"):
        with_keypoints(FRAMES, [])  # type: ignore[arg-type]

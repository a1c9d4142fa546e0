"""Frames with what a detector finds in them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io import with_boxes
from rsmcm.models.core.frame import Frame, GivenBoxes

IMAGE = np.zeros((40, 60, 3), np.uint8)
FRAMES = [Frame(None if number == 4 else IMAGE, 0.1 * number, number) for number in range(1, 9)]


@dataclass
class Detections:
    """As the library supervision has them."""

    xyxy: NDArray[np.float32]
    mask: NDArray[np.bool_] | None = None
    confidence: NDArray[np.float32] | None = None
    class_id: NDArray[np.int64] | None = None
    tracker_id: NDArray[np.int64] | None = None
    data: dict[str, Any] = field(default_factory=dict)


def test_a_detector_is_called_with_every_frame_that_has_an_image() -> None:
    called = []

    def detector(frame: Frame) -> NDArray[np.float64] | None:
        called.append(frame.number)
        return None if frame.number == 2 else np.array([[1.0, 2, 3 + frame.number, 5]])

    frames = list(with_boxes(FRAMES, detector))
    assert called == [1, 2, 3, 5, 6, 7, 8]
    assert [frame.number for frame in frames] == list(range(1, 9))
    assert [frame.boxes is None for frame in frames] == [number in (2, 4) for number in range(1, 9)]
    assert frames[6].boxes is not None
    assert frames[6].boxes.xyxy.tolist() == [[1, 2, 10, 5]]
    assert frames[6].image is FRAMES[6].image


def test_a_detector_can_run_on_every_third_frame() -> None:
    """A missing frame is none of those that are counted."""
    frames = list(with_boxes(FRAMES, lambda _: [], every=3))
    assert [frame.number for frame in frames if frame.boxes is not None] == [1, 5, 8]
    assert all(len(frame.boxes) == 0 for frame in frames if frame.boxes is not None)


def supervision_like() -> Detections:
    return Detections(
        np.array([[1, 2, 3, 4], [5, 5, 9, 9]], np.float32),
        np.zeros((2, 40, 60), bool),
        np.array([0.5, 0.75], np.float32),
        np.array([0, 2]),
        None,
        {"class_name": np.array(["person", "car"])},
    )


@pytest.mark.parametrize(
    ("found", "n_boxes", "confidence", "classes"),
    [
        (np.array([[1.0, 2, 3, 4]]), 1, None, None),
        ([[1, 2, 3, 4, 0.5]], 1, [0.5], None),
        (np.array([[1, 2, 3, 4, 0.5, 7]], np.float32), 1, [0.5], [7]),
        (np.zeros((0, 6)), 0, None, None),
        ([], 0, None, None),
        (supervision_like(), 2, [0.5, 0.75], ["person", "car"]),
        (Detections(np.empty((0, 4), np.float32)), 0, None, None),
        (Detections(np.array([[0, 0, 1, 1]]), class_id=np.array([3])), 1, None, [3]),
        (GivenBoxes(np.array([[0.0, 0, 1, 1]]), np.array([0.25])), 1, [0.25], None),
    ],
)
def test_boxes_come_in_many_forms(found: Any, n_boxes: int, confidence: Any, classes: Any) -> None:
    (frame,) = with_boxes(FRAMES[:1], lambda _: found)
    boxes = frame.boxes
    assert boxes is not None
    assert boxes.xyxy.shape == (n_boxes, 4)
    assert boxes.xyxy.dtype == np.float64
    for values, expected in ((boxes.confidence, confidence), (boxes.classes, classes)):
        assert (None if values is None else values.tolist()) == expected


@pytest.mark.parametrize(
    ("found", "complaint"),
    [
        (np.zeros((2, 3)), r"frame 1: boxes: got \(2, 3\), expected \(n, 4\), \(n, 5\) or \(n, 6\)"),
        ("boxes", "frame 1: boxes: got str, expected an array"),
        (np.array([[5.0, 0, 5, 9]]), "frame 1: boxes: got 5, 0, 5, 9 as box 0"),
        (np.array([[5.0, 0, np.nan, 9]]), "frame 1: boxes: got 5, 0, nan, 9 as box 0"),
    ],
)
def test_what_a_detector_returns_wrongly_is_said(found: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        list(with_boxes(FRAMES, lambda _: found))


def test_what_is_no_frame() -> None:
    with pytest.raises(TypeError, match="frames: got ndarray, expected Frame"):
        next(with_boxes([IMAGE], lambda _: None))  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("arguments", "error", "complaint"),
    [
        ((np.zeros((1, 4)),), TypeError, "detector: got ndarray, expected something to call with a frame"),
        ((lambda _: None, 0), ValueError, "every: got 0"),
    ],
)
def test_what_is_no_detector(
    arguments: tuple[Callable[..., Any], int], error: type[Exception], complaint: str
) -> None:
    with pytest.raises(error, match=complaint):
        with_boxes(FRAMES, *arguments)

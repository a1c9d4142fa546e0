"""Frames, and what somebody else has found in them."""

import re
from typing import Any

import numpy as np
import pytest
from rsmcm.models import Frame, GivenBoxes


def test_a_frame_of_boxes_alone_is_not_missing() -> None:
    nothing = GivenBoxes(np.zeros((0, 4)))
    assert len(nothing) == 0
    assert not Frame(None, 0.0, 1, boxes=nothing).missing
    assert Frame(None, 0.0, 1).missing


@pytest.mark.parametrize(
    ("xyxy", "confidence", "complaint"),
    [
        (np.zeros((2, 3)), None, r"xyxy: got shape \(2, 3\)"),
        (np.array([[0.0, 0, 5, 5], [5, 5, 5, 9]]), None, "as box 1"),
        (np.array([[0.0, 0, np.nan, 5]]), None, "as box 0"),
        (np.array([[0.0, 0, 5, 5]]), np.ones(2), r"confidence: got shape \(2,\)"),
        (np.array([[0.0, 0, 5, 5]]), np.array([np.nan]), "a confidence beyond"),
    ],
)
def test_boxes_that_cannot_be_are_refused_in_one_line(xyxy, confidence, complaint) -> None:
    with pytest.raises(ValueError, match=complaint):
        GivenBoxes(xyxy, confidence)


class Boxes:
    """As Ultralytics has them."""

    xyxy = np.array([[1, 2, 3, 4]], np.float32)
    conf = np.array([0.5], np.float32)
    cls = np.array([3.0], np.float32)
    data = np.array([[1, 2, 3, 4, 0.5, 3]], np.float32)


def test_boxes_of_other_libraries_keep_scores_and_classes() -> None:
    taken = GivenBoxes.of(Boxes())
    assert taken.confidence is not None
    assert taken.classes is not None
    assert (taken.confidence.tolist(), taken.classes.tolist()) == ([0.5], [3])
    assert taken.confidence.dtype == np.float64
    assert taken.classes.dtype == np.int64
    assert GivenBoxes.of(taken) is taken


def test_outlines_of_another_size_than_the_picture_are_refused() -> None:
    boxes = GivenBoxes(np.array([[0.0, 0, 5, 5]]), masks=np.zeros((1, 10, 12), bool))
    Frame(np.zeros((10, 12), np.uint8), 0.0, 1, boxes=boxes)
    with pytest.raises(ValueError, match=r"got masks \(10, 12\) at frame 3, expected \(12, 10\)"):
        Frame(np.zeros((12, 10), np.uint8), 0.0, 3, boxes=boxes)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"image": [[1, 2]]}, "image: got [[1, 2]], expected an array of uint8 or None"),
        ({"image": np.zeros((0, 5), np.uint8)}, "image: got shape (0, 5) at frame 1, expected pixels"),
        ({"time": np.nan}, "time: got nan, expected a finite number"),
        ({"time": "0"}, "time: got '0', expected a number"),
        ({"number": 1.5}, "number: got 1.5, expected a whole number"),
        (
            {"boxes": np.zeros((1, 4))},
            "boxes: got an array of float64 of shape (1, 4), expected a GivenBoxes or None",
        ),
    ],
)
def test_a_frame_of_wrong_parts_is_refused(wrong: dict[str, Any], expected: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(expected)}$"):
        Frame(**{"image": None, "time": 0.0, "number": 1, **wrong})

"""Frames, and what somebody else has found in them."""

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
        (np.zeros((2, 3)), None, r"got \(2, 3\)"),
        (np.array([[0.0, 0, 5, 5], [5, 5, 5, 9]]), None, "as box 1"),
        (np.array([[0.0, 0, np.nan, 5]]), None, "as box 0"),
        (np.array([[0.0, 0, 5, 5]]), np.ones(2), r"got confidence \(2,\) for 1 boxes"),
        (np.array([[0.0, 0, 5, 5]]), np.array([np.nan]), "confidence that is not finite"),
    ],
)
def test_boxes_that_cannot_be_are_refused_in_one_line(xyxy, confidence, complaint) -> None:
    with pytest.raises(ValueError, match=complaint):
        GivenBoxes(xyxy, confidence)

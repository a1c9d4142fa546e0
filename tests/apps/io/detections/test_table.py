"""Detections by frame, and whether they can be of a film."""

from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.io import Detections, read_detections
from rsmcm.models.core.frame import Frame


@pytest.fixture
def detections(tmp_path: Path) -> Detections:
    path = tmp_path / "det.txt"
    path.write_text("1,-1,1,1,10,10,1\n1,-1,91,41,20,20,1\n3,-1,-8,1,10,10,1\n5,-1,1,1,10,10,1\n")
    return read_detections(path)


def test_boxes_are_those_of_the_frames_number(detections: Detections) -> None:
    image = np.zeros((50, 100), np.uint8)
    counts = [detections(Frame(image, 0.1 * number, number)) for number in range(1, 7)]
    assert [None if boxes is None else len(boxes) for boxes in counts] == [2, None, 1, None, 1, None]
    assert detections.counted(range(1, 4)) == {"boxes": 3, "frames": 2}


def test_boxes_that_reach_out_of_the_picture_are_of_it(detections: Detections) -> None:
    detections.check("film", (100, 50), 5)
    detections.check("film", (100, 50), None)


@pytest.mark.parametrize(
    ("size", "last", "complaint"),
    [
        (
            (90, 50),
            5,
            r"line 2: got a box from 90, 40, 110, 60 .* in frame 1, outside of the picture of 90x50",
        ),
        ((100, 40), 5, r"line 2: got a box from 90, 40, 110, 60"),
        ((100, 50), 4, r"det\.txt, line 4: got frame 5, but film has 4 frames"),
    ],
)
def test_boxes_of_another_film(
    detections: Detections, size: tuple[int, int], last: int, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        detections.check("film", size, last)


def test_frames_without_a_box_can_be_beyond_the_film(tmp_path: Path) -> None:
    path = tmp_path / "coco.json"
    path.write_text('{"images": [{"id": 1, "file_name": "a9.png"}], "annotations": []}')
    with pytest.raises(ValueError, match=r"coco\.json: got frame 9, but film has 8 frames"):
        read_detections(path).check("film", (100, 50), 8)

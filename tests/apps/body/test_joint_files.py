"""Clicked joints as people give them."""

from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.body.joint_files import read_joints
from rsmcm.models.body.upper_body import JOINTS

HEADER = "frame,joint,x,y\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "joints.csv"
    path.write_text(text)
    return path


def test_joints_of_some_frames(tmp_path: Path) -> None:
    text = "\ufeffFrame, joint ,x,y\n12,head,5,6.5\n\n3, left_hand ,1e2,-4\n12,right_elbow,0,0\n"
    clicked = read_joints(write(tmp_path, text))
    assert clicked.frames.tolist() == [3, 12]
    expected = np.full((2, 8, 2), np.nan)
    expected[0, JOINTS.index("left_hand")] = 100, -4
    expected[1, JOINTS.index("head")] = 5, 6.5
    expected[1, JOINTS.index("right_elbow")] = 0, 0
    np.testing.assert_array_equal(clicked.places, expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: got columns '', expected frame, joint, x, y"),
        (HEADER, "holds no joint, expected some of head, neck, left_shoulder"),
        (f"{HEADER}1,head,5\n", "line 2: got 3 columns, expected y"),
        (f"{HEADER}1,head,5,6\n1,nose,5,6\n", "line 3: got the joint 'nose', expected one of head"),
        (f"{HEADER}0,head,5,6\n", "got frame 0, expected a whole number from 1"),
        (f"{HEADER}1,head,5,\n", "got y '', expected a number"),
        (f"{HEADER}1,head,nan,6\n", "got x 'nan', expected a number"),
        (f"{HEADER}1,head,5,-1e9\n", "got head at 5, -1e+09, expected px up to 1e+07"),
        (f"{HEADER}1,head,5,6\n1,head,7,8\n", "line 3: got head of frame 1 a second time"),
    ],
)
def test_wrong_joints(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ValueError, match=r"joints\.csv") as raised:
        read_joints(write(tmp_path, text))
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)

"""Clicked joints as people give them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from rsmcm.apps.body.joint_files import read_joints
from rsmcm.models.body.upper_body import JOINTS


def write(folder: Path, text: str) -> Path:
    path = folder / "joints.csv"
    path.write_text(text)
    return path


def test_joints_of_some_frames(tmp_path: Path) -> None:
    clicked = read_joints(
        write(
            tmp_path,
            "\ufeffFrame, joint ,x,y\n12,head,5,6.5\n\n3, left_hand ,1e2,-4\n12,right_elbow,0,0\n ,,, \n",
        )
    )
    assert clicked.frames.tolist() == [3, 12]
    expected = np.full((2, 8, 2), np.nan)
    expected[0, JOINTS.index("left_hand")] = 100, -4
    expected[1, JOINTS.index("head")] = 5, 6.5
    expected[1, JOINTS.index("right_elbow")] = 0, 0
    np.testing.assert_array_equal(clicked.places, expected)


places = st.floats(-1e6, 1e6, allow_nan=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "joints.csv, line 0: got the columns '', expected a CSV file frame,joint,x,y"),
        ("1,head,5,6\n", "got the columns '1,head,5,6', expected a CSV file frame,joint,x,y"),
        ("frame,joint,x,y\n", "holds no joint, expected some of head, neck, left_shoulder"),
        ("frame,joint,x,y\n1,head,5\n", "joints.csv, line 2: got 3 values, expected frame,joint,x,y"),
        ("frame,joint,x,y\n1,head,5,6\n1,nose,5,6\n", "line 3: got the joint 'nose', expected one of head"),
        ("frame,joint,x,y\n0,head,5,6\n", "got the frame '0', expected a number from 1"),
        ("frame,joint,x,y\n1.5,head,5,6\n", "got the frame '1.5', expected a number from 1"),
        ("frame,joint,x,y\n-1,head,5,6\n", "got the frame '-1'"),
        (f"frame,joint,x,y\n{2**63},head,5,6\n", "got the frame '9223372036854775808', expected a number"),
        (f"frame,joint,x,y\n{'9' * 5000},head,5,6\n", "got the frame '9999"),
        ("frame,joint,x,y\n1,head,5,6" + "9" * 10**6, "line 2: field larger than"),
        ("frame,joint,x,y\n" + "1,head,5,6\n" * 10**5, "got more than 1048576 bytes, expected"),
        ("frame,joint,x,y\n1,head,5,\n", "got the place '5', '', expected numbers of px"),
        ("frame,joint,x,y\n1,head,nan,6\n", "got the place nan, 6, expected finite px up to 1e+07"),
        ("frame,joint,x,y\n1,head,5,-inf\n", "got the place 5, -inf, expected finite px"),
        ("frame,joint,x,y\n1,head,5,1e9\n", "got the place 5, 1e9, expected finite px"),
        ("frame,joint,x,y\n1,head,5,6\n1,head,7,8\n", "line 3: got head of frame 1 a second time"),
        ("frame,joint,x,y\n1,head,5,6,7\n", "got 5 values"),
    ],
)
def test_wrong_joints(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ValueError, match=r"joints\.csv") as raised:
        read_joints(write(tmp_path, text))
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_joints(tmp_path / "nowhere.csv")
    picture = tmp_path / "picture.csv"
    picture.write_bytes(bytes(range(255, -1, -1)) * 4)
    with pytest.raises(ValueError, match=r"picture\.csv: got binary data, expected a CSV file frame"):
        read_joints(picture)

"""Files of keypoints: every form says the same, and what is wrong with one is a line that says where."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.io import Keypoints, read_keypoints, with_keypoints
from rsmcm.models import Frame
from rsmcm.models.core.frame import COCO, KEYPOINTS, SKELETONS

NUMBERS = (1, 2, 5)
"""Frames in which there are two persons."""


def place(frame: int, person: int, name: str) -> tuple[float, float, float]:
    """Where a point is, and its score; the second person's left wrist is not found."""
    if person == 1 and name == "left_wrist":
        return 0.0, 0.0, 0.0
    kind = sum(map(ord, name)) % 50
    return 20.5 + kind + frame, 30.25 + 2 * kind + 10 * person, 0.5 + 0.25 * person


def csv_of(folder: Path) -> Path:
    path = folder / "k.csv"
    lines = ["frame,person,joint,x,y,score"]
    for frame in NUMBERS:
        for person in (0, 1):
            lines += [
                f"{frame},{person},{name},{','.join(map(str, place(frame, person, name)))}" for name in COCO
            ]
    path.write_text("\n".join(lines))
    return path


def coco_of(folder: Path) -> Path:
    path = folder / "k.json"
    results = [
        {
            "image_id": frame,
            "category_id": 1,
            "keypoints": [number for name in COCO for number in place(frame, person, name)],
            "score": 0.9,
        }
        for frame in NUMBERS
        for person in (0, 1)
    ]
    path.write_text(json.dumps(results))
    return path


def openpose_of(folder: Path, names: tuple[str, ...] = SKELETONS[25], hand: bool = False) -> Path:
    """As OpenPose numbers frames, from 0; a frame without anybody has a file, too."""
    path = folder / "json"
    path.mkdir()
    for frame in range(1, 8):
        people: list[dict[str, Any]] = []
        for person in (0, 1) if frame in NUMBERS else ():
            body = [n for name in names for n in (place(frame, person, name) if name in COCO else (0, 0, 0))]
            fingers = [n for k in range(21) for n in (k, 2 * k, 0.5 if k % 2 else 0)]
            people.append({"person_id": [-1], "pose_keypoints_2d": body})
            people[-1]["hand_left_keypoints_2d"] = fingers if hand else []
        (path / f"film_{frame - 1:012d}_keypoints.json").write_text(
            json.dumps({"version": 1.3, "people": people})
        )
    return path


@pytest.mark.parametrize("write", [csv_of, coco_of, openpose_of])
def test_every_form_says_the_same(write: Any, tmp_path: Path) -> None:
    found = read_keypoints(write(tmp_path))
    assert found.frame.tolist() == [1, 1, 2, 2, 5, 5]
    assert found.counted([1, 5, 6]) == {"persons": 4, "frames": 2}
    for number in range(1, 8):
        given = found.at(number)
        if number not in NUMBERS:
            assert given is None
            continue
        assert given is not None
        assert found(Frame(None, 0.0, number)) is not None
        for person in (0, 1):
            for row, name in enumerate(KEYPOINTS):
                if name not in COCO:
                    continue
                x, y, score = place(number, person, name)
                assert given.scores[person, row] == score
                if score:
                    assert given.positions[person, row].tolist() == [x, y]
    found.check("film", (200, 200), 5)


def test_hands_of_openpose_are_the_mean_of_their_points(tmp_path: Path) -> None:
    given = read_keypoints(openpose_of(tmp_path, SKELETONS[18], hand=True)).at(2)
    assert given is not None
    np.testing.assert_allclose(given.positions[0, KEYPOINTS.index("left_hand")], [10, 20])
    assert given.scores[0, KEYPOINTS.index("left_hand")] == 0.5
    assert np.isnan(given.positions[0, KEYPOINTS.index("right_hand")]).all()


def test_pictures_are_told_by_their_names(tmp_path: Path) -> None:
    folder, names = openpose_of(tmp_path), [f"film_{number:012d}.png" for number in range(7)]
    assert read_keypoints(folder, pictures=names).frame.tolist() == [1, 1, 2, 2, 5, 5]
    path = tmp_path / "k.json"
    path.write_text(json.dumps([{"image_id": names[3], "keypoints": [9.0] * 51}]))
    assert read_keypoints(path, pictures=names).frame.tolist() == [4]
    with pytest.raises(ValueError, match=r"json, file 6: got image '.*5', expected a picture of the film"):
        read_keypoints(folder, pictures=names[:5])


def test_columns_in_any_order_and_names_as_others_write_them(tmp_path: Path) -> None:
    path = tmp_path / "k.csv"
    path.write_text("Y;X;Landmark;Frame\n5;4;LEFT_WRIST;3\n;;NOSE;3\n1;1;left_heel;3\n")
    given = read_keypoints(path).at(3)
    assert given is not None
    assert given.positions[0, KEYPOINTS.index("left_wrist")].tolist() == [4, 5]
    assert given.scores.sum() == 1


HEADER = "frame,joint,x,y,score\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "holds nothing, expected CSV"),
        ("frame,x,y\n", "line 1: got columns 'frame, x, y"),
        (HEADER, "holds no point of an upper body"),
        (HEADER + "1,left_knee,1,1,1", "holds no point of an upper body"),
        (HEADER + "1,paw,1,1,1", "line 2: got joint 'paw', expected one of head"),
        (HEADER + "1,neck,1e300,1,1", r"line 2: got neck at 1e\+300, 1, expected px up to"),
        (HEADER + "1,neck,1,1,1\n1,neck,2,1,1", "line 3: got neck of frame 1 a second time"),
        ("[", "line 1: got no JSON, or a part of it"),
        ('[{"image_id": 1, "keypoints": 3}]', "result 1: got 3, expected x, y and score of 17 points"),
        ('[{"image_id": 1, "keypoints": [1, 2]}]', "result 1: got 2 numbers"),
        (json.dumps([{"image_id": 1, "keypoints": ["a"] * 51}]), "result 1: got .*, expected numbers"),
        (json.dumps([{"image_id": 0, "keypoints": [1] * 51}]), "result 1: got image '0'"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "found"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_keypoints(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("a_keypoints.json", '{"people": []}', "a name without a number"),
        ("a_1_keypoints.json", "{", "got no JSON, or a part of it"),
        ("a_1_keypoints.json", "[]", r"got \[\], expected the JSON of OpenPose"),
        ("a_1_keypoints.json", '{"people": [1]}', "person 1: got 1, expected an object with pose_keypoints"),
        ("a_1_keypoints.json", '{"people": [{"pose_keypoints_2d": [1]}]}', "person 1: got 1 numbers"),
        ("a_1_keypoints.json", '{"people": []}', "holds no point of an upper body"),
        ("a.json", "{}", "got no file NAME_keypoints.json"),
    ],
)
def test_what_is_wrong_with_a_folder(name: str, text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_keypoints(tmp_path)
    assert str(tmp_path) in str(caught.value)


def keypoints_at(folder: Path, *places: tuple[int, float, float]) -> Keypoints:
    path = folder / "k.csv"
    path.write_text(HEADER + "".join(f"{frame},neck,{x},{y},1\n" for frame, x, y in places))
    return read_keypoints(path)


def test_points_must_be_of_the_film(tmp_path: Path) -> None:
    found = keypoints_at(tmp_path, (1, 50, 20), (9, 60, 20))
    found.check("film", (100, 50), None)
    found.check("film", (100, 50), 9)
    with pytest.raises(ValueError, match=r"k.csv, line 3: got frame 9, but film has 8 frames"):
        found.check("film", (100, 50), 8)
    with pytest.raises(
        ValueError, match=r"line 3: got a person in frame 9 of whom nothing is in the picture"
    ):
        found.check("film", (55, 50), 9)
    with pytest.raises(ValueError, match="got places from 0 to 1, expected px"):
        keypoints_at(tmp_path, (1, 0.5, 0.25)).check("film", (55, 50), 9)


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

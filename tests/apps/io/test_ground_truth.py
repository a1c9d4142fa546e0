"""Ground truth is read in every form it comes in, and refused in one line when it is broken."""

import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.io.ground_truth import (
    FOREGROUND,
    OUTSIDE,
    BoxTruth,
    Kind,
    MaskTruth,
    common_frames,
    read_ground_truth,
)
from rsmcm.models.files import MOST_TEXT

MOT15 = "2,7,11,21,30,80,1,3,4,0\n1,9,499.2,157.69,31.03,75.17,1,-1,-1,-1\n1,4,5,6,7,8,0,-1,-1,-1\n"
MOT16 = (
    "1,1,11,21,30,80,1,1,1\n1,2,1,1,50,40,1,3,0.5\n1,3,1,1,5,4,1,8,1\n1,4,1,1,5,4,0,1,1\n1,5,1,1,9,9,1,7,1\n"
)


def write(folder: Path, text: str) -> Path:
    path = folder / "gt.txt"
    path.write_text(text)
    return path


def boxes(path: Path) -> BoxTruth:
    truth = read_ground_truth(path)
    assert isinstance(truth, BoxTruth)
    return truth


def masks(path: Path) -> MaskTruth:
    truth = read_ground_truth(path)
    assert isinstance(truth, MaskTruth)
    return truth


def test_mot15_is_sorted_zero_based_and_holds_pedestrians(tmp_path: Path) -> None:
    truth = boxes(write(tmp_path, MOT15))
    assert truth.frame.tolist() == [1, 1, 2]
    assert truth.identity.tolist() == [4, 9, 7]
    assert truth.kind.tolist() == [Kind.IGNORED, Kind.PEDESTRIAN, Kind.PEDESTRIAN]
    np.testing.assert_allclose(truth.box[1], [498.2, 156.69, 31.03, 75.17])
    assert truth.frames == range(1, 3)


def test_mot16_classes_tell_pedestrians_from_vehicles(tmp_path: Path) -> None:
    kinds = boxes(write(tmp_path, MOT16)).kind.tolist()
    assert kinds == [Kind.PEDESTRIAN, Kind.VEHICLE, Kind.IGNORED, Kind.IGNORED, Kind.PEDESTRIAN]


def test_boxes_of_one_frame(tmp_path: Path) -> None:
    truth = boxes(write(tmp_path, "1,1,1,1,9,9\n3,1,2,2,9,9\n3,2,3,3,9,9\n"))
    assert [truth.at(number).identity.tolist() for number in (0, 1, 2, 3, 4)] == [[], [1], [], [1, 2], []]


@pytest.mark.parametrize("name", ["gt/gt.txt", "gt.txt"])
def test_folder_of_boxes(tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(MOT15)
    assert len(boxes(tmp_path).frame) == 3


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "holds no boxes"),
        ("1,1,1,1,5,5\nhello\n", "line 2: got 'hello'"),
        ("0,1,1,1,5,5\n", "frame 0"),
        ("1,1,1,1,0,5\n", "positive size"),
        ("1,1,1,1,5,1e300\n", "px up to 1e\\+07"),
        ("1,1,1,1,5,5\n1e300,1,1,1,5,5\n", "line 2: got frame 1e\\+300, .* frames from 1 to 1000000000"),
        ("1,1,1,1,5,5\n1,1,2,2,5,5\n", "identity 1 occurs twice in frame 1"),
    ],
)
def test_broken_boxes_are_named(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint) as caught:
        read_ground_truth(write(tmp_path, text))
    assert "gt.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def cdnet(folder: Path, numbers: range, temporal: str | None = None, region: bool = False) -> Path:
    (folder / "groundtruth").mkdir()
    picture = np.zeros((4, 6), np.uint8)
    picture[1:3, 1:4] = FOREGROUND
    for number in numbers:
        cv2.imwrite(str(folder / f"groundtruth/gt{number:06d}.png"), picture)
    if temporal is not None:
        (folder / "temporalROI.txt").write_text(temporal)
    if region:
        inside = np.full((4, 6), 255, np.uint8)
        inside[:, 3:] = 0
        cv2.imwrite(str(folder / "ROI.bmp"), inside)
    return folder


def test_masks_with_regions_of_interest(tmp_path: Path) -> None:
    truth = masks(cdnet(tmp_path, range(1, 10), "4 6\n", region=True))
    assert truth.frames == [4, 5, 6]
    labels = truth.labels(5)
    assert (labels[:, 3:] == OUTSIDE).all()
    assert (labels[1:3, 1:3] == FOREGROUND).all()
    with pytest.raises(KeyError):
        truth.labels(9)


@pytest.mark.parametrize(
    ("masks_of", "pictures", "place_of_7"),
    [(range(3), range(3), None), (range(4, 9), range(10), 8), ([7], range(5, 9), 3), ([7], [2, 7, 9], 2)],
)
def test_a_mask_belongs_to_the_picture_of_its_number(
    tmp_path: Path, masks_of: range, pictures: range, place_of_7: int | None
) -> None:
    """Frames are counted from 1, whatever number the first picture has."""
    cdnet(tmp_path, masks_of)
    (tmp_path / "input").mkdir()
    for number in pictures:
        (tmp_path / f"input/in{number:06d}.jpg").touch()
    found = {path.name: frame for frame, path in masks(tmp_path).files.items()}
    assert found.get("gt000007.png") == place_of_7
    assert len(found) == len(set(masks_of) & set(pictures))


def test_masks_of_other_pictures_are_refused(tmp_path: Path) -> None:
    cdnet(tmp_path, range(1, 4))
    (tmp_path / "input").mkdir()
    (tmp_path / "input/in000009.jpg").touch()
    with pytest.raises(ValueError, match="holds no mask of a picture in input, by its number"):
        read_ground_truth(tmp_path)


def test_broken_masks_are_named(tmp_path: Path) -> None:
    cdnet(tmp_path, range(1, 4), "1 x")
    with pytest.raises(ValueError, match=r"temporalROI\.txt"):
        read_ground_truth(tmp_path)
    (tmp_path / "temporalROI.txt").write_text("7 9")
    with pytest.raises(ValueError, match="frames 7 to 9"):
        read_ground_truth(tmp_path)
    (tmp_path / "temporalROI.txt").write_text("1 9")
    (tmp_path / "groundtruth/gt000002.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"gt000002\.png: not a readable picture"):
        masks(tmp_path).labels(2)
    cv2.imwrite(str(tmp_path / "ROI.bmp"), np.full((5, 5), 255, np.uint8))
    with pytest.raises(ValueError, match="ROI"):
        masks(tmp_path).labels(1)


def test_common_frames(tmp_path: Path) -> None:
    truth = boxes(write(tmp_path, "3,1,1,1,9,9\n8,1,2,2,9,9\n"))
    assert list(common_frames(truth, range(1, 6))) == [3, 4, 5]
    with pytest.raises(ValueError, match="annotates frames 3 to 8, but frames 10 to 12 were processed"):
        common_frames(truth, range(10, 13))
    with pytest.raises(ValueError, match="no frame"):
        common_frames(truth, range(0))


def archive(path: Path, members: dict[str, str | bytes], how: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", how) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def test_a_zip_of_cvat_counts_pixels_from_0_and_has_labels(tmp_path: Path) -> None:
    lines = "1,1,10,20,30,80,1,1,1\n1,2,0,0,50,40,1,2,0.5\n2,1,1,1,5,4,1,3,1\n3,1,1,1,5,4,0,1,1\n"
    members = {"gt/gt.txt": lines, "gt/labels.txt": "Somebody\ncar\nreflection\n"}
    truth = boxes(archive(tmp_path / "task.zip", members))
    assert truth.kind.tolist() == [Kind.PEDESTRIAN, Kind.VEHICLE, Kind.IGNORED, Kind.IGNORED]
    np.testing.assert_array_equal(truth.box[:2], [[10, 20, 30, 80], [0, 0, 50, 40]])
    usual = boxes(archive(tmp_path / "usual.zip", {"gt.txt": lines}))
    assert usual.kind.tolist() == [Kind.PEDESTRIAN, Kind.PEDESTRIAN, Kind.VEHICLE, Kind.IGNORED]


@pytest.mark.parametrize(
    ("members", "wrong"),
    [
        ({"a.txt": ""}, "got members 'a.txt', expected CVAT's MOT 1.1"),
        ({"gt/gt.txt": ""}, "gt/gt.txt: holds no boxes"),
        ({"gt/gt.txt": "1,1,1,1,0,5\n"}, "gt/gt.txt, line 1: got a box of 0 x 5"),
        ({"gt/gt.txt": bytes(MOST_TEXT + 1)}, "got gt/gt.txt of more than"),
    ],
)
def test_a_zip_of_something_else_is_named(
    tmp_path: Path, members: dict[str, str | bytes], wrong: str
) -> None:
    with pytest.raises(ValueError, match=rf"task\.zip.*({wrong})"):
        read_ground_truth(archive(tmp_path / "task.zip", members))

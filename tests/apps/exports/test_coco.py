"""COCO JSON, read back by COCO's own code."""

import json
from pathlib import Path

import numpy as np
from pycocotools.coco import COCO
from rsmcm.apps.exports import FinishedRun, read_tracks_table, to_coco
from rsmcm.apps.exports.object_masks import object_masks
from rsmcm.apps.io import read_detections

from ...conftest import Command


def test_coco_reads_boxes_identities_and_masks(background: Path, tmp_path: Path) -> None:
    path = tmp_path / "coco.json"
    said = to_coco(background, path)
    coco = COCO(path)
    table = read_tracks_table(background)
    assert said == f"29 images, {len(table['id'])} boxes, {len(table['id'])} masks"
    frames = {frame.number: frame for frame in FinishedRun.of(background).frames()}
    assert coco.getImgIds() == list(frames)
    assert coco.loadImgs([5])[0]["file_name"] == "in000005.png"
    assert [each["name"] for each in coco.loadCats(coco.getCatIds())] == ["object"]
    assert len(coco.anns) == len(table["id"]) > 20
    for number, frame in frames.items():
        annotations = coco.loadAnns(coco.getAnnIds(imgIds=[number]))
        assert [each["track_id"] for each in annotations] == [track.identity for track in frame.tracks]
        assert [each["bbox"] for each in annotations] == [list(track.box) for track in frame.tracks]
        assert [each["score"] for each in annotations] == [track.confidence for track in frame.tracks]
        assert frame.foreground is not None
        boxes = np.reshape([track.box for track in frame.tracks], (-1, 4))
        for annotation, mask in zip(annotations, object_masks(frame.foreground, boxes), strict=True):
            np.testing.assert_array_equal(coco.annToMask(annotation), mask)
            assert annotation["area"] == mask.sum()


def test_without_masks_there_are_boxes(street: Path, tmp_path: Path) -> None:
    assert Command("background")(street, "--masks", "none", "--out", tmp_path / "out", "--stop", 40) == 0
    assert to_coco(tmp_path / "out", tmp_path / "coco.json").endswith(" 0 masks")
    (annotation, *_) = json.loads((tmp_path / "coco.json").read_text())["annotations"]
    assert annotation["segmentation"] == []
    assert annotation["area"] == annotation["bbox"][2] * annotation["bbox"][3]


def test_it_can_be_given_back_as_detections(background: Path, tmp_path: Path) -> None:
    to_coco(background, tmp_path / "coco.json")
    pictures = FinishedRun.of(background).picture_names
    detections = read_detections(tmp_path / "coco.json", film="street", pictures=pictures)
    table = read_tracks_table(background)
    np.testing.assert_array_equal(detections.frame, table["frame"])
    np.testing.assert_array_equal(detections.xyxy[:, 0], table["x"])
    np.testing.assert_array_equal(detections.confidence, table["confidence"])

"""COCO JSON, read back by COCO's own code."""

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pycocotools import mask as coco
from pycocotools.coco import COCO
from rsmcm.apps.exports import FinishedRun, read_tracks_table, to_coco
from rsmcm.apps.exports.coco import compressed, object_masks
from rsmcm.apps.io import read_detections


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


def test_it_can_be_given_back_as_detections(background: Path, tmp_path: Path) -> None:
    to_coco(background, tmp_path / "coco.json")
    pictures = FinishedRun.of(background).picture_names
    detections = read_detections(tmp_path / "coco.json", film="street", pictures=pictures)
    table = read_tracks_table(background)
    np.testing.assert_array_equal(detections.frame, table["frame"])
    np.testing.assert_array_equal(detections.xyxy[:, 0], table["x"])
    np.testing.assert_array_equal(detections.confidence, table["confidence"])


@given(arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20)))
def test_run_lengths_are_those_of_coco(mask: np.ndarray) -> None:
    expected = coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()
    assert compressed(mask) == expected


edge = st.floats(-30, 60)


@given(st.lists(st.tuples(edge, edge, st.floats(0, 40), st.floats(0, 40)), max_size=3))
def test_a_pixel_is_in_a_box_if_its_middle_is(boxes: list[tuple[float, ...]]) -> None:
    foreground = np.where(np.random.default_rng(1).random((18, 24)) < 0.6, 255, 0).astype(np.uint8)
    masks = object_masks(foreground, np.reshape(boxes, (-1, 4)))
    assert masks.shape == (len(boxes), 18, 24)
    rows, columns = np.indices(foreground.shape) + 0.5
    for mask, (x, y, width, height) in zip(masks, boxes, strict=True):
        inside = (x <= columns) & (columns < x + width) & (y <= rows) & (rows < y + height)
        np.testing.assert_array_equal(mask, inside & (foreground > 0))

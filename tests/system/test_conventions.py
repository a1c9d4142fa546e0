"""The conventions of docs/conventions.md hold in the code."""

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.io.tracks import TrackedBox, TrackWriter, read_tracks
from rsmcm.chains.objects.blobs import Blob
from rsmcm.models import MorphableModel, Poses, UpperBody
from rsmcm.models.body.upper_body import BodyPoses
from rsmcm.models.points.patches import sample_patches

TEXT = (Path(__file__).parents[2] / "docs" / "conventions.md").read_text()
NAMES = sorted(set(re.findall(r"`((?:models|inference|chains)\.[\w.]+)`", TEXT)))


def found(name: str) -> bool:
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(["rsmcm", *parts[:length]]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            if is_dataclass(thing) and part in {field.name for field in fields(thing)}:
                return True
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def test_names_of_the_glossary_exist() -> None:
    assert len(NAMES) > 35
    assert [name for name in NAMES if not found(name)] == []
    assert not found("models.core.frame.Frame.colour")


def test_points_have_pixel_centres_at_whole_numbers() -> None:
    grey = np.zeros((21, 31), np.uint8)
    grey[8, 12] = 200
    patch = sample_patches(grey, np.array([[12.0, 8.0]]), 5)[0]
    assert patch[2, 2] == pytest.approx(200)
    assert patch[2, 1] == pytest.approx(patch[2, 3], abs=1e-3)
    assert patch[1, 2] == pytest.approx(patch[3, 2], abs=1e-3)


def test_boxes_have_pixel_edges_at_whole_numbers() -> None:
    mask = np.zeros((30, 40), np.float32)
    mask[10:20, 12:17] = 1
    blob = Blob.newborn(1, np.array([100.0, 200.0]), mask, np.zeros((1, 30, 40), np.float32), 1.0, 100.0)
    assert blob.box == (212, 110, 5, 10)


def test_mot_files_count_pixels_and_frames_from_1(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    with TrackWriter(path) as writer:
        writer.write(1, [TrackedBox(1, (0.0, 0.0, 1.0, 1.0))])
    assert path.read_text().startswith("1,1,1.00,1.00,1.00,1.00,")
    assert read_tracks(path)["box"][0].tolist() == [0, 0, 1, 1]


def test_z_points_away_from_the_viewer() -> None:
    nose = np.array([[0.0, 0.0, -0.3], [0.4, 0.0, 0.0], [0.0, 0.5, 0.0], [-0.4, 0.0, 0.0]])
    model = MorphableModel(nose[None], np.array([[0, 1, 2], [0, 2, 3]]))
    quarter, _ = cv2.Rodrigues(np.array([0.0, 0.3, 0.0]))
    turned = Poses(np.asarray(quarter, np.float64)[None], np.array([[50.0, 40.0]]), np.array([[100.0]]))
    places = model.project(turned)[0]
    # about the axis that points down, by the right-hand rule: what is near (z < 0) goes to the left
    assert places[0, 0] < 50
    assert places[2, 1] > 40

    arms = np.zeros((1, 2, 2, 3))
    arms[..., 1] = 1  # hanging
    body = UpperBody.from_head(80.0)
    joints = body.joints(BodyPoses(np.array([[100.0, 100.0]]), np.zeros((1, 3)), np.zeros((1, 3)), arms))[0]
    left_hand, right_hand, head = joints[4], joints[7], joints[0]
    assert left_hand[0] > 100 > right_hand[0]  # the person faces the camera
    assert head[1] < 100 < left_hand[1]

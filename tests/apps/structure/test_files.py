"""What a structure run writes: read back with independent code."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.structure.files import (
    GREY,
    orthographic_parts,
    point_colours,
    write_cameras,
    write_ply,
    write_tracks,
)

from ...support.reconstructions import SCALE, pictures, reconstruction, small_cylinder, without_images

TRUTH = small_cylinder()
FOUND = reconstruction(TRUTH)
COLOURS = np.random.default_rng(0).integers(60, 255, (15, 3)).astype(np.uint8)
FRAMES = pictures(TRUTH, COLOURS)


def test_ply_as_other_programs_read_it(tmp_path: Path) -> None:
    write_ply(tmp_path / "structure.ply", FOUND, COLOURS)
    head, body = (tmp_path / "structure.ply").read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "element vertex 15" in lines
    properties = [line.split()[1:] for line in lines if line.startswith("property")]
    assert properties[:6] == [
        ["float", "x"],
        ["float", "y"],
        ["float", "z"],
        ["uchar", "red"],
        ["uchar", "green"],
        ["uchar", "blue"],
    ]
    form = "<" + "".join({"float": "f", "uchar": "B", "int": "i"}[kind] for kind, _ in properties)
    assert len(body) == 15 * struct.calcsize(form)
    rows = list(struct.iter_unpack(form, body))
    np.testing.assert_allclose([row[:3] for row in rows], FOUND.shape, rtol=1e-6)
    np.testing.assert_array_equal([row[5:2:-1] for row in rows], COLOURS)
    np.testing.assert_allclose([row[6] for row in rows], 0.01, rtol=1e-6)
    np.testing.assert_array_equal([row[7] for row in rows], TRUTH.visible.sum(axis=0))
    assert [path.name for path in tmp_path.iterdir()] == ["structure.ply"]


def test_cameras_project_the_shape(tmp_path: Path) -> None:
    write_cameras(tmp_path / "cameras.json", FOUND, FRAMES)
    content = json.loads((tmp_path / "cameras.json").read_text())
    assert content["geometry"] == "euclidean"
    assert [entry["frame"] for entry in content["frames"]] == list(range(1, 13))
    for entry, positions in zip(content["frames"], FOUND.positions, strict=True):
        rotation = np.array(entry["rotation"])
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert entry["scale"] == pytest.approx(SCALE)
        by_parts = entry["scale"] * FOUND.shape @ rotation[:2].T + entry["translation"]
        np.testing.assert_allclose(by_parts, positions)
        matrix = np.array(entry["matrix"])
        np.testing.assert_allclose(FOUND.shape @ matrix[:, :3].T + matrix[:, 3], positions)


def test_cameras_that_are_unknown_or_affine(tmp_path: Path) -> None:
    cameras = FOUND.cameras.copy()
    cameras[3] = np.nan
    write_cameras(tmp_path / "cameras.json", replace(FOUND, cameras=cameras), FRAMES)
    entry = json.loads((tmp_path / "cameras.json").read_text())["frames"][3]
    assert entry["scale"] is None
    assert entry["matrix"] == [[None] * 4] * 2
    write_cameras(tmp_path / "cameras.json", replace(FOUND, geometry="affine"), FRAMES)
    assert set(json.loads((tmp_path / "cameras.json").read_text())["frames"][0]) == {
        "frame",
        "time",
        "matrix",
    }


def test_nearest_rotation_of_a_camera_that_is_not_quite_one() -> None:
    generator = np.random.default_rng(1)
    exact = TRUTH.cameras[5].copy()
    scales, rotations = orthographic_parts(3 * exact[None] + 1e-4 * generator.normal(size=(1, 2, 4)))
    np.testing.assert_allclose(rotations[0, :2], exact[:, :3], atol=1e-3)
    assert scales[0] == pytest.approx(3, abs=1e-3)


def test_tracks_as_documented(tmp_path: Path) -> None:
    write_tracks(tmp_path / "tracks.npz", FOUND, FRAMES)
    with np.load(tmp_path / "tracks.npz") as content:
        assert content["position"].shape == (12, 15, 2)
        assert content["covariance"].shape == (12, 15, 2, 2)
        assert content["observed"].dtype == np.bool_
        np.testing.assert_array_equal(content["point_of_track"], TRUTH.point_of_track)
        assert content["frame"].tolist() == list(range(1, 13))
        assert content["time"].tolist() == [number / 25 for number in range(12)]


def test_colours_are_those_of_the_pictures() -> None:
    found = point_colours(FRAMES, FOUND)
    # points that lie before each other hide each other's colours in some frames, not in most
    assert (np.abs(found.astype(int) - COLOURS) <= 2).all(axis=1).mean() > 0.8
    assert (point_colours(without_images(FRAMES), FOUND) == GREY).all()


def test_grey_pictures_and_points_outside() -> None:
    grey = [replace(frame, image=np.full((80, 96), 77, np.uint8)) for frame in FRAMES]
    moved = FOUND.positions.copy()
    moved[:, 0] += 1000
    colours = point_colours(grey, replace(FOUND, positions=moved))
    assert (colours[0] == GREY).all()
    assert (colours[1:] == 77).all()

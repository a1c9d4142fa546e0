"""netCDF of movement, read back by xarray; names and shapes are those that movement demands."""

from pathlib import Path

import numpy as np
import pytest
import xarray
from rsmcm.apps.exports import read_tracks_table, to_movement
from rsmcm.apps.exports.movement import _times
from rsmcm.models.body.upper_body import JOINTS

from ...conftest import Command


def read(path: Path) -> xarray.Dataset:
    with xarray.open_dataset(path) as dataset:
        return dataset.load()


def test_objects_are_bounding_boxes(background: Path, tmp_path: Path) -> None:
    said = to_movement(background, tmp_path / "tracks.nc")
    dataset, table = read(tmp_path / "tracks.nc"), read_tracks_table(background)
    names = [f"id_{name}" for name in np.unique(table["id"])]
    assert said == f"bboxes, time 29, space 2, individual {len(names)}"
    assert dataset["position"].dims == dataset["shape"].dims == ("time", "space", "individual")
    assert dataset["confidence"].dims == ("time", "individual")
    assert dataset["space"].values.tolist() == ["x", "y"]
    assert dataset["individual"].values.tolist() == names
    np.testing.assert_allclose(dataset["time"], (np.arange(3, 60, 2) - 1) / 25, atol=1e-6)
    assert dataset.attrs == {
        "source_software": "rsmcm",
        "ds_type": "bboxes",
        "fps": 12.5,
        "time_unit": "seconds",
        "source_file": str(background),
    }
    count = 0
    for row in range(len(table["id"])):
        frame = {"time": (table["frame"][row] - 3) // 2}
        at = dataset.isel(frame).sel(individual=f"id_{table['id'][row]}")
        box = np.array([table[name][row] for name in ("x", "y", "width", "height")])
        np.testing.assert_allclose(at["position"], box[:2] + box[2:] / 2)
        np.testing.assert_array_equal(at["shape"], box[2:])
        assert at["confidence"] == table["confidence"][row]
        count += 1
    assert int(np.isfinite(dataset["confidence"]).sum()) == count


def test_a_body_is_a_pose(body: Path, tmp_path: Path) -> None:
    assert Command("export")(body, "--to", "movement", "--out", tmp_path / "body.nc") == 0
    dataset = read(tmp_path / "body.nc")
    with np.load(body / "poses.npz") as poses:
        joints, seen, times = poses["joints_2d"], poses["seen_probability"], poses["times"]
    assert dataset.attrs["ds_type"] == "poses"
    position = dataset["position"].transpose("time", "keypoint", "space", "individual")
    np.testing.assert_array_equal(position[..., 0], joints)
    assert dataset["keypoint"].values.tolist() == list(JOINTS)
    np.testing.assert_array_equal(dataset["time"], times)
    assert dataset["individual"].values.tolist() == ["id_1"]
    hands = dataset["confidence"].sel(keypoint=["head", "left_hand", "right_hand"], individual="id_1")
    np.testing.assert_array_equal(hands.transpose("time", "keypoint"), seen)
    assert np.isnan(dataset["confidence"].sel(keypoint="neck")).all()


def test_a_face_is_a_pose(talking: Path, tmp_path: Path) -> None:
    to_movement(talking, tmp_path / "face.nc")
    dataset = read(tmp_path / "face.nc")
    with np.load(talking / "poses.npz") as poses:
        landmarks, fit = poses["landmarks"], poses["fit"]
    position = dataset["position"].transpose("time", "keypoint", "space", "individual")
    np.testing.assert_array_equal(position[..., 0], landmarks)
    assert dataset["keypoint"].values[:2].tolist() == ["landmark_0", "landmark_1"]
    np.testing.assert_array_equal(dataset["confidence"][:, 0, 0], fit)


def test_times_between_objects_are_even_and_beyond_them_at_the_rate() -> None:
    times = _times(range(11, 26, 2), np.array([15, 15, 21]), np.array([1.0, 1.0, 1.6]), 4.0)
    np.testing.assert_allclose(times, [0.5, 0.75, 1.0, 1.2, 1.4, 1.6, 1.85, 2.1])
    none = _times(range(11, 26, 2), np.zeros(0, np.int64), np.zeros(0), 4.0)
    np.testing.assert_allclose(none, np.arange(10, 25, 2) / 8)


def test_damaged_poses_are_named(body: Path, tmp_path: Path) -> None:
    for name in ("manifest.json", "summary.json"):
        (tmp_path / name).write_bytes((body / name).read_bytes())
    (tmp_path / "poses.npz").write_bytes((body / "poses.npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"poses\.npz: got a damaged file"):
        to_movement(tmp_path, tmp_path / "body.nc")
    assert not (tmp_path / "body.nc").exists()

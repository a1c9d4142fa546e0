"""CVAT's MOT 1.1, read back as ground truth and by motmetrics."""

import zipfile
from pathlib import Path

import motmetrics
import numpy as np
import pytest
from rsmcm.apps.exports import read_tracks_table, to_cvat
from rsmcm.apps.io import BoxTruth, read_ground_truth

from ...conftest import Command, summary_of


def test_the_zip_is_as_cvat_has_it(background: Path, tmp_path: Path) -> None:
    path = tmp_path / "tracks.zip"
    table = read_tracks_table(background)
    n_objects = len(np.unique(table["id"]))
    assert to_cvat(background, path) == f"{len(table['id'])} boxes of {n_objects} objects"
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["gt/gt.txt", "gt/labels.txt"]
        assert archive.read("gt/labels.txt") == b"object\n"
        archive.extractall(tmp_path)
    read = motmetrics.io.loadtxt(tmp_path / "gt" / "gt.txt", fmt="mot16")
    np.testing.assert_array_equal(read.index.get_level_values(0), table["frame"])
    np.testing.assert_array_equal(read.index.get_level_values(1), table["id"])
    boxes = np.stack([table[name] for name in ("x", "y", "width", "height")], axis=1)
    # motmetrics takes 1 away, as for MOT, whose pixels count from 1
    np.testing.assert_allclose(read[["X", "Y", "Width", "Height"]] + [1, 1, 0, 0], boxes, atol=1e-9)
    np.testing.assert_array_equal(read["Visibility"], table["seen"])
    assert set(read["ClassId"]) == set(read["Confidence"]) == {1}


def test_it_is_ground_truth_in_which_the_run_is_perfect(
    background: Path, street: Path, tmp_path: Path
) -> None:
    path, again = tmp_path / "tracks.zip", tmp_path / "again.zip"
    to_cvat(background, path)
    to_cvat(background, again)
    assert path.read_bytes() == again.read_bytes()
    truth, table = read_ground_truth(path), read_tracks_table(background)
    assert isinstance(truth, BoxTruth)
    np.testing.assert_array_equal(truth.box[:, 0], table["x"])
    np.testing.assert_array_equal(truth.identity, table["id"])
    options = ("--start", 3, "--step", 2, "--ground-truth", path, "--out", tmp_path / "out")
    assert Command("background")(street, *options) == 0
    scores = summary_of(tmp_path / "out")["metrics"]["tracks"]
    assert scores["mota"] == pytest.approx(1)
    assert scores["idf1"] == pytest.approx(1)

"""CVAT's MOT 1.1, read back as ground truth and by motmetrics."""

import zipfile
from pathlib import Path

import motmetrics
import numpy as np
from rsmcm.apps.exports import read_tracks_table, to_cvat


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

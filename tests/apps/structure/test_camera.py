"""The camera of a film, as a user asks for it and is told of it."""

import json
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from rsmcm.apps.io.sources.images import DETAILS, focal_of_picture
from rsmcm.apps.structure.page import known_lens
from rsmcm.models.core.frame import Frame, GivenPoints
from scipy.spatial.transform import Rotation

from ...conftest import Command, summary_of
from ...support.perspective_films import PerspectiveFilm, turning

run = Command("structure")
ALONE = ("--association", "none", "--coherence", "none")


@pytest.fixture(scope="module")
def film() -> PerspectiveFilm:
    return turning(3, n_points=60, n_frames=20, missing=0.4)


@pytest.fixture(scope="module")
def source(film: PerspectiveFilm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tracks") / "tracks.npz"
    np.savez(path, tracks=film.tracks)
    return path


@pytest.fixture(scope="module")
def finished(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "out"
    assert run(source, "--out", out, *ALONE) == 0
    return out


def test_cameras_file_is_that_of_pinholes(finished: Path, film: PerspectiveFilm) -> None:
    cameras = json.loads((finished / "cameras.json").read_text())
    assert (cameras["camera"], cameras["geometry"]) == ("perspective", "euclidean")
    focal, deviation = cameras["focal_length"], cameras["focal_length_deviation"]
    assert abs(focal - film.cameras.focal) < 4 * deviation + 0.005 * focal
    with np.load(finished / "tracks.npz") as tracks:
        positions = tracks["position"]
    vertices = (finished / "structure.ply").read_bytes()
    data = vertices[vertices.index(b"end_header\n") + 11 :]
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("bgr", "3u1"), ("deviation", "<f4"), ("n", "<i4")]
    points = np.frombuffer(data, np.dtype(fields))
    shape = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)
    for frame, entry in enumerate(cameras["frames"]):
        space = shape @ np.transpose(entry["rotation"]) + entry["translation"]
        seen = focal * space[:, :2] / space[:, 2:] + cameras["principal_point"]
        np.testing.assert_allclose(seen, positions[frame], atol=0.01)
        stands = np.array(entry["rotation"]) @ entry["centre"] + entry["translation"]
        np.testing.assert_allclose(stands, 0, atol=1e-6 * focal)


def test_colmap_reads_back_as_the_format_says(finished: Path) -> None:
    """Fields in the order of COLMAP's documentation; points reproject to within the error that is stated."""

    def lines(name: str) -> list[list[str]]:
        text = (finished / "colmap" / name).read_text()
        return [line.split() for line in text.split("\n")[:-1] if not line.startswith("#")]

    (camera,) = lines("cameras.txt")
    assert camera[:2] == ["1", "SIMPLE_PINHOLE"]
    focal, *middle = map(float, camera[4:])
    images = {}
    rows = lines("images.txt")
    for pose, points in zip(rows[::2], rows[1::2], strict=True):
        rotation = Rotation.from_quat(np.array(pose[1:5], float)[[1, 2, 3, 0]]).as_matrix()
        assert pose[8] == "1"
        images[int(pose[0])] = rotation, np.array(pose[5:8], float), np.array(points, float).reshape(-1, 3)
    assert list(images) == list(range(1, 21))
    points = lines("points3D.txt")
    assert len(points) == summary_of(finished)["points"]
    for identity, x, y, z, red, _, _, error, *track in points:
        assert red == "128"
        distances = []
        for image, place in np.array(track, int).reshape(-1, 2):
            rotation, translation, seen = images[image]
            assert seen[place, 2] == int(identity)
            space = rotation @ np.array([x, y, z], float) + translation
            distances.append(np.hypot(*(focal * space[:2] / space[2] + middle - seen[place, :2])))
        assert np.mean(distances) == pytest.approx(float(error), abs=2e-3)


def picture_with(path: Path, details: Mapping[int, object]) -> Path:
    exif = Image.Exif()
    exif.get_ifd(DETAILS).update(details)
    Image.fromarray(np.zeros((300, 400), np.uint8)).save(path, exif=exif)
    return path


def test_focal_length_that_a_picture_states(tmp_path: Path) -> None:
    """Diagonal 500 px; of film for 35 mm it is 43.27 mm."""
    path = tmp_path / "picture.jpg"
    assert focal_of_picture(picture_with(path, {0xA405: 50})) == pytest.approx(50 * 500 / 43.2666, rel=1e-4)
    sensor = {0x920A: 8.0, 0xA20E: 1000.0, 0xA210: 3}  # 8 mm; 1000 px a cm
    assert focal_of_picture(picture_with(path, sensor)) == pytest.approx(800)
    assert focal_of_picture(picture_with(path, {0x920A: 8.0})) is None
    assert focal_of_picture(picture_with(path, {0xA405: 0})) is None
    cv2.imwrite(str(path), np.zeros((30, 40), np.uint8))
    assert focal_of_picture(path) is None
    path.write_bytes(b"no picture")
    assert focal_of_picture(path) is None
    assert focal_of_picture(tmp_path / "nowhere.jpg") is None


def test_known_lens_pictures_and_of_tracks(tmp_path: Path) -> None:
    path = picture_with(tmp_path / "picture.jpg", {0xA405: 50})
    frames = [Frame(np.zeros((300, 400), np.uint8), 0.0, 1)]
    lens, note = known_lens(frames, None, path)
    assert lens.size == (300, 400)
    assert lens.focal == pytest.approx(577.8, abs=0.1)
    assert "577.81 px" in note
    np.testing.assert_array_equal(lens.principal, [199.5, 149.5])
    assert known_lens(frames, 900.0, path)[0].focal == 900
    points = GivenPoints(np.array([[10.0, 20.0], [389.0, 279.0]]), np.arange(2))
    lens, note = known_lens([Frame(None, 0.0, 1, points)], None, None)
    assert lens.size == (280, 390)
    assert "390 x 280 px" in note

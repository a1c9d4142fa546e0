"""OpenCV's face detectors behind one protocol, and what is said where there are none."""

import copy
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.core.frame import Frame
from rsmcm.models.face import detectors
from rsmcm.models.face.detectors import HaarFaces, default_faces, for_height

from ...fuzz.networks import tiny_network
from ...support.signer_clip import signer_clip

Image = NDArray[np.uint8]

needs_cascade = pytest.mark.skipif(not hasattr(cv2, "CascadeClassifier"), reason="OpenCV 5 has no cascades")


@pytest.fixture(scope="module")
def film() -> list[Image]:
    """Every tenth frame of a person who signs; one face in each, about (318, 90)."""
    return signer_clip()[::10]


def hits(boxes: list[NDArray[np.float64]]) -> tuple[int, int]:
    """Images with the face among the boxes, and boxes that are none."""
    good = [np.hypot(*(each[:, :2] + each[:, 2:] / 2 - (318, 90)).T) < 45 for each in boxes]
    return sum(bool(each.any()) for each in good), sum(int((~each).sum()) for each in good)


@needs_cascade
def test_faces_of_a_film(film: list[Image]) -> None:
    frames = [Frame(image, 0.0, 1) for image in film]
    any_size, known_size = HaarFaces(), HaarFaces(74.0)
    found, false = hits([any_size(frame) for frame in frames])
    assert found >= 0.5 * len(film)
    assert false == 0
    found, false = hits([known_size(frame) for frame in frames])
    assert found >= 0.9 * len(film)
    assert false <= 1


@needs_cascade
@pytest.mark.parametrize("height", [None, 60.0])
def test_nothing_to_find(height: float | None) -> None:
    faces = HaarFaces(height)
    for image in (None, np.zeros((120, 160), np.uint8), np.zeros((120, 160, 3), np.uint8)):
        assert faces(Frame(image, 0.0, 1)).shape == (0, 4)
    assert copy.deepcopy(faces) == faces
    assert pickle.loads(pickle.dumps(faces)) == faces


def test_no_cascade_no_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "CascadeClassifier", raising=False)
    with pytest.raises(ValueError, match=r"^OpenCV .* has no face detector$"):
        HaarFaces()
    with pytest.raises(ValueError, match=r"^OpenCV .* detector, expected a model file of YuNet$"):
        default_faces()


def test_files_that_are_no_model(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere.onnx: no such file"):
        default_faces(tmp_path / "nowhere.onnx")
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    with pytest.raises(ValueError, match=r"bad.onnx: is no model of OpenCV's face detector YuNet"):
        default_faces(bad)


@needs_cascade
def test_a_cascade_of_the_users(film: list[Image], tmp_path: Path) -> None:
    """It is read from any file, and is the only one; a damaged one is refused, and ends no process."""
    brought = Path(cv2.__file__).parent / "data" / detectors.FRONTAL
    own = tmp_path / "größe.xml"
    own.write_bytes(brought.read_bytes())
    faces = default_faces(own)
    frames = [Frame(image, 0.0, 1) for image in film]
    for frame in frames:
        np.testing.assert_array_equal(faces(frame), HaarFaces()(frame))
    assert pickle.loads(pickle.dumps(faces)) == faces
    for content in (
        b"",
        b"<a>",
        brought.read_bytes()[:90_000],
        b"<opencv_storage><cascade/></opencv_storage>",
    ):
        damaged = tmp_path / "damaged.xml"
        damaged.write_bytes(content)
        with pytest.raises(ValueError, match=r"damaged.xml: is no cascade of OpenCV's"):
            default_faces(damaged)
    with pytest.raises(FileNotFoundError, match=r"nowhere.xml: no such file"):
        default_faces(tmp_path / "nowhere.xml")


@needs_cascade
def test_for_height(film: list[Image]) -> None:
    """Upright faces of a known size: they are what a face that was lost is looked for as."""
    scaled = [cv2.resize(image, None, fx=52 / 74, fy=52 / 74, interpolation=cv2.INTER_AREA) for image in film]
    boxes = [for_height(HaarFaces(), 52.0, 1)(Frame(image, 0.0, 1)) * 74 / 52 for image in scaled]
    assert hits(boxes)[0] >= 0.8 * len(film)
    other = lambda frame: np.zeros((0, 4))  # noqa: E731
    assert for_height(other, 52.0) is other


def test_a_damaged_network_does_not_end_the_process(tmp_path: Path) -> None:
    """One wrong letter in the name of a layer is enough for OpenCV 4 to crash."""
    whole = tiny_network()
    path = tmp_path / "faces.onnx"
    path.write_bytes(whole)
    assert default_faces(path)(Frame(np.full((64, 96, 3), 200, np.uint8), 0.0, 1)).shape[1] == 4
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(whole.replace(b"Reshape", b"Resh\xa0pe", 1))
    with pytest.raises(ValueError, match=r"damaged.onnx: is no model of OpenCV's face detector YuNet"):
        default_faces(damaged)

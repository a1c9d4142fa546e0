"""The page on keypoints: its commands and its Python run as printed, on a signer, with a small network."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.demo import write_body
from rsmcm.apps.io import read_keypoints
from rsmcm.apps.io.files import PLAYABLE, SegmentedVideo
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.models.body.upper_body import JOINTS
from rsmcm.models.core.frame import COCO, KEYPOINTS

from ..conftest import summary_of
from ..fuzz.networks import steady_person
from ..support.keypoints import points_of
from ..support.pages import ROOT, Reader

pytestmark = pytest.mark.slow

N_FRAMES = 8
SIZE = (480, 270)


@pytest.fixture
def scene() -> SignerScene:
    return signer(N_FRAMES, 3, 0.0, 0.3, SIZE)


def in_network(scene: SignerScene) -> NDArray[np.float32]:
    """`(17, 3)`: the first pose in the input of a network, 640 px; legs and one eye are not found."""
    places = points_of(scene.joints[:1, :, :2], scene.body)[0]
    points = np.zeros((len(COCO), 3), np.float32)
    for row, name in enumerate(COCO):
        if name in KEYPOINTS:
            points[row] = *places[KEYPOINTS.index(name)], 0.9
        elif name in ("left_eye", "left_ear", "right_ear"):
            points[row] = *places[0], 0.9
    points[:, :2] = (points[:, :2] + 0.5) * 640 / SIZE[0] - 0.5
    return points


@pytest.fixture
def film(scene: SignerScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to be in, with all that the page names."""
    monkeypatch.chdir(tmp_path)
    write_body(scene, Path("results/demo/body"))
    video = SegmentedVideo(Path("film.mp4"), 25.0, PLAYABLE)
    for number, image in enumerate(scene.images(), start=1):
        video.write(image, number, (number - 1) / 25)
    video.close()
    Path("network.onnx").write_bytes(steady_person(in_network(scene), 640))
    return tmp_path


def test_the_page_can_be_typed(film: Path, scene: SignerScene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "examples"))
    names = Reader(ROOT / "docs" / "keypoints.md").read().names
    clicked = summary_of(Path("results/keypoints"))
    assert clicked["keypoints"]["frames"] == len(read_keypoints("results/demo/body/joints.csv").frame)
    assert clicked["body"]["lengths"]["head_height"] == pytest.approx(scene.body.head_height, rel=0.1)
    network = summary_of(Path("results/network"))
    assert network["keypoints"] == {"persons": N_FRAMES // 2, "frames": N_FRAMES // 2}
    with np.load("results/network/poses.npz") as poses:
        head = JOINTS.index("head")
        apart = np.linalg.norm(poses["joints_2d"][0, head] - scene.joints[0, head, :2])
        assert apart < 0.3 * scene.body.head_height
    assert names["points"] is None, "12 is no second frame from 1"
    assert names["joints"].shape == (8, 3)
    assert len(names["first"]) == 1

"""`rsmcm body --keypoints`, as a user runs it: on a rendered film, with what a detector would have found."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io import read_keypoints
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.chains.body.start import MOST_FRAMES, follow_person
from rsmcm.models import GivenKeypoints
from rsmcm.models.body.upper_body import JOINTS

from ...conftest import Command, summary_of
from ...support.keypoints import read_frame_result, write_csv

Array = NDArray[np.float64]

run = Command("body")
complaint = run.complaint

N_FRAMES = 12
HEAD = JOINTS.index("head")
FEW = ("--samples", "100")


@pytest.fixture(scope="module")
def scene() -> SignerScene:
    return signer(N_FRAMES, 3, 0.0, 0.3, (320, 180))


@pytest.fixture(scope="module")
def found(scene: SignerScene) -> list[GivenKeypoints]:
    """What is found in the scene, and a smaller person beside."""
    own = list(read_frame_result(scene, exchanged=0.0, missed=0.05))
    small = [0.4 * given.positions + (180, 40) for given in own]
    return [
        GivenKeypoints(np.concatenate([other, given.positions]), np.concatenate([given.scores] * 2))
        for given, other in zip(own, small, strict=True)
    ]


@pytest.fixture(scope="module")
def film(scene: SignerScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for number, image in enumerate(scene.images(), start=1):
        cv2.imwrite(str(folder / f"frame{number:02d}.png"), image)
    return folder


def test_a_person_is_found_without_a_detector_of_faces(
    film: Path, scene: SignerScene, found: list[GivenKeypoints], tmp_path: Path
) -> None:
    """Size and lengths come from the points; the film is longer than the file at both ends."""
    path, out = write_csv(tmp_path / "k.csv", found[2:9], first=3), tmp_path / "out"
    assert run(film, "--out", out, "--keypoints", path, *FEW) == 0
    summary = summary_of(out)
    assert summary["before_the_start"] == [1, 2]
    assert summary["keypoints"] == {"persons": 14, "frames": 7}
    known = summary["parameters"]["keypoints"]
    assert (known["file"], len(known["sha256"])) == (str(path.resolve()), 64)
    assert summary["body"]["origin"].startswith("Fitted to keypoints in 7 frames")
    # medians of seven distances between points that are off by 0.08 head heights: 7 %, and four of these
    for name in ("head_height", "shoulder_width", "neck"):
        assert summary["body"]["lengths"][name] == pytest.approx(getattr(scene.body, name), rel=0.28)
    with np.load(out / "poses.npz") as poses:
        assert poses["frames"].tolist() == list(range(3, N_FRAMES + 1))
        apart = np.linalg.norm(poses["joints_2d"] - scene.joints[2:, :, :2], axis=2)
        assert np.isfinite(poses["joints_3d_covariances"]).all()
    assert np.median(apart[:7]) < 0.2 * scene.body.head_height
    assert json.loads((out / "manifest.json").read_text())["application"] == "body"


def test_files_that_do_not_fit(
    film: Path, found: list[GivenKeypoints], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "k.csv"

    def said() -> str:
        line = complaint(capfd, film, "--out", tmp_path / "out", "--keypoints", path)
        assert not (tmp_path / "out" / "poses.npz").exists()
        return line

    write_csv(path, found, first=4)
    assert f"got frame {N_FRAMES + 1}, but {film} has {N_FRAMES} frames" in said()
    path.write_text("frame,joint,x,y\n1,left_wrist,50,60\n")
    assert "holds no frame in which a head or shoulders were found" in said()
    path.write_text("frame,joint,x,y\n1,head,50,60\n")
    assert "joints: got no length" in said()
    path.write_text("frame,joint,x,y\n1,head,50,60\n1,neck,50,9000\n")
    assert f"{path}" in said()
    path.write_text("frame,joint,x,y\n1,paw,50,60\n")
    assert f"{path}, line 2: got joint 'paw'" in said()
    assert "No such file" in complaint(capfd, film, "--out", tmp_path / "out", "--keypoints", "gone.csv")


def test_one_person_is_followed_through_a_film(
    scene: SignerScene, found: list[GivenKeypoints], tmp_path: Path
) -> None:
    """Whoever comes first in the file."""
    mixed = [
        GivenKeypoints(given.positions[:: 1 - 2 * (k % 2)], given.scores[:: 1 - 2 * (k % 2)])
        for k, given in enumerate(found)
    ]
    keypoints = read_keypoints(write_csv(tmp_path / "k.csv", mixed))
    head = 0.4 * scene.joints[3, HEAD, :2] + (180, 40)
    large, small = follow_person(keypoints, 1), follow_person(keypoints, 4, head)
    assert len(large) == N_FRAMES <= MOST_FRAMES
    assert len(small) == N_FRAMES - 3

    def widths(joints: Array) -> Array:
        return np.abs(joints[:, 2, 0] - joints[:, 5, 0])

    assert np.nanmedian(widths(large)) > 1.5 * np.nanmedian(widths(small))

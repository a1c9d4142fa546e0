"""Small runs whose results are exported."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import face, signer, sleeping_man
from rsmcm.models.body.upper_body import JOINTS

from ...conftest import Command

N_FRAMES = 60


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film in which a person walks in, as a folder of pictures."""
    folder = tmp_path_factory.mktemp("street")
    write_scene(sleeping_man(N_FRAMES, size=(128, 96), enter=5, car_leaves=20), folder)
    return folder / "input"


@pytest.fixture(scope="session")
def background(street: Path) -> Path:
    """Results of `rsmcm background` with masks as pictures, of frames 3, 5, ... 59."""
    out = street.parent / "background"
    assert Command("background")(street, "--start", 3, "--step", 2, "--out", out) == 0
    return out


@pytest.fixture(scope="session")
def body(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of `rsmcm body`."""
    folder = tmp_path_factory.mktemp("body")
    scene = signer(12, 3, 0.0, 0.3, (320, 180))
    width, height = scene.body.head_width, scene.body.head_height
    x, y = scene.joints[0, JOINTS.index("head"), :2] - (width / 2, height / 2)
    film = written(folder / "film", scene.images())
    box = f"{x:.0f},{y:.0f},{width:.0f},{height:.0f}"
    assert Command("body")(film, "--head", box, "--samples", 100, "--out", folder / "out") == 0
    return folder / "out"


@pytest.fixture(scope="session")
def talking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of `rsmcm face`."""
    folder = tmp_path_factory.mktemp("face")
    scene = face(4, 3, (200, 160))
    np.save(folder / "landmarks.npy", scene.vertices)
    film = written(folder / "film", scene.images())
    options = ("--landmarks", folder / "landmarks.npy", "--experts", 4)
    assert Command("face")(film, *options, "--out", folder / "out") == 0
    return folder / "out"


def written(folder: Path, images: Iterable[NDArray[np.uint8]]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number:03d}.png"), image)
    return folder

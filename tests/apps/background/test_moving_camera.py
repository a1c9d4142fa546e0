"""The notice that a camera moves: on what shakes, and on nothing else."""

import json
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.background.application import build_model, read_frame_result
from rsmcm.apps.background.moving_camera import MOVES, CameraWatch
from rsmcm.apps.io.files import write_image
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.scenes import ShakenFilm, shaken, sleeping_man
from rsmcm.inference import RecursiveBP
from rsmcm.models import Frame

from ...conftest import Command

SIZE = (160, 120)


def noticed(frames: Iterable[Frame]) -> str | None:
    watch, size = CameraWatch(), (0, 0)
    for belief in RecursiveBP(build_model()).run(frames):
        assert belief.frame.image is not None
        size = belief.frame.image.shape[1::-1]
        said = watch.on_frame(belief, read_frame_result(belief, size).foreground)
        if said is not None:
            return said
    return None


@pytest.mark.parametrize("amount", [1.0, 3.0, 10.0])
def test_a_camera_that_shakes_is_noticed_within_a_second(amount: float) -> None:
    said = noticed(shaken(sleeping_man(25, size=(192, 152), noise=0.0), amount, noise=4.0))
    assert said is not None
    assert said.startswith(f"{MOVES}: in frame ")


def test_a_camera_that_pans_is_noticed() -> None:
    wide = sleeping_man(1, size=(640, 240), noise=0.0)[0].image
    assert wide is not None
    frames = [Frame(wide[:, 4 * k : 4 * k + 320].copy(), k / 25, k + 1) for k in range(50)]
    assert noticed(frames) is not None


@pytest.mark.parametrize("jump", [None, 15])
def test_a_steady_camera_is_not(jump: int | None) -> None:
    assert noticed(sleeping_man(60, size=SIZE, enter=0, light_jump=jump)) is None


def test_somebody_who_fills_the_picture_is_no_camera() -> None:
    film = list(sleeping_man(40, size=SIZE))
    coat = np.random.default_rng(3).integers(0, 255, (30, 60, 3)).astype(np.uint8)
    coat = np.asarray(cv2.resize(coat, (640, 240)), np.uint8)  # with a pattern that moves along
    frames = film[:20]
    for k, frame in enumerate(film[20:]):
        assert frame.image is not None
        image = frame.image.copy()
        image[:, 20:] = coat[60:180, 6 * k : 6 * k + 140]
        frames.append(Frame(image, frame.time, frame.number))
    assert noticed(frames) is None


@pytest.fixture(scope="module")
def shaking(tmp_path_factory: pytest.TempPathFactory) -> tuple[ShakenFilm, Path]:
    """A film of a camera that shakes, as a folder of pictures."""
    film = shaken(sleeping_man(50, size=(192, 152), enter=0, noise=0.0), 3.0, noise=4.0)
    folder = tmp_path_factory.mktemp("film")
    for frame in film:
        assert frame.image is not None
        write_image(folder / f"{frame.number:04d}.png", frame.image)
    return film, folder


def test_it_is_said_once_on_standard_error_and_in_the_summary(
    shaking: tuple[ShakenFilm, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert Command("background")(shaking[1], "--out", tmp_path) == 0
    assert capfd.readouterr().err.count(MOVES) == 1
    (note,) = json.loads((tmp_path / "summary.json").read_text())["notes"]
    assert note.startswith(MOVES)


def test_tracks_in_the_first_frame_are_those_of_the_frames_mapped_back(
    shaking: tuple[ShakenFilm, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    film, folder = shaking
    boxes = tmp_path / "boxes.csv"
    lines = ["frame,x,y,width,height,score"]
    for index, view in enumerate(film.views):  # of something that stands
        ((x, y, width, height),) = view.boxes(np.array([[60.0, 80.0, 24.0, 50.0]]))
        lines.append(f"{index + 1},{x - width / 2:.3f},{y - height:.3f},{width:.3f},{height:.3f},1.0")
    boxes.write_text("\n".join(lines) + "\n")
    options = ("--camera", "moving", "--first-frame", "--masks", "none", "--detections", boxes)
    assert Command("background")(folder, *options, "--out", tmp_path / "out") == 0
    frames, first = (
        np.genfromtxt(tmp_path / "out" / name, delimiter=",", names=True)
        for name in ("tracks.csv", "tracks-first-frame.csv")
    )
    assert len(frames) == len(first) > 40
    np.testing.assert_array_equal(frames["id"], first["id"])
    # 3 px of shake, and what is left of it: registration, 0.25 px, and what a box's size does to its foot
    assert np.std(frames["x"][10:]) > 1.0
    assert np.std(first["x"][10:]) < 0.5
    assert np.abs(first["x"][10:] - 48).max() < 2
    assert np.abs(first["y"][10:] - 30).max() < 2


def test_the_first_frame_needs_a_moving_camera(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert Command("background")("film.avi", "--first-frame", "--out", tmp_path / "out") == 2
    assert "--first-frame: got it without tracks of --camera moving" in capfd.readouterr().err


@pytest.mark.slow
def test_a_camera_that_is_followed_gives_masks_and_tracks_of_the_frames(
    shaking: tuple[ShakenFilm, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    film, folder = shaking
    assert Command("background")(folder, "--camera", "moving", "--out", tmp_path) == 0
    assert MOVES not in capfd.readouterr().err
    assert json.loads((tmp_path / "summary.json").read_text())["notes"] == []
    tracks = read_tracks(tmp_path / "tracks.txt")
    hits = wrong = 0
    for index in range(38, 50):
        truth = film.mask(film.film.foreground(index), index)  # type: ignore[attr-defined]
        mask = cv2.imread(str(tmp_path / "foreground" / f"bin{index + 1:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert mask is not None
        hits, wrong = hits + int(((mask > 0) & truth).sum()), wrong + int(((mask > 0) != truth).sum())
        columns = np.flatnonzero(truth.any(axis=0))
        boxes = tracks[tracks["frame"] == index + 1]["box"]
        assert np.abs(boxes[:, 0] + boxes[:, 2] - columns[-1] - 1).min(initial=np.inf) < 9, index
    assert 2 * hits / (2 * hits + wrong) > 0.85

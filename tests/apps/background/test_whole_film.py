"""The background application on a whole film at once, and after a warm-up."""

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from rsmcm.apps.background.application import Background, run_background
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.demo import write_scene
from rsmcm.apps.exports import read_tracks_table
from rsmcm.apps.io.sources.open_source import Source
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs.interruption import Interruption
from rsmcm.apps.runs.loop import Columns
from rsmcm.apps.scenes import sleeping_man
from rsmcm.inference import Belief

from ...conftest import Command, summary_of
from .test_application import masks_of

SIZE = (160, 120)
FIRST, LAST = 41, 100
N_FRAMES = LAST - FIRST + 1


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Somebody walks through the picture, and is there in the first frame; in CDnet's layout."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(sleeping_man(LAST, size=SIZE, enter=1, stand=1, car_leaves=200), folder)
    for path in sorted((folder / "input").iterdir())[: FIRST - 1]:
        path.unlink()
    for kind, letters in (("input", "in"), ("groundtruth", "gt")):
        for number in range(FIRST, LAST + 1):
            path = folder / kind / f"{letters}{number:06d}.png"
            path.rename(path.with_name(f"{letters}{number - FIRST + 1:06d}.png"))
    return folder


def job_of(scene: Path, out: Path, **options: Any) -> BackgroundJob:
    return BackgroundJob(str(scene / "input"), out=out, ground_truth=scene, every=10, **options)


def shown_in_first_frame(folder: Path, scene: Path) -> float:
    """Share of whom the first frame shows that is foreground."""
    truth = cv2.imread(str(scene / "groundtruth" / "gt000001.png"), cv2.IMREAD_GRAYSCALE)
    found = cv2.imread(str(folder / "foreground" / "bin000001.png"), cv2.IMREAD_GRAYSCALE)
    assert truth is not None
    assert found is not None
    return float(np.mean(found[truth == 255] > 0))


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    assert run_background(job_of(scene, out, engine="coordinate-ascent")).signal is None
    return out


def test_the_whole_film_shows_who_is_there_in_the_first_frame(scene: Path, whole: Path) -> None:
    assert shown_in_first_frame(whole, scene) > 0.7
    tracks = read_tracks(whole / "tracks.txt")
    assert tracks["frame"].min() == 1  # though nobody is sure of anybody by then
    table = read_tracks_table(whole)
    speed = 25 * np.diff(tracks["box"][:40, 0]).mean()
    assert table["vx"][:40].mean() == pytest.approx(speed, rel=0.1)
    assert (whole / "film.mp4").exists()
    summary = summary_of(whole)
    assert summary["frames"] == len(masks_of(whole)) == N_FRAMES
    assert summary["tracks"] == len(set(tracks["id"].tolist()))
    assert "coordinate-ascent" in (whole / "view.html").read_text()
    assert summary["metrics"]["pixels"]["F"] > 0.8


@pytest.mark.slow
def test_the_masks_go_on_after_a_signal_to_the_same_bytes(
    scene: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = job_of(scene, tmp_path, engine="coordinate-ascent")
    columns, taken = Background.columns, []

    def interrupted(self: Background, belief: Belief) -> Columns:
        taken.append(belief.frame.number)
        row = columns(self, belief)
        if len(taken) == 17:
            signal.raise_signal(signal.SIGINT)
        return row

    with monkeypatch.context() as patch:
        patch.setattr(Background, "columns", interrupted)
        assert run_background(job).signal == signal.SIGINT
    assert summary_of(tmp_path)["frames"] == 17
    assert run_background(replace(job, resume=True)).signal is None
    assert masks_of(tmp_path) == masks_of(whole)
    for name in ("tracks.txt", "tracks.csv"):
        assert (tmp_path / name).read_bytes() == (whole / name).read_bytes()


def test_a_warm_up_shows_who_is_there_in_the_first_frame(scene: Path, tmp_path: Path) -> None:
    run_background(job_of(scene, tmp_path / "cold"))
    run_background(job_of(scene, tmp_path / "warm", warm_up=1.5))
    assert len(masks_of(tmp_path / "warm")) == N_FRAMES
    assert shown_in_first_frame(tmp_path / "cold", scene) == 0
    assert shown_in_first_frame(tmp_path / "warm", scene) > 0.7
    pixels = [summary_of(tmp_path / name)["metrics"]["pixels"]["F"] for name in ("warm", "cold")]
    assert pixels[0] > pixels[1]


class Live:
    """A camera, as far as the run asks before it reads."""

    name, live, n_frames, rate, size = "camera 0", True, None, 25.0, (32, 24)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--warm-up", "0"], "--warm-up: got 0, expected seconds, more than 0"),
        (["--warm-up", "nan"], "--warm-up: got nan, expected seconds"),
        (["--engine", "coordinate-ascent", "--warm-up", "2"], "--warm-up and --engine coordinate-ascent"),
        (["--warm-up", "2", "--from", "state.npz"], "--warm-up and --from: got both"),
        (["--engine", "coordinate-ascent", "--from", "state.npz"], "coordinate-ascent and --from: got both"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], complaint: str
) -> None:
    command = Command("background")
    assert complaint in command.complaint(capfd, scene / "input", "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [["--engine", "coordinate-ascent"], ["--warm-up", "1"]])
def test_another_model_of_the_background_is_refused(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str]
) -> None:
    config = tmp_path / "job.toml"
    config.write_text('[background]\nmodel = "mixture"\n')
    arguments = [scene / "input", "--out", tmp_path / "out", "--config", config, *options]
    complaint = Command("background").complaint(capfd, *arguments)
    assert "expected one that estimates a background image" in complaint


def test_a_live_source_is_refused_with_a_way_out(tmp_path: Path) -> None:
    from rsmcm.apps.background.application import build_model
    from rsmcm.apps.background.whole_film import read_whole

    job = BackgroundJob("0", out=tmp_path, engine="coordinate-ascent")
    with pytest.raises(ValueError, match=r"camera 0 is live and cannot be read .*--warm-up SECONDS"):
        read_whole(job, cast(Source, Live()), build_model(), iter, Interruption())

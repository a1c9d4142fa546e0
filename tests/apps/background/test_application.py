"""The background application: whole results, missing frames, regions, runs that are cut off and resumed."""

import itertools
import shutil
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from rsmcm.apps.background.application import build_model, run_background
from rsmcm.apps.background.job import BackgroundJob, Engine
from rsmcm.apps.background.parameters import SECTIONS, read_parameters, with_defaults
from rsmcm.apps.demo import write_scene
from rsmcm.apps.evaluation.scoring import Scoring
from rsmcm.apps.exports import read_tracks_table
from rsmcm.apps.io.ground_truth import MaskTruth, read_ground_truth
from rsmcm.apps.io.sources.open_source import open_source
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs.interruption import Interruption
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import MixtureBackground
from rsmcm.models.core.frame import Frame

from ...conftest import modified, names, summary_of

SIZE = (128, 96)
N_FRAMES = 60


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person walks in; in CDnet's layout."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(sleeping_man(N_FRAMES, size=SIZE, enter=5, car_leaves=20), folder)
    return folder


def masks_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "foreground").glob("*.png"))}


def assert_same(one: Path, other: Path) -> None:
    for name in ("tracks.txt", "tracks.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    assert masks_of(one) == masks_of(other)
    assert masks_of(one)


def count_frames(video: Path) -> int:
    with open_source(str(video)) as source:
        return sum(frame.image is not None for frame in source)


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run that nothing interrupts."""
    out = tmp_path_factory.mktemp("whole")
    outcome = run_background(BackgroundJob(str(scene / "input"), out=out, ground_truth=scene, every=25))
    assert outcome.signal is None
    return out


def test_all_results_are_there_and_readable(whole: Path, scene: Path) -> None:
    expected = {"foreground", "tracks.txt", "background.png", "summary.json", "view.html"}
    expected |= {"predictions.npz", "film.mp4", "view.npz", "state.npz", "manifest.json"}
    expected |= {"tracks.csv"}
    assert names(whole) == expected, "and no segments or unfinished files"
    assert list(masks_of(whole)) == [f"bin{number:06d}.png" for number in range(1, N_FRAMES + 1)]
    for path in (whole / "foreground").glob("*.png"):
        mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert mask is not None
        assert mask.shape == (SIZE[1], SIZE[0])
        assert set(np.unique(mask)) <= {0, 255}
    background = cv2.imread(str(whole / "background.png"))
    assert background is not None
    assert background.shape == (SIZE[1], SIZE[0], 3)
    assert count_frames(whole / "film.mp4") == N_FRAMES
    summary = summary_of(whole)
    assert summary["frames"] == N_FRAMES
    assert summary["seed"] == 0
    assert summary["parameters"]["background"] == with_defaults({})["background"]
    assert summary["versions"]["numpy"] == np.__version__
    assert summary["metrics"]["frames compared"] == N_FRAMES
    tracks, table = read_tracks(whole / "tracks.txt"), read_tracks_table(whole)
    assert len(tracks) > 0, "the person is tracked"
    boxes = np.stack([table[name] for name in ("x", "y", "width", "height")], axis=1)
    np.testing.assert_allclose(boxes, tracks["box"], atol=1e-9)
    np.testing.assert_allclose(table["time"], (tracks["frame"] - 1) / 25, atol=1e-6)
    assert np.hypot(table["vx"], table["vy"]).max() > 5
    truth = read_ground_truth(scene)
    assert isinstance(truth, MaskTruth)
    scoring = Scoring(truth)
    for number in truth.frames:
        mask = cv2.imread(str(whole / "foreground" / f"bin{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        scoring.add(number, np.asarray(mask, np.uint8))
    assert scoring.measures(None)["pixels"] == pytest.approx(summary["metrics"]["pixels"])


def test_interrupted_and_resumed_is_as_if_never_interrupted(
    scene: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = BackgroundJob(str(scene / "input"), out=tmp_path, ground_truth=scene, every=10, video=True)
    items, stop_after = Interruption.items, 37

    def interrupted(self: Interruption, source: Iterator[Frame]) -> Iterator[Frame]:
        for count, frame in enumerate(items(self, source), 1):
            yield frame
            if count == stop_after:
                signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Interruption, "items", interrupted)
        outcome = run_background(job)
    assert outcome.signal == signal.SIGINT
    assert summary_of(tmp_path)["frames"] == stop_after
    assert summary_of(tmp_path)["ended_early"]
    assert count_frames(tmp_path / "film.mp4") == stop_after
    assert len(masks_of(tmp_path)) == stop_after
    assert (tmp_path / "view.html").exists()

    assert run_background(replace(job, resume=True, video=False)).signal is None
    assert_same(tmp_path, whole)
    for name in ("film.mp4", "overlay.mp4"):  # a video that was begun is gone on with
        assert count_frames(tmp_path / name) == N_FRAMES
    summary = summary_of(tmp_path)
    assert summary["metrics"] == summary_of(whole)["metrics"]
    assert summary["frames"] == N_FRAMES
    assert not summary["ended_early"]
    assert not list(tmp_path.glob("*.part*"))


def test_a_finished_run_is_resumed_by_doing_nothing(scene: Path, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(whole, out)
    before = modified(out)
    outcome = run_background(BackgroundJob(str(scene / "input"), out=out, ground_truth=scene, resume=True))
    assert outcome.summary["frames"] == N_FRAMES
    assert modified(out) == before


def test_damaged_images_are_missing_frames(scene: Path, tmp_path: Path) -> None:
    source = tmp_path / "input"
    shutil.copytree(scene / "input", source)
    for number in (1, 30, 31):
        path = source / f"in{number:06d}.png"
        path.write_bytes(path.read_bytes()[:100])
    run_background(BackgroundJob(str(source), out=tmp_path / "out"))
    summary = summary_of(tmp_path / "out")
    assert summary["missing"] == [1, 30, 31]
    assert summary["missing_frames"] == 3
    assert len(masks_of(tmp_path / "out")) == N_FRAMES, "chains predict, and the prediction is written"
    assert count_frames(tmp_path / "out" / "film.mp4") == N_FRAMES - 1, "nothing to show before frame 2"


def test_frames_of_another_size_end_the_run_with_results_until_there(scene: Path, tmp_path: Path) -> None:
    source = tmp_path / "input"
    shutil.copytree(scene / "input", source)
    cv2.imwrite(str(source / "in000012.png"), np.zeros((50, 60, 3), np.uint8))
    with pytest.raises(ValueError, match="frame 12 is 60x50 colour, expected 128x96"):
        run_background(BackgroundJob(str(source), out=tmp_path / "out"))
    assert summary_of(tmp_path / "out")["frames"] == 11
    assert count_frames(tmp_path / "out" / "film.mp4") == 11


@pytest.mark.parametrize(("engine", "masks"), [*zip(get_args(Engine), itertools.cycle(["none", "video"]))])
def test_other_engines_and_forms_of_masks(engine: Any, masks: Any, scene: Path, tmp_path: Path) -> None:
    run_background(
        BackgroundJob(str(scene / "input"), out=tmp_path, engine=engine, stop=25, step=2, masks=masks)
    )
    assert summary_of(tmp_path)["frames"] == 13
    assert summary_of(tmp_path)["last_frame"] == 25
    assert (tmp_path / "foreground.mkv").exists() == (masks == "video")
    assert not (tmp_path / "foreground").exists()
    if engine == "stand-alone":
        assert (tmp_path / "tracks.txt").read_text() == ""


def test_region_of_interest(scene: Path, whole: Path, tmp_path: Path) -> None:
    run_background(BackgroundJob(str(scene / "input"), out=tmp_path, roi="0,0,64,96"))
    for name, data in masks_of(tmp_path).items():
        inside = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        everywhere = cv2.imread(str(whole / "foreground" / name), cv2.IMREAD_UNCHANGED)
        assert inside is not None
        assert everywhere is not None
        np.testing.assert_array_equal(inside[:, :64], everywhere[:, :64])
        assert not inside[:, 64:].any()
    inside_boxes = read_tracks(tmp_path / "tracks.txt")["box"]
    all_boxes = read_tracks(whole / "tracks.txt")["box"]
    feet = all_boxes[:, 0] + all_boxes[:, 2] / 2
    assert len(inside_boxes) == np.count_nonzero(feet.astype(int) < 64)


def test_parameters_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text("[background]\nprior = 0.6\nnoise = 40\nfollow_light = false\n")
    parameters = read_parameters(path)
    complete = with_defaults(parameters)
    assert complete["background"]["prior"] == 0.6
    assert complete["background"]["drift"] == with_defaults({})["background"]["drift"]
    background: Any = build_model("stand-alone", parameters).chains["background"]
    assert (background.prior, background.noise, background.follow_light) == (0.6, 40, False)
    assert set(complete) == set(SECTIONS)


def test_the_background_can_be_a_mixture(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text('[background]\nmodel = "mixture"\ncomponents = 4\n')
    parameters = read_parameters(path)
    background = build_model("recursive-bp", parameters).chains["background"]
    assert isinstance(background, MixtureBackground)
    assert background.components == 4
    complete = with_defaults(parameters)["background"]
    assert (complete["model"], complete["components"], complete["rate"]) == ("mixture", 4, background.rate)
    assert with_defaults({})["background"]["model"] == "gaussian"


def test_engines_differ_in_feedback_only() -> None:
    dual, forward = (build_model(engine) for engine in ("recursive-bp", "feed-forward"))
    assert dual.chains.keys() == forward.chains.keys()
    assert set(dual.senders["pixels"]) - set(forward.senders["pixels"]) == {"blobs"}
    assert list(build_model("stand-alone").chains) == ["background"]

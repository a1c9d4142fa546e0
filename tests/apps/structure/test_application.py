"""`rsmcm structure`, as a user runs it: on track files, on films, and with what can be wrong about them."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import Cylinder, cylinder
from rsmcm.inference import CoordinateAscent

from ...conftest import Command, names, summary_of, without_compiling
from ...support.reconstructions import write_film

run = Command("structure")
complaint = run.complaint

ALWAYS = {
    "cameras.json", "tracks.npz", "predictions.npz", "summary.json", "view.html", "state.npz",
    "manifest.json",
}  # fmt: skip
ALONE = ("--association", "none", "--camera", "affine")  # quicker, where it makes no difference
PX = 60.0  # per radius
CENTRE = np.array([100.0, 80.0])


def in_px(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return PX * positions + CENTRE


def track_file(path: Path, tracks: NDArray[np.float64]) -> Path:
    np.savez(path, tracks=tracks)
    return path


@pytest.fixture(scope="module")
def truth() -> Cylinder:
    return cylinder(n_points=20, n_frames=24, p_loose=0.03, p_drift=0.0, seed=4, degrees_per_frame=4)


@pytest.fixture(scope="module")
def tracks(truth: Cylinder) -> NDArray[np.float64]:
    """In whole 1/1024 px, so that shares of a picture of 1024 x 512 px are exact."""
    return np.round(1024 * in_px(truth.tracks())) / 1024


@pytest.fixture(scope="module")
def source(tracks: NDArray[np.float64], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return track_file(tmp_path_factory.mktemp("tracks") / "tracks.npz", tracks)


@pytest.fixture(scope="module")
def finished(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "out"
    assert run(source, "--out", out) == 0
    return out


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    write_film(folder, n_frames=16)
    return folder


# --- what a run leaves --------------------------------------------------------------------------------------


def test_files_of_a_run_on_tracks(finished: Path, tracks: NDArray[np.float64]) -> None:
    assert names(finished) == {*ALWAYS, "structure.ply"}
    summary = summary_of(finished)
    with np.load(finished / "tracks.npz") as content:
        found = dict(content)
    n_frames, n_points = found["observed"].shape
    assert found["position"].shape == (n_frames, n_points, 2)
    assert found["covariance"].shape == (n_frames, n_points, 2, 2)
    assert found["point_of_track"].shape == (tracks.shape[1],)
    assert np.isfinite(found["position"]).all()
    assert (np.linalg.eigvalsh(found["covariance"]) > 0).all()
    assert summary["frames"] == n_frames == 24
    assert summary["points"] == n_points
    assert summary["tracks"] == tracks.shape[1]
    assert summary["observations"] == np.count_nonzero(found["observed"])
    assert f"element vertex {n_points}\n".encode() in (finished / "structure.ply").read_bytes()
    report = (finished / "view.html").read_text()
    assert report.endswith("</html>\n")


def test_partial_tracks_become_points(finished: Path, truth: Cylinder, tracks: NDArray[np.float64]) -> None:
    summary = summary_of(finished)
    assert tracks.shape[1] > 25
    assert 20 <= summary["points"] <= 22
    assert summary["shape"] == "euclidean"
    assert summary["reprojection_rmse_px_per_point"] == pytest.approx(0.01 * PX * np.sqrt(2), rel=0.25)
    assert summary["noise_px_per_coordinate"] == pytest.approx(0.01 * PX, rel=0.25)


def test_error_in_the_summary_is_that_of_the_tracks(finished: Path, tracks: NDArray[np.float64]) -> None:
    """Root mean square distance between input and `position`, where a track was taken."""
    with np.load(finished / "tracks.npz") as content:
        taken = content["point_of_track"] >= 0
        expected = content["position"][:, content["point_of_track"][taken]]
    distances = np.linalg.norm(tracks[:, taken] - expected, axis=2)
    measured = np.sqrt(np.nanmean(distances**2))
    assert summary_of(finished)["reprojection_rmse_px_per_point"] == pytest.approx(measured, rel=0.05)


def test_a_film(film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(film, "--out", out) == 0
    assert names(out) >= {*ALWAYS, "structure.ply", "film.mp4"}
    summary = summary_of(out)
    assert summary["frames"] == 16
    assert summary["points"] >= 20
    assert summary["reprojection_rmse_px_per_point"] < 0.5
    video = cv2.VideoCapture(str(out / "film.mp4"))
    assert sum(iter(lambda: video.read()[0], False)) == 16
    assert "16 frames" in capfd.readouterr().out


# --- hard input ---------------------------------------------------------------------------------------------


def test_every_track_a_point(source: Path, tmp_path: Path) -> None:
    options = ("--start", 2, "--stop", 20, "--step", 2, "--coherence", "none")
    assert run(source, "--out", tmp_path, *options, *ALONE) == 0
    with np.load(tmp_path / "tracks.npz") as content:
        assert content["frame"].tolist() == list(range(2, 21, 2))
        kept = content["point_of_track"][content["point_of_track"] >= 0]
    assert len(np.unique(kept)) == len(kept) == summary_of(tmp_path)["points"]
    assert summary_of(tmp_path)["parameters"]["coherence"] == "none"


def test_a_frame_without_any_point(tracks: NDArray[np.float64], tmp_path: Path) -> None:
    holed = tracks.copy()
    holed[9:11] = np.nan
    assert run(track_file(tmp_path / "t.npz", holed), "--out", tmp_path / "out", *ALONE) == 0
    summary = summary_of(tmp_path / "out")
    assert any("frames 10, 11" in note for note in summary["notes"])
    with np.load(tmp_path / "out" / "tracks.npz") as content:
        assert not content["observed"][9:11].any()
        assert np.isfinite(content["position"]).all(), "the camera moves on smoothly"


def test_points_seen_once_never_and_twice(
    tracks: NDArray[np.float64], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    once, never = np.full((2, len(tracks), 1, 2), np.nan)
    once[5] = 70.0
    longest = int(np.argmax((~np.isnan(tracks[:, :, 0])).sum(axis=0)))
    odd = np.concatenate([tracks, once, never, tracks[:, [longest]]], axis=1)
    source = track_file(tmp_path / "t.npz", odd)
    assert run(source, "--out", tmp_path / "out", "--camera", "affine") == 0
    with np.load(tmp_path / "out" / "tracks.npz") as content:
        points = content["point_of_track"]
        assert np.isfinite(content["position"]).all()
    assert len(points) == odd.shape[1]
    assert points[-2] == -1, "never seen"
    assert points[-1] >= 0, "the double is a point, or the same one"
    assert "tracks belong to no point" in capfd.readouterr().out


def test_one_coordinate_of_a_position_is_used(
    truth: Cylinder, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A point that shows itself whole in two frames only is where it should be in all others."""
    lines, random = in_px(truth.observed), np.random.default_rng(0)
    frames, points = np.nonzero(truth.visible & (random.random(truth.visible.shape) < 0.2))
    lines[frames, points, random.integers(0, 2, len(frames))] = np.nan
    point = int(np.count_nonzero(truth.visible, axis=0).argmax())
    seen = np.flatnonzero(truth.visible[:, point])
    lines[seen, point] = in_px(truth.observed)[seen, point]
    lines[seen[2:], point, seen[2:] % 2] = np.nan
    n_half = int((np.isnan(lines).sum(axis=2) == 1).sum())
    source = track_file(tmp_path / "t.npz", lines)
    assert run(source, "--out", tmp_path / "out", *ALONE) == 0
    assert f"one known coordinate: {n_half}." in capfd.readouterr().out
    assert None not in summary_of(tmp_path / "out")["objective"]
    with np.load(tmp_path / "out" / "tracks.npz") as content:
        places, observed = content["position"][:, content["point_of_track"]], content["observed"]
    off = np.linalg.norm(places - in_px(truth.positions), axis=2)
    # medians: of points with few observations some may be far off
    assert np.median(off[seen, point]) < 2
    assert np.median(off) < 1.0
    whole = np.isfinite(lines).all(axis=2).sum()
    assert 0.97 * whole < observed.sum() <= whole  # one in 200 is taken for an outlier
    # what is not made for it says so
    assert "expected both coordinates or none" in Command("shape").complaint(
        capfd, source, "--bases", "2", "--out", tmp_path / "shape"
    )


@pytest.mark.parametrize(("noise", "n_points"), [(0.0, 15), (0.3, 60)])
def test_a_static_camera(
    noise: float, n_points: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    generator = np.random.default_rng(0)
    still = generator.uniform(20, 140, (1, n_points, 2)) + noise * generator.normal(size=(12, n_points, 2))
    source = track_file(tmp_path / "t.npz", still)
    assert run(source, "--out", tmp_path / "out", "--camera", "affine") == 1
    assert names(tmp_path / "out") == ALWAYS, "no structure.ply"
    assert summary_of(tmp_path / "out")["shape"] == "none"
    assert "The shape is undetermined, and none is given" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda t: t[:0], "got tracks (0, "),
        (
            lambda t: np.where(np.arange(24)[:, None, None] == 4, np.inf, t),
            "[inf, inf] at point 0 of frame 4",
        ),
    ],
)
def test_wrong_track_files(
    wrong: Any, words: str, tracks: NDArray[np.float64], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = track_file(tmp_path / "t.npz", wrong(tracks))
    message = complaint(capfd, source, "--out", tmp_path / "out")
    assert words in message
    assert "t.npz" in message
    assert not (tmp_path / "out").exists()


def test_wrong_sources(film: Path, source: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = ("--out", tmp_path / "out")
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    (tmp_path / "text.npz").write_text("text")
    for arguments, words in (
        ((tmp_path / "nowhere.npz", *out), "nowhere.npz: No such file"),
        ((tmp_path / "nowhere", *out), "no such file or folder"),
        ((tmp_path / "text.npz", *out), "got neither .npy nor .npz"),
        ((tmp_path / "other.npz", *out), "got points (3,) float64, expected"),
        ((source, *out, "--start", 25), "start: got 25, but"),
        ((source, *out, "--start", 0), "start: got 0"),
        ((source, *out, "--step", 0), "step: got 0"),
        ((source, *out, "--stop", 2, "--start", 3), "stop: got 2"),
        ((source, *out, "--coherence", "first"), "--coherence: got 'first', expected second-order or none"),
        ((source, *out, "--focal", -3), "--focal: got -3, expected px, more than 0"),
        ((source, *out, "--focal", 900, "--camera", "affine"), "--focal and --camera affine: got both"),
        ((source,), "--out is needed"),
    ):
        assert words in complaint(capfd, *arguments)
        assert not (tmp_path / "out").exists()


# --- output -------------------------------------------------------------------------------------------------


def test_existing_results(
    source: Path, finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in finished.iterdir()}
    message = complaint(capfd, source, "--out", finished)
    assert "already holds results: use --overwrite or --resume\n" in message
    complaint(capfd, source, "--out", finished, "--overwrite", "--start", 99)
    assert {path: path.read_bytes() for path in finished.iterdir()} == before
    file = tmp_path / "file"
    file.touch()
    assert "expected a folder" in complaint(capfd, source, "--out", file)


@pytest.mark.parametrize("n_rounds", [0, 1])
def test_control_c(
    n_rounds: int,
    source: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """A signal in the middle of a round ends the run with the last whole one, if there was any."""
    rounds = CoordinateAscent.rounds

    def interrupted(*arguments: Any, **more: Any) -> Iterator[Any]:
        for number, solution in enumerate(rounds(*arguments, **more)):
            if number == n_rounds:
                signal.raise_signal(signal.SIGINT)
            yield solution

    monkeypatch.setattr(CoordinateAscent, "rounds", interrupted)
    out = tmp_path / "out"
    assert run(source, "--out", out, "--camera", "affine") == 130
    assert out.exists() == bool(n_rounds)
    if n_rounds:
        assert summary_of(out)["ended_early"]
        assert names(out) >= ALWAYS
    assert without_compiling(capfd.readouterr().err) == (
        "" if n_rounds else "rsmcm: interrupted before there was any result\n"
    )

"""Films and tracks without depth: what `rsmcm structure` says is missing, why, and what to do."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.structure.diagnosis import no_points, no_shape
from rsmcm.chains import reconstruct
from rsmcm.chains.reconstruction import UNKNOWN_CAMERAS
from rsmcm.models.core.frame import Frame

from ...conftest import Command, names, summary_of
from ...support.fruitless import N_FRAMES, tracks_in_depth, tracks_on_wall, wall, write_pictures

run = Command("structure")
Image = NDArray[np.uint8]
ALONE = ("--association", "none")

WHY = {
    "still": "nothing moves",
    "zoom": "the camera only zooms",
    "rotation": "a camera that rotates and zooms in place",
    "plane": "one plane explains all motion",
}


def fails(source: Path, out: Path, capfd: pytest.CaptureFixture[str], *options: object) -> dict[str, Any]:
    """Run it; what is missing, why and what to do is everywhere, and nothing is empty or not a number."""
    capfd.readouterr()
    assert run(source, "--out", out, *options) == 1
    printed, complaint = capfd.readouterr()
    summary = summary_of(out)
    diagnosis: dict[str, Any] = summary["diagnosis"]
    page = (out / "view.html").read_text()
    for part in ("missing", "why", "advice"):
        assert diagnosis[part] in printed
        assert diagnosis[part] in summary["notes"]
        assert diagnosis[part].partition("'")[0] in page
    assert complaint.splitlines()[-1] == f"rsmcm: {source}: {diagnosis['missing']}"
    text = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"\bnan\b", printed + text, re.IGNORECASE)
    if not summary["points"]:
        assert 'data-plot="' not in page, "an empty plot"
        film = {"film.mp4", "view.npz"}
        assert names(out) - film == {"view.html", "summary.json", "state.npz", "manifest.json"}
    return diagnosis


def track_file(folder: Path, tracks: NDArray[np.float64]) -> Path:
    np.save(folder / "tracks.npy", tracks)
    return folder / "tracks.npy"


@pytest.mark.parametrize("kind", WHY)
def test_why_tracks_of_a_wall_have_no_depth(kind: str) -> None:
    tracks = tracks_on_wall(kind)
    diagnosis = no_shape("a flat shape explains them", tracks)
    assert "a flat shape explains them" in diagnosis.missing
    assert WHY[kind] in diagnosis.why
    assert "move" in diagnosis.advice.lower()
    figures = diagnosis.figures
    assert (figures["tracks"], figures["median_life_frames"]) == (60, 24)
    steps = np.median(np.linalg.norm(np.diff(tracks, axis=0), axis=2))
    assert figures["motion_px_per_frame"] == pytest.approx(steps, rel=0.1)
    # the noise of two pictures, 0.2 px each: of 120 residuals less what a homography fits
    assert figures["parallax_px_per_point"] == pytest.approx(0.4, rel=0.5)


def test_unknown_cameras_are_no_lack_of_depth() -> None:
    diagnosis = no_shape(UNKNOWN_CAMERAS, tracks_on_wall("plane"))
    assert diagnosis.missing.startswith("No camera is known")
    assert "nearer to each other" in diagnosis.advice


def test_tracks_of_a_plane_get_no_shape(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    diagnosis = fails(track_file(tmp_path, tracks_on_wall("plane")), tmp_path / "out", capfd, *ALONE)
    assert WHY["plane"] in diagnosis["why"]
    assert summary_of(tmp_path / "out")["shape"] == "none"
    assert not (tmp_path / "out" / "structure.ply").exists()


@pytest.mark.parametrize(("n_points", "n_frames"), [(15, 6), (15, 12), (15, 24), (40, 12)])
def test_still_points_are_given_no_shape(n_points: int, n_frames: int) -> None:
    """None of 420 films with 0.3 px noise was; a perspective camera would fit few of them by chance."""
    for seed in range(5):
        random = np.random.default_rng(seed)
        still = random.uniform(20, 140, (1, n_points, 2)) + 0.3 * random.normal(size=(n_frames, n_points, 2))
        assert reconstruct(still, association="none").geometry == "none"


@pytest.mark.parametrize(
    ("few", "words"),
    [
        (lambda t: t[:1], "1 frame to look at, and 3 are needed"),
        (lambda t: t[:2], "2 frames to look at, and 3 are needed"),
        (lambda t: t[:, :3], "3 points with an observation in 24 frames, and 4 are needed"),
    ],
)
def test_too_few(few: Any, words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    diagnosis = fails(track_file(tmp_path, few(tracks_in_depth())), tmp_path / "out", capfd)
    assert words in diagnosis["missing"]


def pictures(kind: str) -> list[Image]:
    if kind == "grey":
        return [np.full((120, 160), 90, np.uint8)] * 5
    if kind == "street":
        street = wall()[:240, :320].copy()
        return [
            cv2.rectangle(street.copy(), (20 * k, 90), (20 * k + 30, 200), 0, -1) for k in range(N_FRAMES)
        ]
    images = np.zeros((N_FRAMES, 120, 160), np.uint8)
    for number, image in enumerate(images):
        cv2.circle(image, (40 + 3 * number, 60), 3, 255, cv2.FILLED)
    return list(images)


@pytest.mark.parametrize(
    ("kind", "missing", "why"),
    [
        (
            "grey",
            "0 points can be tracked, and 4 are needed",
            "standard deviation of grey levels is 0 of 255",
        ),
        ("dot", "points can be tracked, and 4 are needed", "Only corners can be tracked"),
        ("street", "is in one place in all of them", "The camera stands still"),
    ],
)
def test_pictures(
    kind: str, missing: str, why: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source, out = write_pictures(tmp_path / "film", pictures(kind)), tmp_path / "out"
    diagnosis = fails(source, out, capfd)
    assert missing in diagnosis["missing"]
    assert why in diagnosis["why"]
    assert (out / "film.mp4").exists()
    before = (out / "summary.json").read_bytes()
    assert fails(source, out, capfd, "--resume") == diagnosis, "it is finished"
    assert (out / "summary.json").read_bytes() == before


def test_pictures_that_move_too_fast() -> None:
    """The tracks live one frame, so the motion is that of the pictures."""
    texture = wall()
    images = [texture[300:450, 300 + 33 * k : 500 + 33 * k] for k in range(6)]
    frames = [Frame(image, k / 25, k + 1) for k, image in enumerate(images)]
    tracks = np.full((6, 60, 2), np.nan)
    for k, row in enumerate(tracks):
        row[10 * k : 10 * k + 10] = np.random.default_rng(k).uniform(0, 150, (10, 2))
    diagnosis = no_points(frames, tracks, "")
    assert diagnosis.missing == "No structure: none of 60 tracks became a point of a shape."
    assert re.fullmatch(
        r"Half of the tracks live 1 frame or fewer; the pictures move by 3[234](\.\d)? px a frame\.",
        diagnosis.why,
    )
    assert "--step" in diagnosis.advice
    assert "--step" not in no_points(frames[:1] * 6, tracks, "").advice, "they stand still"
    long = np.random.default_rng(9).uniform(0, 150, (6, 20, 2))
    assert "do not belong to one rigid object: too few agree" in no_points(frames, long, "too few agree").why


def test_points_that_are_all_in_one_place(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "tracks.npz", tracks=np.full((10, 20, 2), 50.0))
    diagnosis = fails(tmp_path / "tracks.npz", tmp_path / "out", capfd)
    assert diagnosis["missing"] == "No structure: all 20 points are in one place in every frame."

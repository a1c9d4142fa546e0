"""Films and tracks without depth: what `rsmcm structure` says is missing, why, and what to do."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.structure.diagnosis import no_points
from rsmcm.inference.sfm.depth import picture_motion
from rsmcm.models.core.frame import Frame

from ...conftest import Command, names, summary_of
from ...support.fruitless import N_FRAMES, tracks_in_depth, tracks_on_wall, wall, write_pictures, write_wall

run = Command("structure")
Image = NDArray[np.uint8]

WHY = {
    "still": "nothing moves",
    "zoom": "the camera only zooms",
    "rotation": "a camera that turns and zooms where it stands",
    "plane": "one plane explains all motion",
}


def fails(source: Path, out: Path, capfd: pytest.CaptureFixture[str], *options: object) -> dict[str, Any]:
    """Run it; what is missing, why and what to do is everywhere, and nothing is empty or not a number."""
    capfd.readouterr()
    assert run(source, "--out", out, *options) == 1
    printed, complaint = capfd.readouterr()
    summary = summary_of(out)
    diagnosis: dict[str, Any] = summary["diagnosis"]
    report = (out / "view.html").read_text()
    for part in ("missing", "why", "advice"):
        assert diagnosis[part] in printed
        assert diagnosis[part] in summary["notes"]
        assert diagnosis[part].partition("'")[0] in report
    assert diagnosis["missing"] in complaint.splitlines()[-1]
    assert complaint.splitlines()[-1].startswith(f"rsmcm: {source}: ")
    said = re.sub(r"<script.*?</script>", "", report, flags=re.DOTALL)
    assert not re.search(r"\bnan\b", printed + said, re.IGNORECASE)
    if not summary["points"]:
        assert 'data-plot="' not in report, "an empty plot"
        film = {"film.mp4", "view.npz"}
        assert names(out) - film == {"view.html", "summary.json", "state.npz", "manifest.json"}
    return diagnosis


def track_file(folder: Path, tracks: NDArray[np.float64]) -> Path:
    np.save(folder / "tracks.npy", tracks)
    return folder / "tracks.npy"


@pytest.mark.parametrize("kind", WHY)
@pytest.mark.parametrize("association", ["dual-chain", "none"])
def test_tracks_of_a_wall(
    kind: str, association: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    tracks = tracks_on_wall(kind)
    found = fails(track_file(tmp_path, tracks), tmp_path / "out", capfd, "--association", association)
    assert WHY[kind] in found["why"]
    figures = found["figures"]
    assert 57 <= figures["tracks"] <= 60, "what no affine camera shows may pass for an outlier"
    assert figures["median_life_frames"] == 24
    steps = np.median(np.linalg.norm(np.diff(tracks, axis=0), axis=2))
    assert figures["motion_px_per_frame"] == pytest.approx(steps, rel=0.1)
    assert figures["parallax_px_per_point"] == pytest.approx(0.4, rel=0.5), "the noise of two pictures"
    assert "move" in found["advice"].lower()
    assert summary_of(tmp_path / "out")["shape"] == "none"
    assert not (tmp_path / "out" / "structure.ply").exists()


def test_tracks_in_depth_have_no_diagnosis(tmp_path: Path) -> None:
    assert run(track_file(tmp_path, tracks_in_depth()), "--out", tmp_path / "out") == 0
    summary = summary_of(tmp_path / "out")
    assert summary["diagnosis"] is None
    assert summary["shape"] == "euclidean"


@pytest.mark.parametrize(
    ("few", "words"),
    [
        (lambda t: t[:1], "1 frame to look at, and 3 are needed"),
        (lambda t: t[:2], "2 frames to look at, and 3 are needed"),
        (lambda t: t[:, :3], "3 points with an observation in 24 frames, and 4 are needed"),
        (lambda t: t * np.nan, "0 points with an observation in 24 frames, and 4 are needed"),
    ],
)
def test_too_few(few: Any, words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found = fails(track_file(tmp_path, few(tracks_in_depth())), tmp_path / "out", capfd)
    assert words in found["missing"]


def pictures(kind: str) -> list[Image]:
    random = np.random.default_rng(0)
    match kind:
        case "one":
            return [wall()[:120, :160]]
        case "grey":
            return [np.full((120, 160), 90, np.uint8)] * 5
        case "noise":
            return [random.integers(0, 256, (120, 160)).astype(np.uint8) for _ in range(N_FRAMES)]
        case _:
            images = np.zeros((N_FRAMES, 120, 160), np.uint8)
            for number, image in enumerate(images):
                cv2.circle(image, (40 + 3 * number, 60), 3, 255, cv2.FILLED)
            return list(images)


@pytest.mark.parametrize(
    ("kind", "missing", "why"),
    [
        ("one", "1 frame to look at, and 3 are needed", "several sides"),
        ("grey", "0 points can be followed, and 4 are needed", "grey levels deviate by 0 of 255"),
        ("dot", "points can be followed, and 4 are needed", "Only corners can be followed"),
        ("noise", "0 points can be followed, and 4 are needed", "must stay in view for some frames"),
    ],
)
def test_pictures(
    kind: str, missing: str, why: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    found = fails(write_pictures(tmp_path / "film", pictures(kind)), tmp_path / "out", capfd)
    assert missing in found["missing"]
    assert why in found["why"]
    assert "internal" not in found["why"]
    assert (tmp_path / "out" / "film.mp4").exists()


@pytest.mark.parametrize("kind", ["still", "rotation"])
def test_films_of_a_wall(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = write_wall(tmp_path / "film", kind)
    found = fails(source, tmp_path / "out", capfd, "--association", "none")
    assert WHY[kind] in found["why"]


def test_pictures_that_move_too_fast() -> None:
    """The tracks live one frame, so the motion is that of the pictures."""
    texture = wall()
    images = [texture[300:450, 300 + 33 * k : 500 + 33 * k] for k in range(6)]
    frames = [Frame(image, k / 25, k + 1) for k, image in enumerate(images)]
    tracks = np.full((6, 60, 2), np.nan)
    for k, row in enumerate(tracks):
        row[10 * k : 10 * k + 10] = np.random.default_rng(k).uniform(0, 150, (10, 2))
    found = no_points(frames, tracks, "")
    assert found.missing == "No structure: none of 60 tracks became a point of a shape."
    assert re.fullmatch(
        r"Half of the tracks live 1 frame or fewer; the pictures move by 3[23](\.\d)? px a frame\.", found.why
    )
    assert "--step" in found.advice
    assert "--step" not in no_points(frames[:1] * 6, tracks, "").advice, "they stand still"
    long = np.random.default_rng(9).uniform(0, 150, (6, 20, 2))
    assert "not of one rigid thing: too few agree" in no_points(frames, long, "too few agree").why


def test_a_run_that_found_nothing_is_finished(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source, out = write_pictures(tmp_path / "film", pictures("grey")), tmp_path / "out"
    first = fails(source, out, capfd)
    before = (out / "summary.json").read_bytes()
    assert fails(source, out, capfd, "--resume") == first
    assert (out / "summary.json").read_bytes() == before
    assert Command("batch")("structure", source, "--out", tmp_path / "many") == 1
    assert first["missing"] in (tmp_path / "many" / "summary.csv").read_text()


def test_motion_of_pictures() -> None:
    texture = wall()
    shifted = [texture[300 : 420 + 0, 300 + 12 * k : 460 + 12 * k] for k in range(4)]
    assert picture_motion(shifted) == pytest.approx(12, abs=0.5)
    assert np.isnan(picture_motion([np.zeros((50, 50), np.uint8)] * 3))
    assert np.isnan(picture_motion([]))

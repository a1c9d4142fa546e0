"""Folders of MOTChallenge: what is exported, and that its figures are those of TrackEval."""

from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.evaluation import evaluate_tracks
from rsmcm.apps.exports import to_motchallenge
from rsmcm.apps.io import read_ground_truth, read_tracks
from rsmcm.apps.io.tracks import TrackedBox, mot_line

from ...conftest import Command, names
from ..evaluation.test_tracks import scene

EXPORT = Command("export")

TRACKEVAL = [
    (0.2694610778443114, 0.3048780487804878, 0.2224534853675157),
    (0.4482758620689655, 0.47513812154696133, 0.37030685828257304),
    (0.39880952380952384, 0.39762611275964393, 0.27058282898776587),
    (0.45925925925925926, 0.44280442804428044, 0.3095082937441753),
    (0.4166666666666667, 0.35947712418300654, 0.26590591049992063),
    (0.42424242424242425, 0.44696969696969696, 0.296603729095669),
]
"""MOTA, IDF1 and mean HOTA of the files of `written` by TrackEval 1.3.0 (MotChallenge2DBox), by seed."""


def written(folder: Path, seed: int) -> tuple[Path, Path]:
    """A sequence's folder and a file of tracks; in odd ones, one object is a distractor."""
    rng = np.random.Generator(np.random.PCG64(seed))
    truth, tracks = scene(rng, 25, int(rng.integers(3, 9)))
    lines = []
    for number, identity, (x, y, width, height) in zip(truth.frame, truth.identity, truth.box, strict=True):
        how = "0,8,1" if identity == 0 and seed % 2 else "1,1,1"
        box = f"{x + 1:.2f},{y + 1:.2f},{width:.2f},{height:.2f}"
        lines.append(f"{number},{identity + 1},{box},{how}\n")
    (folder / "gt").mkdir()
    (folder / "gt" / "gt.txt").write_text("".join(lines))
    boxes = [(int(number), TrackedBox(int(identity) + 1, (*box,), 0.9)) for number, identity, *box in tracks]
    (folder / "found.txt").write_text("".join(mot_line(*each) + "\n" for each in boxes))
    return folder, folder / "found.txt"


@pytest.mark.parametrize("seed", range(len(TRACKEVAL)))
def test_figures_of_files_are_those_of_trackeval(tmp_path: Path, seed: int) -> None:
    folder, found = written(tmp_path, seed)
    scores = evaluate_tracks(read_tracks(found), read_ground_truth(folder), range(1, 26))
    assert (scores.mota, scores.idf1, scores.hota) == pytest.approx(TRACKEVAL[seed], rel=1e-12)


def test_a_run_is_written_as_it_wrote_itself(background: Path, tmp_path: Path) -> None:
    out = tmp_path / "tracker"
    assert EXPORT(background, "--to", "motchallenge", "--out", out) == 0
    assert names(out / "data") == {"background.txt"}
    assert (out / "data" / "background.txt").read_text() == (background / "tracks.txt").read_text()


def test_a_batch_over_a_benchmark_is_written_at_once(street: Path, tmp_path: Path) -> None:
    for name in ("S-01", "S-02"):
        (tmp_path / "train" / name).mkdir(parents=True)
        (tmp_path / "train" / name / "img1").symlink_to(street)
    batch = Command("batch")
    assert batch("background", tmp_path / "train", "--stop", 4, "--out", tmp_path / "runs", "--jobs", 1) == 0
    assert to_motchallenge(tmp_path / "runs", tmp_path / "tracker").endswith(" of 2 sequences")
    assert names(tmp_path / "tracker" / "data") == {"S-01.txt", "S-02.txt"}


def test_a_folder_without_runs_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    line = EXPORT.complaint(capfd, tmp_path, "--to", "motchallenge", "--out", tmp_path / "tracker")
    assert "holds no results of a finished run" in line
    assert names(tmp_path) == set()

"""Seeds of the body tracker on a film beside joints that were noted: comparison, verdicts, a run."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.experiments.body_film import FilmTrial, cells_of, expectations_of
from rsmcm.apps.io.files import write_image
from rsmcm.apps.scenes import signer
from rsmcm.chains.body.start import ClickedJoints
from rsmcm.models.body.upper_body import JOINTS

HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]


def noted_in(*frames: int) -> ClickedJoints:
    places = np.full((len(frames), 8, 2), np.nan)
    places[:, HANDS] = [(300, 100), (200, 100)]
    return ClickedJoints(Path("joints.csv"), np.array(frames), places)


def poses_with(hands: list[tuple[tuple[float, float], tuple[float, float]]]) -> dict[str, np.ndarray]:
    joints = np.zeros((len(hands), 8, 2))
    joints[:, HANDS] = hands
    return {
        "frames": np.arange(1, len(hands) + 1),
        "joints_2d": joints,
        "length_names": np.array(["head_width", "head_height"]),
        "lengths": np.array([60.0, 80.0]),
    }


def test_errors_are_those_of_the_frames_that_were_noted() -> None:
    trial = FilmTrial.of(
        poses_with([((300, 103), (200, 100)), ((0, 0), (0, 0)), ((200, 100), (300, 100))]), noted_in(1, 3)
    )
    np.testing.assert_allclose(trial.errors[:, HANDS], [[3, 0], [100, 100]])
    assert np.isnan(trial.errors[:, JOINTS.index("head")]).all()
    np.testing.assert_array_equal(trial.exchanged, [0, 1])
    assert cells_of(trial) == [51.5, 50.0, "–", 1, 1]


def test_one_bad_seed_is_found() -> None:
    right = FilmTrial(np.full((20, 8), 5.0), np.zeros(20), 0)
    wrong = replace(right, errors=np.full((20, 8), 100.0), exchanged=np.ones(20), longest=20)
    assert [each.verdict for each in expectations_of({"trials": [right] * 20})] == ["pass"] * 3
    found = expectations_of({"trials": [right] * 19 + [wrong]})
    assert [each.measured for each in found] == pytest.approx([5, 0.05, 1])
    assert [each.verdict for each in found] == ["pass", "pass", "short"]


@pytest.mark.slow
def test_the_command_on_a_generated_signer(tmp_path: Path) -> None:
    scene = signer(4, seed=3, clutter=0)
    (tmp_path / "film").mkdir()
    for number, image in enumerate(scene.images(), 1):
        write_image(tmp_path / "film" / f"{number:03}.png", image)
    lines = ["frame,joint,x,y"]
    for frame in (1, 4):
        for joint in ("left_hand", "right_hand"):
            x, y = scene.joints[frame - 1, JOINTS.index(joint), :2]
            lines.append(f"{frame},{joint},{x:.1f},{y:.1f}")
    joints = tmp_path / "joints.csv"
    joints.write_text("\n".join(lines))
    height, width = scene.body.head_height, scene.body.head_width
    x, y = scene.joints[0, 0, :2]
    head = f"{x - width / 2:.0f},{y - height / 2:.0f},{width:.0f},{height:.0f}"
    command = [
        sys.executable, "-m", "rsmcm.apps.experiments.body_film", str(tmp_path / "film"), str(joints),
        "--out", str(tmp_path / "out"), "--seeds", "2", "--jobs", "1", "--head", head,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [row[0] for row in results["tables"][0]["rows"]] == [0, 1]
    assert (tmp_path / "out" / "seed-1" / "film.mp4").is_file()
    joints.write_text("frame,joint\n")
    wrong = subprocess.run(command, capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stderr.count("\n") == 1

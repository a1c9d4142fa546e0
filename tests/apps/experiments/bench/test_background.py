"""What is judged of a command: the part of a film behind its beginning, and when it has answered."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from rsmcm.apps.experiments.bench import background as command
from rsmcm.apps.io.files import write_image
from rsmcm.apps.scenes import sleeping_man


def test_what_is_done_once_counts_for_the_whole_film_only() -> None:
    frames = command.LONG - command.SHORT
    for once in (0.5, 3.0):
        spent = {"short": once + 0.25, "long": once + 0.25 + 0.01 * frames}
        spent |= {"begun": 0.3, "engine": 0.3 + 0.008 * frames}
        rate, whole, engine, over = command.of_commands(spent)
        assert rate.measured == pytest.approx(100)
        assert whole.measured == pytest.approx(command.LONG / spent["long"])
        assert engine.measured == pytest.approx(8)
        assert (over.measured, over.verdict) == (pytest.approx(1.25), "pass")


@pytest.mark.slow
def test_the_moments_are_those_of_frames_that_are_answered(tmp_path: Path) -> None:
    for frame in sleeping_man(3, size=(64, 48)):
        assert frame.image is not None
        write_image(tmp_path / f"{frame.number}.png", frame.image)
    arguments = ["--quiet", "background", str(tmp_path), "--out", str(tmp_path / "out")]
    before = time.time()
    done = subprocess.run(
        [sys.executable, "-m", command.__name__, *arguments], check=True, capture_output=True, text=True
    )
    first, last = map(float, done.stdout.split())
    assert before < first < last < time.time()
    assert (tmp_path / "out" / "summary.json").exists()

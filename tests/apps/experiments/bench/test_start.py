"""The command that says when it has answered its first frame and its last one."""

import subprocess
import sys
import time
from pathlib import Path

from rsmcm.apps.experiments.bench import start
from rsmcm.apps.io.files import write_image
from rsmcm.apps.scenes import sleeping_man


def test_the_moments_are_those_of_frames_that_are_answered(tmp_path: Path) -> None:
    for frame in sleeping_man(3, size=(64, 48)):
        assert frame.image is not None
        write_image(tmp_path / f"{frame.number}.png", frame.image)
    arguments = ["--quiet", "background", str(tmp_path), "--out", str(tmp_path / "out")]
    before = time.time()
    done = subprocess.run(
        [sys.executable, "-m", start.__name__, *arguments], check=True, capture_output=True, text=True
    )
    first, last = map(float, done.stdout.split())
    assert before < first < last < time.time()
    assert (tmp_path / "out" / "summary.json").exists()

"""How long the command takes to its first frames: with compiled loops on disk, and without any.

`python -m rsmcm.apps.experiments.bench.start ARGUMENTS` is the command `rsmcm`, which says when it has
answered its first frame and its last one.
"""

import os
import runpy
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

from ..expectations import Expectation
from .whole_command import film_for

COLD_ROUNDS, WARM_ROUNDS = 2, 5

FRAMES = 40
"""By which all loops have been called: there are objects, and the camera was looked at."""

Answered = tuple[float, float]
"""s from the start of the process to the answers to the first frame and to the last one."""


def start_expectations() -> list[Expectation]:
    """Seconds to the first frame and to the 40th, cold and warm, and to the help."""
    found: list[Expectation] = []
    with tempfile.TemporaryDirectory() as folder:
        film = film_for(Path(folder))
        for name, rounds, bounds in (("cold", COLD_ROUNDS, (10, None)), ("warm", WARM_ROUNDS, (2, None))):
            answered = []
            for number in range(rounds):
                cache = Path(folder) / (f"cache{number}" if name == "cold" else "cache0")
                answered.append(_answered(film, Path(folder), cache))
            for which, times, bound in zip(
                ("first", f"{FRAMES}th"), zip(*answered, strict=True), bounds, strict=True
            ):
                what = f"start, {name}: s from the command to the {which} frame answered"
                found.append(Expectation(what, statistics.median(times), "<=", bound))
    return [*found, Expectation("start: s of rsmcm --help", _help_seconds(), "<=", 0.5)]


def _answered(film: Path, folder: Path, cache: Path) -> Answered:
    arguments = ["background", str(film), "--stop", str(FRAMES), "--out", str(folder / "out"), "--overwrite"]
    started = time.time()
    done = subprocess.run(
        [sys.executable, "-m", __name__, "--quiet", *arguments],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
    )
    first, last = (float(word) for word in done.stdout.split())
    return first - started, last - started


def _help_seconds() -> float:
    seconds = []
    for _ in range(WARM_ROUNDS):
        started = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "rsmcm.apps.command_line", "--help"], check=True, capture_output=True
        )
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)


def main() -> None:
    """The command, which says when (s since 1970) it answered its first frame and its last one."""
    from ...view.film import FilmWriter

    moments: list[float] = []
    add = FilmWriter.add

    def noted(*arguments: Any) -> None:
        moments.append(time.time())
        add(*arguments)

    with patch.object(FilmWriter, "add", noted):
        try:
            runpy.run_module("rsmcm.apps.command_line", run_name="__main__")
        finally:
            print(moments[0], moments[-1])


if __name__ == "__main__":
    main()

"""The command `rsmcm background`: how fast it is beside its engine, and how soon it answers.

`python -m rsmcm.apps.experiments.bench.command ARGUMENTS` is the command `rsmcm`, which says when its engine
has answered its first frame and its last one.
"""

import os
import runpy
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from ....inference import RecursiveBP
from ....models.numerics.threads import set_threads
from ...io.files import PLAYABLE, SegmentedVideo
from ...io.sources.open_source import open_source
from ...scenes import sleeping_man
from ..compare import Model
from ..datasets import data_folder
from ..expectations import Expectation
from ..experiment import Findings
from .background import SIZE, image_of
from .timing import in_turns, over_rounds

SHORT, LONG = 50, 250
"""Frames. A short part of the film is taken from a long one, so that what is done once counts in neither."""

ROUNDS = 7
THREADS = 2
RATE = 10.0

COLD_ROUNDS, WARM_ROUNDS = 2, 5
FRAMES = 40
"""By which all loops have been called: there are objects, and the camera was looked at."""


def whole_command() -> Findings:
    """Frames a second of the command, and what it needs beyond its engine, with two threads."""
    set_threads(THREADS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        film = film_for(folder)
        with open_source(str(film), stop=LONG) as source:
            frames = list(source)

        def command(stop: int) -> None:
            arguments = ["background", str(film), "--stop", str(stop), "--masks", "video"]
            arguments += ["--out", str(folder / "out"), "--overwrite"]
            rsmcm = [sys.executable, "-m", "rsmcm.apps.command_line", "--threads", str(THREADS)]
            subprocess.run([*rsmcm, *arguments], check=True, stdout=subprocess.DEVNULL)

        def engine(stop: int) -> None:
            model = Model("RSMCM", "recursive-bp", SIZE)
            for frame in frames[:stop]:
                model.step(frame)

        methods = {
            "short": lambda: command(SHORT),
            "long": lambda: command(LONG),
            "begun": lambda: engine(SHORT),
            "engine": lambda: engine(LONG),
        }
        spent = in_turns(methods, ROUNDS)
    return Findings("The whole command", [], over_rounds(of_commands, spent))


def of_commands(seconds: Mapping[str, float]) -> Sequence[Expectation]:
    """What seconds of short and long parts mean."""
    whole, alone = seconds["long"] - seconds["short"], seconds["engine"] - seconds["begun"]
    what = "whole command, two threads"
    return [
        Expectation(f"{what}: frames a second", (LONG - SHORT) / whole, ">=", 200),
        Expectation(f"{what}: the same of {LONG} frames with imports and report", LONG / seconds["long"]),
        Expectation(f"{what}: its engine alone, ms a frame", 1e3 * alone / (LONG - SHORT)),
        Expectation(f"{what}: time over that of its engine", whole / alone, "<=", 1.3),
    ]


def film_for(folder: Path) -> Path:
    """PETS2009 S2.L1 where it can be found, else a generated scene, as a file in the folder."""
    try:
        return data_folder("pets2009-s2l1") / "vtest.avi"
    except OSError:
        path = folder / "film.mp4"
        film = SegmentedVideo(path, RATE, PLAYABLE)
        for frame in sleeping_man(LONG, size=SIZE):
            film.write(image_of(frame), frame.number, frame.time)
        film.close(finished=True)
        return path


def start() -> Findings:
    """Seconds to the first frame and the 40th, with compiled loops on disk and without, and to the help."""
    found: list[Expectation] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arguments = ["background", str(film_for(folder)), "--stop", str(FRAMES), "--out", str(folder / "out")]
        for kind, rounds, bound in (("cold", COLD_ROUNDS, 10), ("warm", WARM_ROUNDS, 2)):
            answered = []
            for number in range(rounds):
                cache, started = folder / f"cache{number if kind == 'cold' else 0}", time.time()
                done = subprocess.run(
                    [sys.executable, "-m", __name__, "--quiet", *arguments, "--overwrite"],
                    check=True,
                    capture_output=True,
                    text=True,
                    env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
                )
                answered.append([float(word) - started for word in done.stdout.split()])
            first, last = map(statistics.median, zip(*answered, strict=True))
            what = f"start, {kind}: s from the command to the {{}} frame answered"
            found.append(Expectation(what.format("first"), first, "<=", bound))
            found.append(Expectation(what.format(f"{FRAMES}th"), last))
    command = [sys.executable, "-m", "rsmcm.apps.command_line", "--help"]
    spent = in_turns({"help": lambda: subprocess.run(command, check=True, capture_output=True)}, WARM_ROUNDS)
    found.append(Expectation("start: s of rsmcm --help", statistics.median(spent["help"]), "<=", 0.5))
    return Findings("Time to the first frame", [], found)


def main() -> None:
    """The command, which says when (s since 1970) its engine answered its first frame and its last one."""
    moments: list[float] = []
    step = RecursiveBP.step

    def noted(*arguments: Any) -> Any:
        answer = step(*arguments)
        moments.append(time.time())
        return answer

    with patch.object(RecursiveBP, "step", noted):
        try:
            runpy.run_module("rsmcm.apps.command_line", run_name="__main__")
        finally:
            print(moments[0], moments[-1])


if __name__ == "__main__":
    main()

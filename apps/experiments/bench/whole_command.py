"""The command `rsmcm background` on a film, with all that it writes, beside its engine on frames in memory.

Of the command, a short part of the film is taken from a long one, so that what is done once (imports, report)
counts in neither; all of it is in the row about the whole film.
"""

import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ....models import Frame
from ....models.numerics.threads import set_threads
from ...io.datasets import data_folder
from ...io.segmented_video import PLAYABLE, SegmentedVideo
from ...io.sources.open_source import open_source
from ...scenes import sleeping_man
from ..compare import Model
from ..expectations import Expectation
from .timing import in_turns, over_rounds

SHORT, LONG = 50, 250
"""Frames."""

ROUNDS = 7
THREADS = 2
SIZE, RATE = (768, 576), 10.0


def whole_command_expectations() -> list[Expectation]:
    """Frames a second of the command, and what it needs beyond its engine, with two threads."""
    set_threads(THREADS)
    with tempfile.TemporaryDirectory() as folder:
        film = film_for(Path(folder))
        with open_source(str(film), stop=LONG) as source:
            frames = list(source)
        spent = in_turns(
            {
                "short": lambda: command(film, SHORT, Path(folder)),
                "long": lambda: command(film, LONG, Path(folder)),
                "begun": lambda: engine(frames[:SHORT]),
                "engine": lambda: engine(frames),
            },
            ROUNDS,
        )
    return over_rounds(_of_commands, spent)


def _of_commands(seconds: Mapping[str, float]) -> Sequence[Expectation]:
    whole, alone = seconds["long"] - seconds["short"], seconds["engine"] - seconds["begun"]
    said = "whole command, two threads: {}".format
    return [
        Expectation(said("frames a second"), (LONG - SHORT) / whole, ">=", 200),
        Expectation(said(f"the same of {LONG} frames with imports and report"), LONG / seconds["long"]),
        Expectation(said("its engine alone, ms a frame"), 1e3 * alone / (LONG - SHORT)),
        Expectation(said("time over that of its engine"), whole / alone, "<=", 1.3),
    ]


def command(film: Path, stop: int, folder: Path) -> None:
    """Run the command on the first frames of a film, with masks as a video."""
    arguments = [
        "background",
        str(film),
        "--stop",
        str(stop),
        "--masks",
        "video",
        "--out",
        str(folder / "out"),
    ]
    whole = [sys.executable, "-m", "rsmcm.apps.command_line", "--threads", str(THREADS), *arguments]
    subprocess.run([*whole, "--overwrite"], check=True, stdout=subprocess.DEVNULL)


def engine(frames: Sequence[Frame]) -> None:
    """Run the same chains on frames in memory, with masks and tracks."""
    model = Model("RSMCM", "recursive-bp", SIZE)
    for frame in frames:
        model.step(frame)


def film_for(folder: Path) -> Path:
    """PETS2009 S2.L1 where it can be found, else a generated scene, as a file in the folder."""
    try:
        return data_folder("pets2009-s2l1") / "vtest.avi"
    except OSError:
        path = folder / "film.mp4"
        film = SegmentedVideo(path, RATE, PLAYABLE)
        for frame in sleeping_man(LONG, size=SIZE):
            assert frame.image is not None
            film.write(frame.image, frame.number, frame.time)
        film.close(finished=True)
        return path

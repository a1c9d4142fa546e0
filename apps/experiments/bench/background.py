"""Background and tracking beside OpenCV's subtractors, the command beside its engine, and when it answers.

`python -m rsmcm.apps.experiments.bench.background ARGUMENTS` is the command `rsmcm`, which says when its
engine has answered its first frame and its last one.
"""

import os
import runpy
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray

from ....inference import MultiChain, RecursiveBP, RunState
from ....models import Frame, PixelLabels
from ....models.numerics.threads import set_threads
from ...background.application import build_model, read_frame_result
from ...background.parameters import build_chain
from ...io.files import PLAYABLE, SegmentedVideo
from ...io.sources.open_source import open_source
from ...scenes import sleeping_man
from ...scenes.crowd import crowd
from ..compare import Model
from ..datasets import data_folder
from ..experiment import Findings
from ..record import Expectation
from .timing import ROUNDS, in_turns, over_frames, over_rounds

SIZE = (768, 576)
N_FRAMES = 240  # preloaded: 320 MB
TURN = 20  # frames that a method works on before it is another one's turn
WARM_UP = 40  # frames that do not count
WANTED = {1: (0.12, 0.35, 0.45), 2: (0.15, 0.45, 0.6)}
"""By threads: of the background alone, with blobs, and with the ground plane, over MOG2."""

LARGE, N_OBJECTS = (1920, 1080), 20
WANTED_LARGE = {1: 0.3, 2: 0.4}
CROWD_TURN, CROWD_WARM_UP = 6, 30  # frames, of scenes with a crowd, which is found in the first second

SHORT, LONG = 50, 250
"""Frames. A short part of the film is taken from a long one, so that what is done once counts in neither."""
COMMAND_ROUNDS, COMMAND_THREADS = 7, 2
COLD_ROUNDS, WARM_ROUNDS = 2, 5
FRAMES = 40  # by which all loops have been called: there are objects, and the camera was looked at

Image = NDArray[np.uint8]

# --- what is timed ------------------------------------------------------------------------------------------


def preloaded(n_frames: int = N_FRAMES, **generated: Any) -> Sequence[Frame]:
    """Return frames of PETS2009 S2.L1 where it can be found, else of a generated scene."""
    try:
        film = str(data_folder("pets2009-s2l1") / "vtest.avi")
    except OSError:
        return list(sleeping_man(n_frames, **{"size": SIZE, **generated}))
    with open_source(film, stop=n_frames) as source:
        return list(source)


def write_film(path: Path, images: Iterable[Image], rate: float) -> Path:
    """Write pictures as a video file, `rate` a second."""
    film = SegmentedVideo(path, rate, PLAYABLE)
    for number, image in enumerate(images, start=1):
        film.write(image, number, (number - 1) / rate)
    film.close()
    return path


def in_steps(model: MultiChain) -> Callable[[Frame], object]:
    """Return a function that takes frame after frame and gives mask and tracks by a model.

    OpenCV has one thread meanwhile, as in the command.
    """
    engine, state = RecursiveBP(model), RunState()

    def step(frame: Frame) -> object:
        nonlocal state
        cv2.setNumThreads(1)
        belief = engine.step(state, frame)
        state = belief.state
        height, width = image_of(frame).shape[:2]
        return read_frame_result(belief, (width, height))

    return step


def subtracting(subtractor: cv2.BackgroundSubtractor, threads: int) -> Callable[[Frame], object]:
    """Return a function that takes frame after frame and gives OpenCV's masks."""

    def step(frame: Frame) -> object:
        cv2.setNumThreads(threads)  # which takes no time where it has as many
        return subtractor.apply(image_of(frame))

    return step


def image_of(frame: Frame) -> Image:
    """Return the picture of a frame that has one."""
    assert frame.image is not None
    return frame.image


def _on(threads: int) -> str:
    return f"{threads} thread{'s' if threads > 1 else ''}"


# --- chains beside subtractors ------------------------------------------------------------------------------


def speeds() -> Findings:
    """Measure at the size of PETS, on one thread and on two."""
    frames, expectations = preloaded(), list[Expectation]()
    for threads, wanted in WANTED.items():
        set_threads(threads)
        pixels = PixelLabels()  # without the ground plane and a detector's rates
        pair = MultiChain().connect(build_chain("background", {}), pixels)
        awake = MultiChain().connect(build_chain("background", {"background": {"sleep": False}}), pixels)
        steps = {
            "MOG2": subtracting(cv2.createBackgroundSubtractorMOG2(), threads),
            "KNN": subtracting(cv2.createBackgroundSubtractorKNN(), threads),
            "background alone with mask": in_steps(build_model("stand-alone")),
            "no block asleep": in_steps(awake),
            "background and blobs": in_steps(pair.connect(build_chain("blobs", {}), pixels)),
            "feed-forward": in_steps(build_model("feed-forward")),
            "with the ground plane": in_steps(build_model()),
        }
        spent = over_frames(steps, frames, TURN, WARM_UP)
        expectations += over_rounds(partial(_of_speeds, _on(threads), wanted), spent)
    return Findings("Background and tracking beside MOG2", [], expectations)


def _of_speeds(at: str, wanted: Sequence[float], seconds: Mapping[str, float]) -> list[Expectation]:
    ours = ("background alone with mask", "background and blobs", "with the ground plane")
    mog2, three = seconds["MOG2"], seconds[ours[-1]]
    alone, awake = seconds[ours[0]], seconds["no block asleep"]
    peer = min(mog2, seconds["KNN"])
    return [
        *(Expectation(f"{at}: {name}, ms a frame", 1e3 * seconds[name]) for name in ("MOG2", "KNN", *ours)),
        *(
            Expectation(f"{at}: {name} over MOG2", seconds[name] / mog2, "<=", bound)
            for name, bound in zip(ours, wanted, strict=True)
        ),
        Expectation(f"{at}: background alone over the same with no block asleep", alone / awake, "<=", 1.0),
        Expectation(f"{at}: with the ground plane over the faster of MOG2 and KNN", three / peer),
        Expectation(f"{at}: feedback over feed-forward", three / seconds["feed-forward"], "<=", 1.03),
    ]


def large() -> Findings:
    """Measure in a large picture with a crowd, on one thread and on two."""
    frames = list(crowd(N_OBJECTS, CROWD_WARM_UP + ROUNDS * CROWD_TURN, LARGE[::-1]))
    expectations: list[Expectation] = []
    for threads, wanted in WANTED_LARGE.items():
        set_threads(threads)
        mog2 = subtracting(cv2.createBackgroundSubtractorMOG2(), threads)
        steps = {"MOG2": mog2, "ours": in_steps(build_model())}
        spent = over_frames(steps, frames, CROWD_TURN, CROWD_WARM_UP)
        at = f"{_on(threads)}, {LARGE[0]}x{LARGE[1]}, {N_OBJECTS} objects"
        expectations += over_rounds(partial(_of_large, at, wanted), spent)
    return Findings("A large picture with a crowd", [], expectations)


def _of_large(at: str, wanted: float, seconds: Mapping[str, float]) -> list[Expectation]:
    ours, mog2 = seconds["ours"], seconds["MOG2"]
    return [
        Expectation(f"{at}: MOG2, ms a frame", 1e3 * mog2),
        Expectation(f"{at}: all chains, ms a frame", 1e3 * ours),
        Expectation(f"{at}: all chains over MOG2", ours / mog2, "<=", wanted),
    ]


# --- the command --------------------------------------------------------------------------------------------


def whole_command() -> Findings:
    """Measure frames a second of the command, and its time beyond its engine, with two threads."""
    set_threads(COMMAND_THREADS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        film = _film_in(folder)
        with open_source(str(film), stop=LONG) as source:
            frames = list(source)

        def command(stop: int) -> None:
            arguments = ["background", str(film), "--stop", str(stop), "--masks", "video"]
            arguments += ["--out", str(folder / "out"), "--overwrite"]
            rsmcm = [sys.executable, "-m", "rsmcm.apps.command_line", "--threads", str(COMMAND_THREADS)]
            subprocess.run(
                [*rsmcm, *arguments],
                check=True,
                stdout=subprocess.DEVNULL,
                env=_with_compiled_modules(folder),
            )

        def engine(stop: int) -> None:
            model = Model("RSMCM", "recursive-bp", SIZE)
            for frame in frames[:stop]:
                model.step(frame)

        methods = {
            "short": partial(command, SHORT),
            "long": partial(command, LONG),
            "begun": partial(engine, SHORT),
            "engine": partial(engine, LONG),
        }
        spent = in_turns(methods, COMMAND_ROUNDS)
    return Findings("The whole command", [], over_rounds(of_commands, spent))


def of_commands(seconds: Mapping[str, float]) -> Sequence[Expectation]:
    """Return figures from the seconds of short and long parts."""
    whole, alone = seconds["long"] - seconds["short"], seconds["engine"] - seconds["begun"]
    what = "whole command, two threads"
    return [
        Expectation(f"{what}: frames a second", (LONG - SHORT) / whole, ">=", 200),
        Expectation(f"{what}: the same of {LONG} frames with imports and report", LONG / seconds["long"]),
        Expectation(f"{what}: its engine alone, ms a frame", 1e3 * alone / (LONG - SHORT)),
        Expectation(f"{what}: time over that of its engine", whole / alone, "<=", 1.3),
        Expectation(
            f"{what}: the same with imports and report", seconds["long"] / seconds["engine"], "<=", 1.6
        ),
    ]


def _with_compiled_modules(folder: Path) -> dict[str, str]:
    """An environment in which Python keeps its compiled modules, as an installed package has them."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPYCACHEPREFIX": str(folder / "modules")}


def _film_in(folder: Path) -> Path:
    """PETS2009 S2.L1 where it can be found, else a generated scene, as a file in the folder."""
    try:
        return data_folder("pets2009-s2l1") / "vtest.avi"
    except OSError:
        return write_film(folder / "film.mp4", map(image_of, sleeping_man(LONG, size=SIZE)), 10.0)


def start() -> Findings:
    """Measure seconds to the first frame and the 40th, with compiled loops on disk and without, and to the
    help.
    """
    found: list[Expectation] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arguments = ["background", str(_film_in(folder)), "--stop", str(FRAMES), "--out", str(folder / "out")]
        command = [sys.executable, "-m", __name__, "--quiet", *arguments, "--overwrite"]
        for kind, rounds, bound in (("cold", COLD_ROUNDS, 10), ("warm", WARM_ROUNDS, 2)):
            answered = []
            for number in range(rounds):
                cache, started = folder / f"cache{number if kind == 'cold' else 0}", time.time()
                environment = {**_with_compiled_modules(folder), "NUMBA_CACHE_DIR": str(cache)}
                done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
                answered.append([float(word) - started for word in done.stdout.split()])
            first, last = map(statistics.median, zip(*answered, strict=True))
            what = f"start, {kind}: s from the command to the {{}} frame answered"
            found.append(Expectation(what.format("first"), first, "<=", bound))
            found.append(Expectation(what.format(f"{FRAMES}th"), last))
        command = [sys.executable, "-m", "rsmcm.apps.command_line", "--help"]
        shown = partial(subprocess.run, command, check=True, capture_output=True, env=environment)
        spent = in_turns({"help": shown}, WARM_ROUNDS)
    found.append(Expectation("start: s of rsmcm --help", statistics.median(spent["help"]), "<=", 0.5))
    return Findings("Time to the first frame", [], found)


def main() -> None:
    """Run the command, and print when (s since 1970) its engine had done its first and its last frame."""
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

"""Background and tracking beside OpenCV's subtractors, masks included, at equal numbers of threads."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ....inference import MultiChain, RecursiveBP, RunState
from ....models import Frame, PixelLabels
from ....models.numerics.threads import set_threads
from ...background.application import build_model, found_in
from ...background.parameters import build_chain
from ...io.datasets import data_folder
from ...io.sources.open_source import open_source
from ...runs.progress import Progress
from ...scenes import sleeping_man
from ..expectations import Expectation
from ..experiment import Experiment
from ..measuring.machine import moving
from ..measuring.stages import n_bytes, of_chain, shares, stages
from ..record import Table
from .crowd_scene import crowd
from .timing import ROUNDS, Spent, over_frames, over_rounds

SIZE = (768, 576)
N_FRAMES = 240  # preloaded: 320 MB
TURN = 20  # frames that a method works on before it is another one's turn
WARM_UP = 40  # frames that do not count
WANTED = {1: (0.12, 0.35, 0.45), 2: (0.15, 0.45, 0.6)}
"""By threads: of the background alone, with blobs, and with the ground plane, over MOG2."""

LARGE, N_OBJECTS = (1920, 1080), 20
WANTED_LARGE = {1: 0.3, 2: 0.4}
MIDDLE, FEW, MANY = (1280, 720), 10, 100
CROWD_TURN, CROWD_WARM_UP = 6, 30
"""Frames, of scenes with a crowd, which is found in the first second."""

Image = NDArray[np.uint8]


def speeds() -> Experiment:
    """At the size of PETS, on one thread and on two."""
    frames, label = preloaded()
    expectations: list[Expectation] = []
    for threads, wanted in WANTED.items():
        set_threads(threads)
        spent, limit = _spent(frames, threads), _limit(frames, threads)
        expectations += over_rounds(partial(_of_speeds, _on(threads), wanted, limit), spent)
    film = f"{len(frames)} frames of {label}, {SIZE[0]}x{SIZE[1]} colour, preloaded"
    where = shares(stages(build_model(), frames)[0][WARM_UP:])
    table = Table(("stage", "ms", "share, %"), where, f"Where the time of a frame goes, two threads; {film}.")
    return Experiment("Background and tracking beside MOG2", [table], expectations)


def large() -> Experiment:
    """In a large picture with a crowd, on one thread and on two."""
    frames = list(crowd(N_OBJECTS, CROWD_WARM_UP + ROUNDS * CROWD_TURN, LARGE[::-1]))
    expectations: list[Expectation] = []
    for threads, wanted in WANTED_LARGE.items():
        set_threads(threads)
        mog2 = subtracting(cv2.createBackgroundSubtractorMOG2(), threads)
        steps = {"MOG2": mog2, "three": in_steps(build_model())}
        spent, limit = over_frames(steps, frames, CROWD_TURN, CROWD_WARM_UP), _limit(frames, threads)
        at = f"{_on(threads)}, {LARGE[0]}x{LARGE[1]}, {N_OBJECTS} objects"
        expectations += over_rounds(partial(_of_large, at, wanted, limit), spent)
    return Experiment("A large picture with a crowd", [], expectations)


def objects() -> Experiment:
    """What the tracker takes for many objects, beside what it takes for few."""
    set_threads(1)
    spent = {}
    for count in (FEW, MANY):
        frames = list(crowd(count, CROWD_WARM_UP + ROUNDS * CROWD_TURN, MIDDLE[::-1]))
        seconds = [of_chain("blobs", each) for each in stages(build_model(), frames)[0][CROWD_WARM_UP:]]
        spent[count] = np.reshape(seconds, (ROUNDS, CROWD_TURN)).mean(axis=1).tolist()
    return Experiment("Many objects", [], over_rounds(_of_objects, {str(n): spent[n] for n in spent}))


def _of_objects(seconds: Mapping[str, float]) -> list[Expectation]:
    few, many = seconds[str(FEW)], seconds[str(MANY)]
    what = f"tracker of blobs, {MIDDLE[0]}x{MIDDLE[1]}, 1 thread"
    return [
        Expectation(f"{what}: {FEW} objects, ms a frame", 1e3 * few),
        Expectation(f"{what}: {MANY} objects, ms a frame", 1e3 * many),
        Expectation(f"{what}: {MANY} objects over {FEW}, time", many / few, "<=", 3.0),
    ]


def preloaded() -> tuple[list[Frame], str]:
    """Frames of PETS2009 S2.L1 where they can be found, else of a generated scene, and which they are."""
    try:
        with open_source(str(data_folder("pets2009-s2l1") / "vtest.avi"), stop=N_FRAMES) as source:
            return list(source), "PETS2009 S2.L1"
    except OSError:
        scene = sleeping_man(N_FRAMES, size=SIZE)
        with Progress("scene", N_FRAMES) as progress:
            frames = []
            for frame in scene:
                frames.append(frame)
                progress.update()
        return frames, "a generated scene"


# --- what takes in frames -----------------------------------------------------------------------------------


def in_steps(model: MultiChain) -> Callable[[Frame], object]:
    """A model of the background application: mask and tracks of frame after frame.

    OpenCV has one thread meanwhile, as in the command.
    """
    engine, state = RecursiveBP(model), RunState()

    def step(frame: Frame) -> object:
        nonlocal state
        cv2.setNumThreads(1)
        belief = engine.step(state, frame)
        state = belief.state
        height, width = _image(frame).shape[:2]
        return found_in(belief, (width, height))

    return step


def background_and_blobs() -> MultiChain:
    """The dual chain, without the ground plane and a detector's rates."""
    pixels = PixelLabels()
    model = MultiChain().connect(build_chain("background", {}), pixels)
    return model.connect(build_chain("blobs", {}), pixels)


def subtracting(subtractor: cv2.BackgroundSubtractor, threads: int) -> Callable[[Frame], object]:
    """OpenCV's masks of frame after frame."""

    def step(frame: Frame) -> object:
        cv2.setNumThreads(threads)  # which takes no time where it has as many
        return subtractor.apply(_image(frame))

    return step


def _spent(frames: Sequence[Frame], threads: int) -> Spent:
    steps = {
        "MOG2": subtracting(cv2.createBackgroundSubtractorMOG2(), threads),
        "KNN": subtracting(cv2.createBackgroundSubtractorKNN(), threads),
        "alone": in_steps(build_model("stand-alone")),
        "two": in_steps(background_and_blobs()),
        "feed-forward": in_steps(build_model("feed-forward")),
        "three": in_steps(build_model()),
    }
    return over_frames(steps, frames, TURN, WARM_UP)


def _limit(frames: Sequence[Frame], threads: int) -> float:
    """Seconds in which the background's state is read and written once, with a picture and its mask."""
    model = build_model("stand-alone")
    state = RecursiveBP(model).step(RunState(), frames[0]).state
    return moving(pass_bytes(n_bytes(state.states["background"]), _image(frames[0])), threads)


def pass_bytes(state: int, image: Image) -> int:
    """Bytes that a frame moves at least: a state in and out, the picture in, a mask of bytes out."""
    return 2 * state + int(image.nbytes) + int(image[..., 0].size)


# --- what is wanted -----------------------------------------------------------------------------------------


def _on(threads: int) -> str:
    return f"{threads} thread{'s' if threads > 1 else ''}"


def _of_speeds(
    at: str, wanted: tuple[float, float, float], limit: float, seconds: Mapping[str, float]
) -> list[Expectation]:
    mog2 = seconds["MOG2"]
    expectations = [Expectation(f"{at}: {name}, ms a frame", 1e3 * seconds[name]) for name in ("MOG2", "KNN")]
    called = {
        "alone": "background alone with mask",
        "two": "background and blobs",
        "three": "with the ground plane",
    }
    for name, called_so in called.items():
        what = f"{at}: {called_so}, ms a frame"
        expectations.append(Expectation(what, 1e3 * seconds[name], limit=1e3 * limit))
    for (name, called_so), bound in zip(called.items(), wanted, strict=True):
        what = f"{at}: {called_so} over MOG2"
        expectations.append(Expectation(what, seconds[name] / mog2, "<=", bound, limit=limit / mog2))
    return [
        *expectations,
        Expectation(
            f"{at}: with the ground plane over the faster of MOG2 and KNN",
            seconds["three"] / min(mog2, seconds["KNN"]),
        ),
        Expectation(
            f"{at}: feedback over feed-forward", seconds["three"] / seconds["feed-forward"], "<=", 1.03
        ),
    ]


def _of_large(at: str, wanted: float, limit: float, seconds: Mapping[str, float]) -> list[Expectation]:
    ours, mog2 = seconds["three"], seconds["MOG2"]
    return [
        Expectation(f"{at}: MOG2, ms a frame", 1e3 * mog2),
        Expectation(f"{at}: all chains, ms a frame", 1e3 * ours, limit=1e3 * limit),
        Expectation(f"{at}: all chains over MOG2", ours / mog2, "<=", wanted, limit=limit / mog2),
    ]


def _image(frame: Frame) -> Image:
    assert frame.image is not None
    return frame.image

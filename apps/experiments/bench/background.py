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
from ...io.sources.open_source import open_source
from ...scenes import sleeping_man
from ...scenes.crowd import crowd
from ..datasets import data_folder
from ..expectations import Expectation
from ..experiment import Findings
from .timing import ROUNDS, of_chains, over_frames, over_rounds

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


def speeds() -> Findings:
    """At the size of PETS, on one thread and on two."""
    frames, expectations = preloaded(), list[Expectation]()
    for threads, wanted in WANTED.items():
        set_threads(threads)
        steps = {
            "MOG2": subtracting(cv2.createBackgroundSubtractorMOG2(), threads),
            "KNN": subtracting(cv2.createBackgroundSubtractorKNN(), threads),
            "background alone with mask": in_steps(build_model("stand-alone")),
            "background and blobs": in_steps(background_and_blobs()),
            "feed-forward": in_steps(build_model("feed-forward")),
            "with the ground plane": in_steps(build_model()),
        }
        spent = over_frames(steps, frames, TURN, WARM_UP)
        expectations += over_rounds(partial(_of_speeds, _on(threads), wanted), spent)
    return Findings("Background and tracking beside MOG2", [], expectations)


def _of_speeds(
    at: str, wanted: tuple[float, float, float], seconds: Mapping[str, float]
) -> list[Expectation]:
    ours = ("background alone with mask", "background and blobs", "with the ground plane")
    mog2, three = seconds["MOG2"], seconds[ours[-1]]
    peer = min(mog2, seconds["KNN"])
    return [
        *(Expectation(f"{at}: {name}, ms a frame", 1e3 * seconds[name]) for name in ("MOG2", "KNN", *ours)),
        *(
            Expectation(f"{at}: {name} over MOG2", seconds[name] / mog2, "<=", bound)
            for name, bound in zip(ours, wanted, strict=True)
        ),
        Expectation(f"{at}: with the ground plane over the faster of MOG2 and KNN", three / peer),
        Expectation(f"{at}: feedback over feed-forward", three / seconds["feed-forward"], "<=", 1.03),
    ]


def large() -> Findings:
    """In a large picture with a crowd, on one thread and on two."""
    frames = list(crowd(N_OBJECTS, CROWD_WARM_UP + ROUNDS * CROWD_TURN, LARGE[::-1]))
    expectations: list[Expectation] = []
    for threads, wanted in WANTED_LARGE.items():
        set_threads(threads)
        mog2 = subtracting(cv2.createBackgroundSubtractorMOG2(), threads)
        spent = over_frames(
            {"MOG2": mog2, "ours": in_steps(build_model())}, frames, CROWD_TURN, CROWD_WARM_UP
        )
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


def objects() -> Findings:
    """What the tracker takes for many objects, beside what it takes for few."""
    set_threads(1)
    spent = {}
    for count in (FEW, MANY):
        frames = crowd(count, CROWD_WARM_UP + ROUNDS * CROWD_TURN, MIDDLE[::-1])
        seconds = [each["blobs"] for each in of_chains(build_model(), frames)[0][CROWD_WARM_UP:]]
        spent[str(count)] = np.reshape(seconds, (ROUNDS, CROWD_TURN)).mean(axis=1).tolist()
    return Findings("Many objects", [], over_rounds(_of_objects, spent))


def _of_objects(seconds: Mapping[str, float]) -> list[Expectation]:
    few, many = seconds[str(FEW)], seconds[str(MANY)]
    what = f"tracker of blobs, {MIDDLE[0]}x{MIDDLE[1]}, 1 thread"
    return [
        Expectation(f"{what}: {FEW} objects, ms a frame", 1e3 * few),
        Expectation(f"{what}: {MANY} objects, ms a frame", 1e3 * many),
        Expectation(f"{what}: {MANY} objects over {FEW}, time", many / few, "<=", 3.0),
    ]


def preloaded() -> Sequence[Frame]:
    """Frames of PETS2009 S2.L1 where they can be found, else of a generated scene."""
    try:
        with open_source(str(data_folder("pets2009-s2l1") / "vtest.avi"), stop=N_FRAMES) as source:
            return list(source)
    except OSError:
        return list(sleeping_man(N_FRAMES, size=SIZE))


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
        height, width = image_of(frame).shape[:2]
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
        return subtractor.apply(image_of(frame))

    return step


def image_of(frame: Frame) -> Image:
    """The picture of a frame that has one."""
    assert frame.image is not None
    return frame.image


def _on(threads: int) -> str:
    return f"{threads} thread{'s' if threads > 1 else ''}"

"""Cost of background and tracking over pixels, objects and frames; one thread."""

import itertools
import math
import os
import time
from collections.abc import Sequence

import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from ....inference import MultiChain, RecursiveBP, RunState
from ....models import Frame
from ....models.numerics.threads import thread_count
from ...background.application import build_model
from ...runs.progress import Progress
from ..bench.background import in_steps, pass_bytes, preloaded, subtracting
from ..bench.crowd_scene import crowd
from ..bench.timing import over_frames
from ..measuring.machine import moving
from ..measuring.stages import n_bytes, of_chain, stages
from .curve import Curve, Measured

SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160))
OF_CROWD = (1920, 1080)
OBJECTS = (1, 3, 10, 30, 100, 300)
FEW = 4
"""Objects in pictures of any size."""

ROUNDS, TURN, WARM_UP = 7, 2, 16
"""The last two in frames; a crowd of many takes longer to be found."""

CROWD_WARM_UP = 30
BLOCKS = 7
"""Of a stretch of a long film, of which each is a round."""

Image = NDArray[np.uint8]


def over_pixels() -> list[Curve]:
    """The background alone, all chains, and MOG2."""
    called = {"alone": "background alone", "all": "all chains", "MOG2": "MOG2"}
    points: dict[str, list[Measured]] = {name: [] for name in called}
    for width, height in SIZES:
        frames = list(crowd(FEW, WARM_UP + ROUNDS * TURN, (height, width)))
        steps = {
            "alone": in_steps(build_model("stand-alone")),
            "all": in_steps(build_model()),
            "MOG2": subtracting(cv2.createBackgroundSubtractorMOG2(), thread_count()),
        }
        spent = over_frames(steps, frames, TURN, WARM_UP)
        image = _image(frames[0])
        held = {"alone": _held(build_model("stand-alone"), frames[0]), "all": _held(build_model(), frames[0])}
        for name in called:
            limit = moving(pass_bytes(held[name], image)) if name in held else math.nan
            memory = held.get(name, math.nan)
            points[name].append(Measured.of(width * height, spent[name], limit, memory))
    return [Curve(name, "pixels", points[key]) for key, name in called.items()]


def over_objects() -> list[Curve]:
    """The tracker of blobs by itself, and all chains."""
    of_tracker, of_all = [], []
    width, height = OF_CROWD
    for count in OBJECTS:
        frames = list(crowd(count, CROWD_WARM_UP + ROUNDS * TURN, (height, width)))
        found, state = stages(build_model(), frames)
        held = n_bytes(state.states), n_bytes(state.states["blobs"])
        tracker = _in_rounds([of_chain("blobs", each) for each in found])
        whole = _in_rounds([each["whole"] for each in found])
        of_tracker.append(Measured.of(count, tracker, moving(2 * held[1]), held[1]))
        of_all.append(Measured.of(count, whole, moving(pass_bytes(held[0], _image(frames[0]))), held[0]))
    at = f"{width}x{height}"
    return [
        Curve(f"tracker of blobs, {at}", "objects", of_tracker),
        Curve(f"all chains, {at}", "objects", of_all),
    ]


def _in_rounds(seconds: Sequence[float]) -> list[float]:
    return np.reshape(seconds[CROWD_WARM_UP:], (ROUNDS, TURN)).mean(axis=1).tolist()  # type: ignore[no-any-return]


def over_frames_of_a_film(count: int) -> tuple[list[Curve], float]:
    """All chains from frame to frame of a film that runs to and fro, and MB by which memory has grown.

    The growth is that after the first fifth, in which libraries and buffers are still taking theirs.
    """
    frames, _ = preloaded()
    step, process = in_steps(build_model()), psutil.Process(os.getpid())
    order = itertools.cycle([*frames, *reversed(frames[1:-1])])
    seconds, memory = np.empty(count), np.empty(count)
    with Progress(f"{count} frames", count) as progress:
        for k, frame in enumerate(itertools.islice(order, count)):
            again = Frame(frame.image, (k + 1) / 10, k + 1)
            started = time.perf_counter()
            step(again)
            seconds[k] = time.perf_counter() - started
            memory[k] = process.memory_info().rss
            progress.update()
    limit = moving(pass_bytes(_held(build_model(), frames[0]), _image(frames[0])))
    points = []
    end = len(frames) // 2
    while end <= count:
        blocks = [np.median(block) for block in np.array_split(seconds[end // 2 : end], BLOCKS)]
        points.append(Measured.of(end, blocks, limit, memory[end - 1]))
        end *= 2
    grown = float(memory[-1] - memory[count // 5]) / 2**20
    return [Curve("all chains, PETS2009", "frames so far", points)], grown


def _held(model: MultiChain, frame: Frame) -> int:
    """Bytes of the states of all chains after a frame."""
    return n_bytes(RecursiveBP(model).step(RunState(), frame).state.states)


def _image(frame: Frame) -> Image:
    assert frame.image is not None
    return frame.image

"""Speed of the body tracker: frames a second, and where the time goes."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....chains.body.articulated_pose import ArticulatedPose
from ....chains.body.dynamics import BodyDynamics
from ....chains.body.fixed_lag import BLOCK, FixedLag
from ....chains.body.flesh_tracker import FleshTracker
from ....chains.body.likelihood import BodyLikelihood
from ....inference import MultiChain, RecursiveBP, RunState
from ....models.body.image_features import BodyImage, edge_distances, skin_blobs
from ....models.body.parts import EDGE_REACH, HAND_RADIUS, BodyParts
from ....models.body.poses import BodyPoses
from ....models.body.upper_body import UpperBody
from ....models.core.frame import Frame
from ....models.face.detectors import HaarFaces
from ....models.numerics.threads import set_threads, thread_count
from ...evaluation.text_tables import in_columns
from ...io.datasets import data_folder
from ...io.sources.open_source import open_source
from ..expectations import HEADER, Expectation
from ..trials.body import LAG, SignerFilm
from .timing import over_frames, over_rounds

Numbers = NDArray[np.float64]

N_FRAMES = 78
WARM_UP = 24  # frames that do not count: hindsight begins with the 18th
TURN = BLOCK  # frames in a row on so many threads: hindsight answers for as many at a time
THREADS = (1, 2)
SAMPLES = 1000

Stages = list[tuple[str, float, float]]
"""Stage, ms a frame and share of the whole, %."""


def body_expectations() -> tuple[list[Expectation], Stages]:
    """All of them, and where the time of a frame goes, on one thread: on two, stages run side by side."""
    film = BodyFilm.found()
    with _threads(1):
        stages = stages_of(*seconds_a_frame(film, SAMPLES))
    return rate_expectations(film), stages


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """So many in the kernels; one in OpenCV, as in all commands."""
    before, opencv = thread_count(), cv2.getNumThreads()
    set_threads(count)
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        set_threads(before)
        cv2.setNumThreads(opencv)


@dataclass(frozen=True, eq=False)
class BodyFilm:
    """Preloaded frames, who is to be tracked in them, and a word on where they come from."""

    label: str
    frames: Sequence[Frame]
    body: UpperBody
    parts: BodyParts

    @classmethod
    def found(cls) -> "BodyFilm":
        """A real signer with OpenCV's cascades where there are both, else a generated one with its list."""
        try:
            path = data_folder("signer") / "signseg_demo_video.mp4"
            with open_source(str(path), stop=N_FRAMES) as source:
                frames = list(source)
            images = [frame.image for frame in frames if frame.image is not None]
            parts = BodyParts.learned(images, HaarFaces())
        except (OSError, ValueError):
            film = SignerFilm.of(n_frames=N_FRAMES)
            return cls("generated, no face detector", film.frames, film.scene.body, film.parts)
        return cls("a signer's film", frames, UpperBody.from_head(parts.head_height), parts)


def tracker(film: BodyFilm, samples: int) -> Callable[[Frame], object]:
    """What takes in a frame as `rsmcm body` does, without decoding and files: both chains, and hindsight."""
    flesh, pose = FleshTracker(film.body), ArticulatedPose(film.body, samples)
    engine = RecursiveBP(MultiChain().connect(flesh, film.parts).connect(pose, film.parts))
    hindsight, state = FixedLag(BodyDynamics(film.body), LAG), RunState()

    def step(frame: Frame) -> object:
        nonlocal state
        belief = engine.step(state, frame)
        state = belief.state
        return hindsight.add(frame, belief[pose], belief.evidence(film.parts).image)

    return step


def seconds_a_frame(film: BodyFilm, samples: int) -> tuple[Numbers, dict[str, Numbers]]:
    """Of every frame after the first few, `(n,)`: the whole, and what some stages take of it by themselves.

    Answers with hindsight come several frames at a time.

    Blobs and edges are parts of the feature node's work that are done once more, to be timed.
    """
    spent, steps = _Spent(), ("predict", "message", "update")
    detector: Any = _Timed(film.parts.detector, spent, {"__call__": "detector"})
    colour: Any = _Timed(film.parts.skin, spent, {"log_odds_of": "colour"})
    dynamics: Any = _Timed(BodyDynamics(film.body), spent, {"log_step": "prior"})
    likelihood = BodyLikelihood(film.body)

    def timed_likelihood(image: BodyImage) -> Callable[[BodyPoses], Numbers]:
        of_image = spent.timed("likelihood", likelihood, image)
        return _Timed(of_image, spent, dict.fromkeys(("__call__", "first", "rest"), "likelihood"))

    parts = _Timed(replace(film.parts, detector=detector, skin=colour), spent, {"evidence": "features"})
    pose = ArticulatedPose(film.body, samples, dynamics=dynamics, likelihood=timed_likelihood)
    poses = _Timed(pose, spent, dict.fromkeys(steps, "poses"))
    flesh = _Timed(FleshTracker(film.body), spent, dict.fromkeys(steps, "flesh"))
    hindsight = _Timed(FixedLag(BodyDynamics(film.body), LAG), spent, {"add": "hindsight"})
    engine = RecursiveBP(MultiChain().connect(flesh, parts).connect(poses, parts))
    state, unit = RunState(), film.parts.head_height
    for frame in film.frames:
        with spent.frame():
            belief = engine.step(state, frame)
            hindsight.add(frame, belief[pose], belief.evidence(film.parts).image)
        state, seen = belief.state, belief[film.parts].image
        assert seen is not None
        spent.timed("blobs", skin_blobs, seen.skin, HAND_RADIUS * unit)
        spent.timed("edges", edge_distances, frame.image, EDGE_REACH * unit)
    return spent.whole[WARM_UP:], {name: spent.stage(name)[WARM_UP:] for name in spent.names}


def rate_expectations(film: BodyFilm) -> list[Expectation]:
    """Frames a second on one thread and on two, which take turns; without decoding."""
    image = film.frames[0].image
    assert image is not None
    size = f"{image.shape[1]}x{image.shape[0]}"
    what = f"body tracker, {film.label}, {size}, {SAMPLES} samples, lag {LAG}"

    def on(threads: int) -> Callable[[Frame], object]:
        step = tracker(film, SAMPLES)

        def with_threads(frame: Frame) -> None:
            with _threads(threads):
                step(frame)

        return with_threads

    def judge(seconds: dict[str, float]) -> list[Expectation]:
        one, two = seconds["1"], seconds["2"]
        return [
            Expectation(f"{what}, one thread: frames a second", 1 / one),
            Expectation(f"{what}, two threads: frames a second", 1 / two, ">=", 30),
            Expectation(f"{what}: time on two threads over one", two / one, "<=", 0.75),
        ]

    steps = {str(threads): on(threads) for threads in THREADS}
    return over_rounds(judge, over_frames(steps, film.frames, TURN, WARM_UP))


def stages_of(whole: Numbers, within: dict[str, Numbers]) -> Stages:
    """Where the time of a frame goes: means of what `seconds_a_frame` gives."""
    mean = {name: float(values.mean()) for name, values in within.items()}
    total = float(whole.mean())
    stages = {
        "features: face detector": mean["detector"],
        "features: map of skin": mean["colour"],
        "features: blobs": mean["blobs"],
        "features: edges": mean["edges"],
        "features: the rest": mean["features"] - mean["blobs"] - mean["edges"],
        "flesh tracker": mean["flesh"],
        "poses: drawing, and density of the draws": mean["poses"],
        "poses: temporal prior": mean["prior"],
        "poses: likelihood": mean["likelihood"],
        "hindsight": mean["hindsight"],
    }
    stages |= {"engine and the rest": total - sum(stages.values()), "total": total}
    return [(name, 1e3 * value, 100 * value / total) for name, value in stages.items()]


class _Spent:
    """Seconds of every frame: of the whole, and by stage."""

    def __init__(self) -> None:
        self._whole: list[float] = []
        self._stages: list[dict[str, float]] = []

    @contextmanager
    def frame(self) -> Iterator[None]:
        self._stages.append({})
        started = time.perf_counter()
        yield
        self._whole.append(time.perf_counter() - started)

    def timed(self, stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function as part of a stage of the frame."""
        now = self._stages[-1]
        started, before = time.perf_counter(), sum(now.values())
        try:
            return function(*arguments)
        finally:
            # without what others were asked for meanwhile: messages are worked out when they are read
            own = time.perf_counter() - started - (sum(now.values()) - before)
            now[stage] = now.get(stage, 0.0) + own

    @property
    def whole(self) -> Numbers:
        return np.array(self._whole)

    @property
    def names(self) -> set[str]:
        return {name for frame in self._stages for name in frame}

    def stage(self, name: str) -> Numbers:
        return np.array([frame.get(name, 0.0) for frame in self._stages])


class _Timed:
    """Something of which it is noted how long some methods take, by the stage that each is part of."""

    def __init__(self, node: Any, spent: _Spent, stages: dict[str, str]) -> None:
        self._node = node
        self._spent = spent
        self._stages = stages
        self.name = getattr(node, "name", "")

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return self._node.__class__  # ports tell nodes by their class

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._node, name)
        if name not in self._stages:
            return value

        return partial(self._spent.timed, self._stages[name], value)

    def __call__(self, *arguments: Any) -> Any:
        # Python looks this one up in the class
        return self.__getattr__("__call__")(*arguments)


if __name__ == "__main__":
    found, where = body_expectations()
    print(in_columns(HEADER, [expectation.cells for expectation in found]))
    print("\n" + in_columns(("stage", "ms", "share, %"), where))

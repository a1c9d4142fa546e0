"""Speed of the body tracker: frames a second, and where the time goes."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....chains.articulated_pose import ArticulatedPose
from ....chains.flesh_tracker import FleshTracker
from ....inference import MultiChain, RecursiveBP, RunState
from ....inference.body.dynamics import BodyDynamics
from ....inference.body.hindsight import FixedLag
from ....models.body.image_features import BodyImage, edge_distances
from ....models.body.likelihood import BodyLikelihood
from ....models.body.parts import EDGE_REACH, HAND_RADIUS, BodyParts
from ....models.body.poses import BodyPoses
from ....models.body.skin_blobs import skin_blobs
from ....models.body.upper_body import UpperBody
from ....models.core.frame import Frame
from ....models.face.detectors import HaarFaces
from ....models.numerics.threads import set_threads, thread_count
from ...io.datasets import data_folder
from ...io.sources.open_source import open_source
from ...reports.expectations import HEADER, Expectation, in_columns
from ..trials.body import LAG, SignerFilm

Numbers = NDArray[np.float64]

N_FRAMES = 60
WARM_UP = 20  # frames that do not count: hindsight begins with the 16th
THREADS = 2
SAMPLES = 1000
ROUNDS = 7
"""Stretches of the film, of which each is a round."""

Stages = list[tuple[str, float, float]]
"""Stage, ms a frame and share of the whole, %."""


def body_expectations() -> tuple[list[Expectation], Stages]:
    """All of them, and where the time of a frame goes, on two threads."""
    film = BodyFilm.found()
    with _threads(THREADS):
        whole, within = seconds_a_frame(film, SAMPLES)
        return [rate_expectation(film, whole)], stages_of(whole, within)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = thread_count()
    set_threads(count)
    try:
        yield
    finally:
        set_threads(before)


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


def seconds_a_frame(film: BodyFilm, samples: int) -> tuple[Numbers, dict[str, Numbers]]:
    """Of every frame after the first few, `(n,)`: the whole, and what some stages take of it by themselves.

    Answers with hindsight come several frames at a time.

    Blobs and edges are parts of the feature node's work that are done once more, to be timed.
    """
    spent, steps = _Spent(), ("predict", "message", "update")
    detector: Any = _Timed(film.parts.detector, spent, {"__call__": "detector"})
    colour: Any = _Timed(film.parts.skin, spent, {"log_odds": "colour"})
    dynamics: Any = _Timed(BodyDynamics(film.body), spent, {"log_step": "prior"})
    likelihood = BodyLikelihood(film.body)

    def timed_likelihood(image: BodyImage) -> Callable[[BodyPoses], Numbers]:
        of_image = spent.timed("likelihood", likelihood, image)
        return _Timed(of_image, spent, {"__call__": "likelihood", "inner_terms": "likelihood"})

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


def rate_expectation(film: BodyFilm, seconds: Numbers) -> Expectation:
    """Without decoding."""
    image = film.frames[0].image
    assert image is not None
    size = f"{image.shape[1]}x{image.shape[0]}"
    what = f"body tracker, {film.label}, {size}, {SAMPLES} samples, lag {LAG}, two threads: frames a second"
    stretches = [1 / float(part.mean()) for part in np.array_split(seconds, min(ROUNDS, len(seconds)))]
    low, high = np.percentile(stretches, (25, 75)).tolist()
    rate = 1 / float(seconds.mean())
    return Expectation(what, rate, ">=", 30, quartiles=(low, high), seeds=len(stretches))


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

"""Trials of body trackers on generated signers, which they go through in turns and timed."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...chains.body.articulated_pose import ArticulatedPose
from ...chains.body.condensation import Condensation
from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import FixedLag
from ...chains.body.flesh_tracker import FleshTracker
from ...chains.body.samples import BodySamples, moments
from ...inference import MultiChain, RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models.body.parts import BodyParts
from ...models.body.upper_body import JOINTS, PARTS
from ...models.core.frame import Frame
from ...models.numerics.densities import squared_distances
from ..body.measures import APART, HANDS, LEAST_VARIANCE, PLACES, BodyTrial, exchanged_hands
from ..scenes import SignerScene, signer
from ..view.overlay import TrackedBody

Numbers = NDArray[np.float64]

HEAD_AND_HANDS = [JOINTS.index(name) for name in PARTS]
HAND_JOINTS = HEAD_AND_HANDS[1:]

LAG = 12
"""Frames by which answers with hindsight are late."""

N_SHOWN = 40
"""Poses that are drawn from a posterior to be shown, as in the paper."""


@dataclass(frozen=True, eq=False)
class SignerFilm:
    """A scene whose pictures are drawn once for all trackers, and what is to be known of its colours."""

    scene: SignerScene
    frames: Sequence[Frame]
    parts: BodyParts

    @classmethod
    def of(cls, **settings: Any) -> Self:
        """The scene of these settings of `signer`; skin is learned from it as from any clip."""
        scene = signer(**settings)
        frames = list(scene)
        images = [frame.image for frame in frames if frame.image is not None]
        parts = BodyParts.learned(images, scene.detector)
        return cls(scene, frames, replace(parts, head_height=scene.body.head_height))


System = Literal["rsmcm", "sampler", "condensation", "flesh"]


@dataclass(frozen=True)
class BodyTracker:
    """One of the trackers that are compared.

    Parameters
    ----------
    name
        for tables.
    system
        `"rsmcm"`: likelihood sampling and the tracker of flesh correct each other. `"sampler"`: the same
        without the message of the tracker of flesh. `"condensation"`: the bootstrap filter. `"flesh"`: the
        tracker of flesh alone, which finds the hands only.
    samples
        number of poses; 0 where there are none.
    lag
        frames by which answers with hindsight are late, which are then given beside the filter's; 0 for none.
    """

    name: str
    system: System
    samples: int
    lag: int = 0

    def connected(self, film: SignerFilm) -> tuple[MultiChain, str]:
        """The model for a film, and the name of the chain that is measured."""
        body, parts, seed = film.scene.body, film.parts, film.scene.seed
        model = MultiChain()
        if self.system == "condensation":
            cloud = Condensation(body, self.samples, seed=seed)
            return model.connect(cloud, parts), cloud.name
        flesh = FleshTracker(body)
        model.connect(flesh, parts, feedback=self.system != "sampler")
        if self.system == "flesh":
            return model, flesh.name
        pose = ArticulatedPose(body, self.samples, seed=seed)
        return model.connect(pose, parts), pose.name


class _Run:
    """A tracker on its way through a film, and what was measured so far.

    After the first frame it is given the true pose, which CONDENSATION cannot find by itself. A tracker of
    flesh keeps what it has found.
    """

    def __init__(self, tracker: BodyTracker, film: SignerFilm, shown: Sequence[int]) -> None:
        model, self._chain = tracker.connected(film)
        self._engine = RecursiveBP(model)
        self._film = film
        self._state = RunState()
        self._now = _Answers(film, shown)
        self._later = _Answers(film, shown)
        seed = film.scene.seed
        self._hindsight = (
            FixedLag(BodyDynamics(film.scene.body), tracker.lag, seed=seed) if tracker.lag else None
        )

    def step(self, index: int) -> None:
        """Take in frame `index`."""
        frame = self._film.frames[index]
        started = time.perf_counter()
        belief = self._engine.step(self._state, frame)
        seconds = time.perf_counter() - started
        state = self._with_truth(belief.state) if index == 0 else belief.state
        self._state, found = state, state.states[self._chain]
        self._now.add(found, seconds)
        if self._hindsight is None:
            return
        started = time.perf_counter()
        answers = self._hindsight.add(frame, found, belief.evidence(self._film.parts).image)
        if index == len(self._film.frames) - 1:
            answers += self._hindsight.rest()
        self._later.seconds.append(seconds + time.perf_counter() - started)
        for answer in answers:
            self._later.add(answer.samples)

    def _with_truth(self, state: RunState) -> RunState:
        """The state of a tracker that is given the true pose of the first frame."""
        poses = state.states[self._chain]
        if not isinstance(poses, BodySamples):
            return state
        n = len(poses.poses)
        truth = self._film.scene.poses.take(np.zeros(n, np.int64))
        known = BodySamples.even(truth, poses.size, poses.random)
        return replace(state, states={**state.states, self._chain: known})

    def trial(self) -> BodyTrial:
        """What was measured."""
        trial = self._now.trial()
        return trial if self._hindsight is None else replace(trial, later=self._later.trial())


class _Answers:
    """What is said of one frame after the other, beside the truth."""

    def __init__(self, film: SignerFilm, shown: Sequence[int]) -> None:
        self._scene = film.scene
        self._shown = shown
        self._random = np.random.default_rng([film.scene.seed, 40])
        self._rows: list[tuple[Numbers, Numbers, Numbers, Numbers, float]] = []
        self._pictures: dict[int, TrackedBody] = {}
        self.seconds: list[float] = []

    def add(self, after: Any, seconds: float | None = None) -> None:
        """Take in what a chain knows of the next frame, and how long that took."""
        index = len(self._rows)
        found = self._believed(index, after)
        apart = found.joints - self._scene.joints[index]
        covariances = found.covariances[PLACES[HANDS], :2, :2] + LEAST_VARIANCE * np.eye(2)
        nees = squared_distances(apart[PLACES[HANDS], :2], covariances)
        flat, deep = (np.linalg.norm(apart[PLACES, :axes], axis=1) for axes in (2, 3))
        effective = after.effective if isinstance(after, BodySamples) else np.nan
        self._rows.append((flat, deep, nees, found.joints[HAND_JOINTS, :2], effective))
        if seconds is not None:
            self.seconds.append(seconds)

    def _believed(self, index: int, after: Any) -> TrackedBody:
        """Means and covariances of the joints, NaN where they are not known, and poses if they are shown."""
        if isinstance(after, BodySamples):
            body = self._scene.body
            found = moments(body, after)
            samples = body.joints(after.drawn(N_SHOWN, self._random)) if index in self._shown else np.empty(0)
            believed = TrackedBody(samples, found.joints, found.joint_covariances)
            if index in self._shown:
                self._pictures[index] = believed
            return believed
        means, covariances = np.full((8, 3), np.nan), np.full((8, 3, 3), np.nan)
        means[HEAD_AND_HANDS, :2] = after.positions
        covariances[HEAD_AND_HANDS, :2, :2] = after.position_covariances
        return TrackedBody(np.empty(0), means, covariances)

    def trial(self) -> BodyTrial:
        """What was measured."""
        flat, deep, nees, hands, effective = (np.array(row) for row in zip(*self._rows, strict=True))
        scene = self._scene
        truth = scene.joints[: len(hands), HAND_JOINTS, :2]
        return BodyTrial(
            errors=flat,
            errors_3d=deep,
            nees=nees,
            effective=effective,
            seconds=np.array(self.seconds),
            hidden=scene.hidden[: len(flat), 1:],
            exchanged=exchanged_hands(hands, truth, APART * scene.body.head_height),
            head_height=scene.body.head_height,
            shown=self._pictures,
        )


def in_turns(film: SignerFilm, trackers: Sequence[BodyTracker], shown: Sequence[int] = ()) -> list[BodyTrial]:
    """Run all trackers through a film; they take turns at every frame, so that times compare."""
    runs = [_Run(tracker, film, shown) for tracker in trackers]
    with _opencv_in_one_thread():
        for index in range(len(film.frames)):
            for run in runs:
                run.step(index)
    return [run.trial() for run in runs]


def on_one_scene(
    trackers: Sequence[BodyTracker], scene: Mapping[str, Any], shown: Sequence[int] = ()
) -> list[BodyTrial]:
    """Draw a scene and run all trackers on it."""
    return in_turns(SignerFilm.of(**scene), trackers, shown)


@contextmanager
def _opencv_in_one_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)

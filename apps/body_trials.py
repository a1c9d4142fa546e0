"""Trials of body trackers on generated signers, in turns and timed: errors, honesty, recovery."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..chains.articulated_pose import ArticulatedPose
from ..chains.flesh_tracker import FleshTracker
from ..inference import MultiChain, RecursiveBP
from ..inference.body_samples import moments
from ..inference.condensation import Condensation
from ..inference.recursive_bp import RunState
from ..models.body_parts import BodyParts
from ..models.frame import Frame
from ..models.upper_body import JOINTS, PARTS
from .body_overlay import REGION_90, TrackedBody
from .scenes import SignerScene, signer

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

MEASURED = ("left_elbow", "left_hand", "right_elbow", "right_hand")
PLACES = [JOINTS.index(name) for name in MEASURED]
HEAD_AND_HANDS = [JOINTS.index(name) for name in PARTS]
ELBOWS, HANDS = (slice(first, None, 2) for first in (0, 1))

OFF, FOUND = 0.5, 0.3
"""Head heights: error from which a hand is not followed, and below which it is followed again."""
LEAST_OFF = 2
"""Frames in a row that make a mis-track."""
SOON = 10
"""Frames after which a hand should be followed again, from the first in which it can be seen."""

N_SHOWN = 40
"""Poses that are drawn from a posterior to be shown, as in the paper."""

LEAST_VARIANCE = 0.01
"""px^2: added to a hand's, since all samples may be one."""


@dataclass(frozen=True)
class MisTrack:
    """A hand that was not followed for a while.

    Parameters
    ----------
    hand
        0 left, 1 right.
    start
        first frame with the error above half a head's height, index from 0.
    seen
        first frame from then on in which the hand looks like flesh; `None` if there is none.
    end
        first frame from `start` on with the error below 0.3 head heights; `None` if there is none.
    left
        frames from `seen` to the end of the scene.
    """

    hand: int
    start: int
    seen: int | None
    end: int | None
    left: int

    @property
    def recovered(self) -> bool | None:
        """Whether it was followed again soon after it could be seen; `None` where the scene ended before."""
        if self.end is not None:
            return self.seen is None or self.end - self.seen <= SOON
        return False if self.left > SOON else None


@dataclass(frozen=True, eq=False)
class BodyTrial:
    """How a tracker did on a scene; of the first frame, in which the pose is given, nothing counts.

    Parameters
    ----------
    errors
        `(n_frames, 4)` px: distance in the picture of the posterior mean of the joints `MEASURED` from the
        truth; NaN of joints that the tracker knows nothing of.
    errors_3d
        `(n_frames, 4)` px: the same in space.
    squares
        `(n_frames, 2)`: squared Mahalanobis distance of left and right hand in the picture, with the
        posterior's mean and covariance.
    effective
        `(n_frames,)`: effective number of samples; NaN without samples.
    seconds
        `(n_frames,)`: of the whole frame, features included.
    hidden
        `(n_frames, 2)`: whether left and right hand do not look like flesh.
    head_height
        px.
    shown
        by frame (index from 0), the posterior in pictures.
    """

    errors: Numbers
    errors_3d: Numbers
    squares: Numbers
    effective: Numbers
    seconds: Numbers
    hidden: Mask
    head_height: float
    shown: Mapping[int, TrackedBody] = field(default_factory=dict)

    @property
    def error(self) -> float:
        """px: mean over hands and elbows."""
        return float(self.errors[1:].mean())

    @property
    def hands(self) -> float:
        """px: mean over the hands."""
        return float(self.errors[1:, HANDS].mean())

    @property
    def off(self) -> float:
        """Share of frames in which a hand is not followed."""
        far = self.errors[1:, HANDS] > OFF * self.head_height
        return float(far.any(axis=1).mean())

    @cached_property
    def mis_tracks(self) -> list[MisTrack]:
        """Of both hands, in the order of time for each."""
        heads = self.errors[:, HANDS] / self.head_height
        return [one for hand in (0, 1) for one in mis_tracks(hand, heads[:, hand], self.hidden[:, hand])]


def mis_tracks(hand: int, errors: Numbers, hidden: Mask) -> list[MisTrack]:
    """Mis-tracks of a hand, from its errors `(n_frames,)` in head heights after the first frame.

    One ends where the error is below 0.3 head heights, whatever it was in between.
    """
    found: list[MisTrack] = []
    n_frames, index = len(errors), 1
    while index < n_frames:
        ahead = errors[index : index + LEAST_OFF]
        if len(ahead) < LEAST_OFF or not (ahead > OFF).all():
            index += 1
            continue
        end = _first(errors < FOUND, index)
        seen = _first(~hidden, index)
        left = 0 if seen is None else n_frames - 1 - seen
        found.append(MisTrack(hand, index, seen, end, left))
        index = n_frames if end is None else end
    return found


def _first(holds: Mask, start: int) -> int | None:
    """First index from `start` on where it holds."""
    ahead = np.flatnonzero(holds[start:])
    return start + int(ahead[0]) if len(ahead) else None


# Scenes and trackers


@dataclass(frozen=True, eq=False)
class SignerFilm:
    """A scene whose pictures are drawn once for all trackers, and what is to be known of its colours."""

    scene: SignerScene
    frames: Sequence[Frame]
    parts: BodyParts

    @classmethod
    def of(cls, **settings: Any) -> Self:
        """The scene of these settings of `signer`; flesh is learned from it as from any clip."""
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
        tracker of flesh alone, which knows the hands only.
    samples
        number of poses; 0 where there are none.
    """

    name: str
    system: System
    samples: int

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
    """A tracker on its way through a film, and what was measured so far."""

    def __init__(self, tracker: BodyTracker, film: SignerFilm, shown: Sequence[int]) -> None:
        model, self._chain = tracker.connected(film)
        self._engine = RecursiveBP(model)
        self._film = film
        self._shown = shown
        self._random = np.random.default_rng([film.scene.seed, 40])
        self._state: RunState | None = None
        self._rows: list[tuple[Numbers, Numbers, Numbers, float, float]] = []
        self._pictures: dict[int, TrackedBody] = {}

    def step(self, index: int) -> None:
        """Take in frame `index`; it is given the true pose after the first."""
        started = time.perf_counter()
        state = self._engine.step(self._state, self._film.frames[index]).state
        seconds = time.perf_counter() - started
        if index == 0:
            state = self._told(state)
        self._state = state
        scene, after = self._film.scene, state.states[self._chain]
        truth = scene.joints[index]
        means, covariances = np.full((8, 3), np.nan), np.full((8, 3, 3), np.nan)
        effective = np.nan
        if hasattr(after, "poses"):
            found = moments(scene.body, after)
            means, covariances, effective = found.joints, found.joint_covariances, after.effective
            if index in self._shown:
                samples = scene.body.joints(after.drawn(N_SHOWN, self._random))
                self._pictures[index] = TrackedBody(samples, means, covariances)
        else:
            means[HEAD_AND_HANDS, :2], covariances[HEAD_AND_HANDS, :2, :2] = (
                after.positions,
                after.position_covariances,
            )
        apart = means - truth
        squares = squared_distances(apart[PLACES[HANDS], :2], covariances[PLACES[HANDS], :2, :2])
        flat, deep = (np.linalg.norm(apart[PLACES, :axes], axis=1) for axes in (2, 3))
        self._rows.append((flat, deep, squares, effective, seconds))

    def _told(self, state: RunState) -> RunState:
        """The state of those who know the true pose of the first frame."""
        poses = state.states[self._chain]
        if not hasattr(poses, "poses"):
            return state
        n = len(poses.poses)
        truth = self._film.scene.poses.take(np.zeros(n, np.int64))
        known = replace(
            poses, poses=truth, log_weights=np.full(n, -np.log(n)), ancestors=None, ancestor_weights=None
        )
        return replace(state, states={**state.states, self._chain: known})

    def trial(self) -> BodyTrial:
        """What was measured."""
        flat, deep, squares, effective, seconds = (np.array(row) for row in zip(*self._rows, strict=True))
        scene = self._film.scene
        hidden = scene.hidden[: len(flat), 1:]
        size = scene.body.head_height
        return BodyTrial(flat, deep, squares, effective, seconds, hidden, size, self._pictures)


def squared_distances(errors: Numbers, covariances: Numbers) -> Numbers:
    """Squared Mahalanobis distances `(n,)` of errors `(n, 2)` px with covariances `(n, 2, 2)` px^2."""
    widened = covariances + LEAST_VARIANCE * np.eye(2)
    return np.asarray((errors * np.linalg.solve(widened, errors[..., None])[..., 0]).sum(axis=-1))


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


# What is made of trials


def pooled(trials: Sequence[BodyTrial], measure: str) -> Numbers:
    """A measure of every frame after the first, of all scenes: `(n, ...)`."""
    return np.concatenate([getattr(trial, measure)[1:] for trial in trials])


def coverage(trials: Sequence[BodyTrial]) -> float:
    """Share of the true hands that are within the posterior's 90 % region."""
    return float((pooled(trials, "squares") < REGION_90).mean())


def recoveries(trials: Sequence[BodyTrial]) -> tuple[int, int]:
    """Mis-tracks after which the hand was followed again soon, and all of which it is known."""
    known = [one.recovered for trial in trials for one in trial.mis_tracks if one.recovered is not None]
    return sum(known), len(known)

"""Poses with hindsight: what later frames say of earlier ones, by backward simulation.

    p(x_t | x_t+1, I_1..t) ~ sum_k w_k p(x_t+1 | x_k) delta(x_t - x_k)

The weighted poses x_k of a filter say what frames up to t know. Trajectories are drawn backwards through
them: their ends from the newest frame, and then, frame after frame, a pose from which they may have come
(Godsill, Doucet and West, "Monte Carlo smoothing for nonlinear time series", 2004).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.body.poses import BodyPoses
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ..filters.resampling import normalised, systematic
from .dynamics import Ancestors, BodyDynamics
from .samples import LONGEST, BodySamples, copied

Array = NDArray[np.float64]

CLOUD = 400
"""Poses of a frame that are kept until later ones have spoken."""

BLOCK = 4
"""Frames that are answered at a time: a pass over all that wait costs the same for one."""


@short_repr
@dataclass(frozen=True, eq=False)
class TimedSamples:
    """Weighted poses of a frame.

    Parameters
    ----------
    number, time
        of the frame; s.
    samples
        its poses.
    """

    number: int
    time: float
    samples: BodySamples


@short_repr
@dataclass(frozen=True, eq=False)
class WaitingFrames:
    """What fixed-lag smoothing has to remember: the frames that are not answered yet.

    Parameters
    ----------
    frames
        in the order of time, what the filter knew of each, thinned.
    random
        generator of the draws to come.
    """

    frames: tuple[TimedSamples, ...]
    random: np.random.Generator

    @classmethod
    def none(cls, seed: int) -> Self:
        """Before the first frame."""
        return cls((), np.random.default_rng(seed))


class FixedLag:
    """Gives poses when later frames have spoken.

    Parameters
    ----------
    dynamics
        of the filter whose poses these are.
    lag
        frames by which answers are late, at least, and at most 3 more; 0 for none: the filter's own answers.
    trajectories
        that are drawn; so many poses answer for a frame.
    seed
        of the random numbers.

    Attributes
    ----------
    waiting
        all that it remembers, a value: put back, it goes on in the same way.

    Raises
    ------
    ValueError
        for a lag below 0, or fewer than 2 trajectories.
    """

    def __init__(
        self, dynamics: BodyDynamics, lag: int = 12, *, trajectories: int = 100, seed: int = 0
    ) -> None:
        if lag < 0:
            raise ValueError(f"lag: got {lag} frames, expected 0 or more")
        if trajectories < 2:
            raise ValueError(f"trajectories: got {trajectories}, expected 2 or more")
        self.dynamics = dynamics
        self.lag = lag
        self.trajectories = trajectories
        self.waiting = WaitingFrames.none(seed)

    def add(self, frame: Frame, samples: BodySamples) -> list[TimedSamples]:
        """Take in what a filter knows after a frame, and answer for frames that waited long enough.

        Parameters
        ----------
        frame
            later than those before; it may be missing.
        samples
            the filter's posterior, or its prediction.
        """
        if not self.lag:
            return [TimedSamples(frame.number, frame.time, samples)]
        random = copied(self.waiting.random)
        kept = TimedSamples(frame.number, frame.time, thinned(samples, CLOUD, random))
        self.waiting = WaitingFrames((*self.waiting.frames, kept), random)
        if len(self.waiting.frames) < self.lag + BLOCK:
            return []
        return self._answers(BLOCK)

    def rest(self) -> list[TimedSamples]:
        """Answers for all frames that wait, after the last one."""
        return self._answers(len(self.waiting.frames))

    def _answers(self, count: int) -> list[TimedSamples]:
        """Answers for the first frames that wait, which are then forgotten."""
        if not count:
            return []
        frames, random = self.waiting.frames, copied(self.waiting.random)
        smoothed = backward_simulation(self.dynamics, frames, self.trajectories, count, random)
        self.waiting = WaitingFrames(frames[count:], random)
        return smoothed


def backward_simulation(
    dynamics: BodyDynamics,
    frames: tuple[TimedSamples, ...],
    n: int,
    count: int,
    random: np.random.Generator,
) -> list[TimedSamples]:
    """Draw `n` trajectories backwards through `frames`; their poses in the first `count` of them."""
    poses = frames[-1].samples.drawn(n, random)
    smoothed: list[TimedSamples] = []
    for index in range(len(frames) - 1, -1, -1):
        if index < len(frames) - 1:
            poses = _came_from(dynamics, frames[index], frames[index + 1].time, poses, random)
        if index < count:
            smoothed.append(_even(frames[index], poses))
    return smoothed[::-1]


def thinned(samples: BodySamples, n: int, random: np.random.Generator) -> BodySamples:
    """At most `n` of the samples, with weights, and without what a prediction remembers.

    They are drawn in proportion to the roots of their weights, so that what is improbable is still there.
    """
    kept, log_weights = np.arange(len(samples.poses)), samples.log_weights
    if len(kept) > n:
        kept, counts = np.unique(systematic(0.5 * log_weights, n, random), return_counts=True)
        log_weights = 0.5 * log_weights[kept] + np.log(counts)
    return replace(
        samples,
        poses=samples.poses.take(kept),
        log_weights=normalised(log_weights),
        ancestors=None,
        before=None,
    )


def _came_from(
    dynamics: BodyDynamics, frame: TimedSamples, time: float, poses: BodyPoses, random: np.random.Generator
) -> BodyPoses:
    """For each of `poses` at `time`, one of the frame's before: as hands may be exchanged, with its own."""
    samples = frame.samples
    past = Ancestors(samples.poses, samples.weights, min(time - frame.time, LONGEST))
    past = dynamics.with_exchanged(past, random)
    return past.poses.take(dynamics.draw_ancestors(poses, past, random))


def _even(frame: TimedSamples, poses: BodyPoses) -> TimedSamples:
    n = len(poses)
    samples = replace(frame.samples, poses=poses, log_weights=np.full(n, -np.log(n)))
    return replace(frame, samples=samples)

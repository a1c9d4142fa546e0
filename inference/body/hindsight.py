"""Poses with hindsight: what later frames say of earlier ones, by backward simulation.

    p(x_t | x_t+1, I_1..t) ~ sum_k w_k p(x_t+1 | x_k) delta(x_t - x_k)

The weighted poses x_k of a filter say what frames up to t know. Trajectories are drawn backwards through
them: their ends from the newest frame, and then, frame after frame, a pose from which they may have come
(Godsill, Doucet and West, "Monte Carlo smoothing for nonlinear time series", 2004), which is then moved a
little (`trajectory_moves`), as the image and what comes before and after have it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...models.body.image_features import BodyImage
from ...models.body.likelihood import BodyLikelihood, PoseLikelihood
from ...models.body.poses import BodyPoses
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ..filters.resampling import normalised, systematic
from .dynamics import Ancestors, BodyDynamics
from .samples import LONGEST, BodySamples, copied
from .tempering import LogDensity
from .trajectory_moves import moved_between

Array = NDArray[np.float64]

CLOUD = 400
"""Poses of a frame that are kept until later ones have spoken."""

BLOCK = 6
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
    images
        of each, what the likelihood asks of it; `None` for a missing one.
    past
        the frame before them, which is answered; `None` at the beginning.
    random
        generator of the draws to come.
    """

    frames: tuple[TimedSamples, ...]
    images: tuple[BodyImage | None, ...]
    past: TimedSamples | None
    random: np.random.Generator


class FixedLag:
    """Gives poses when later frames have spoken.

    Parameters
    ----------
    dynamics
        of the filter whose poses these are.
    lag
        frames by which answers are late, at least, and at most 5 more; 0 for none: the filter's own answers.
    likelihood
        of images; that of the body, unless given.
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
        self,
        dynamics: BodyDynamics,
        lag: int = 12,
        *,
        likelihood: PoseLikelihood | None = None,
        trajectories: int = 100,
        seed: int = 0,
    ) -> None:
        if lag < 0:
            raise ValueError(f"lag: got {lag} frames, expected 0 or more")
        if trajectories < 2:
            raise ValueError(f"trajectories: got {trajectories}, expected 2 or more")
        self.dynamics = dynamics
        self.lag = lag
        self.likelihood = likelihood or BodyLikelihood(dynamics.body)
        self.trajectories = trajectories
        self.waiting = WaitingFrames((), (), None, np.random.default_rng(seed))
        self._likelihoods: dict[int, LogDensity] = {}

    def add(self, frame: Frame, samples: BodySamples, image: BodyImage | None = None) -> list[TimedSamples]:
        """Take in what a filter knows after a frame, and answer for frames that waited long enough.

        Parameters
        ----------
        frame
            later than those before; it may be missing.
        samples
            the filter's posterior, or its prediction.
        image
            what the filter was told of the frame: the `image` of the parts' message. Without it, of a frame
            that is not missing, poses are chosen among the filter's own.
        """
        if not self.lag:
            return [TimedSamples(frame.number, frame.time, samples)]
        random = copied(self.waiting.random)
        kept = TimedSamples(frame.number, frame.time, thinned(samples, CLOUD, random))
        before = self.waiting
        self.waiting = replace(
            before, frames=(*before.frames, kept), images=(*before.images, image), random=random
        )
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
        waiting, random = self.waiting, copied(self.waiting.random)
        numbers = [frame.number for frame in waiting.frames]
        self._likelihoods = {
            number: self._likelihoods.get(number) or self.likelihood(image)
            for number, image in zip(numbers, waiting.images, strict=True)
            if image is not None
        }
        smoothed = self._trajectories(count, random)
        self.waiting = WaitingFrames(
            waiting.frames[count:], waiting.images[count:], waiting.frames[count - 1], random
        )
        return smoothed

    def _trajectories(self, count: int, random: np.random.Generator) -> list[TimedSamples]:
        """Draw trajectories backwards through all frames that wait; their poses in the first `count`."""
        frames = self.waiting.frames
        poses = frames[-1].samples.drawn(self.trajectories, random)
        smoothed = [_even(frames[-1], poses)]
        past = self._past(frames[-2] if len(frames) > 1 else None, frames[-1].time, random)
        for index in range(len(frames) - 2, -1, -1):
            frame, later = frames[index], poses
            assert past is not None
            poses = past.poses.take(self.dynamics.draw_ancestors(later, past, random))
            elapsed = past.elapsed
            past = self._past(frames[index - 1] if index else self.waiting.past, frame.time, random)
            likelihood = self._likelihoods.get(frame.number)
            if past is not None and likelihood is not None:
                poses = moved_between(
                    self.dynamics, poses, past, frame.samples, later, elapsed, likelihood, random
                )
            if index < count:
                smoothed.append(_even(frame, poses))
        return smoothed[::-1][:count]

    def _past(self, frame: TimedSamples | None, time: float, random: np.random.Generator) -> Ancestors | None:
        """What may have become poses at `time`: those of the frame before, also with exchanged hands.

        A trajectory that came from these goes on with them: hands are not exchanged in the world, they
        turn out to have been taken for each other.
        """
        if frame is None:
            return None
        elapsed = min(time - frame.time, LONGEST)
        past = Ancestors(frame.samples.poses, frame.samples.weights, elapsed)
        return self.dynamics.with_exchanged(past, random)


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


def _even(frame: TimedSamples, poses: BodyPoses) -> TimedSamples:
    n = len(poses)
    samples = replace(frame.samples, poses=poses, log_weights=np.full(n, -np.log(n)))
    return replace(frame, samples=samples)

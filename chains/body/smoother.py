"""An engine that filters, and answers for a frame when it has seen some later ones."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...inference import Belief, RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models.body.parts import BodyParts
from ...models.core.frame import Frame
from .articulated_pose import ArticulatedPose
from .fixed_lag import FixedLag, TimedSamples


class SmoothedBelief(Belief):
    """What is known of a frame when later ones have spoken: `samples` are poses given these as well."""

    samples: TimedSamples


class Smoother:
    """Filters frame after frame, and answers for each when it has seen some later ones.

    Parameters
    ----------
    engine
        of the filter.
    state
        to go on from.
    smoothing
        of the filter's poses.
    pose, parts
        the chain whose poses these are, and the node by which it hears the image.
    seed
        of what smoothing draws.
    """

    def __init__(
        self,
        engine: RecursiveBP,
        state: RunState,
        smoothing: FixedLag,
        pose: ArticulatedPose,
        parts: BodyParts,
        seed: int,
    ) -> None:
        self.model, self.state, self.smoothing = engine.model, state, smoothing
        self._engine, self._newest, self._pose, self._parts, self._seed = engine, state, pose, parts, seed
        self._waiting: deque[SmoothedBelief] = deque()

    def step(self, frame: Frame) -> list[Belief]:
        """Take in a frame, and answer for those that have waited long enough."""
        belief = self._engine.step(self._newest, frame)
        self._newest = belief.state
        # without what else is believed of the frame, which is large
        self._waiting.append(SmoothedBelief(belief.frame, belief.state, None))
        self._begin_draws(frame.number)
        image = belief.evidence(self._parts).image
        return self._answered(self.smoothing.add(belief.frame, belief[self._pose], image))

    def rest(self) -> list[Belief]:
        """Of the last frames, fewer later ones are known."""
        self._begin_draws(0)
        return self._answered(self.smoothing.rest())

    def _answered(self, poses: Sequence[TimedSamples]) -> list[Belief]:
        answered: list[Belief] = []
        for each in poses:
            belief = self._waiting.popleft()
            belief.samples, self.state = each, belief.state
            answered.append(belief)
        return answered

    def _begin_draws(self, number: int) -> None:
        """Let what is drawn depend on the frame alone: a run that is resumed takes in frames again."""
        random = np.random.default_rng((self._seed, number))
        self.smoothing.waiting = replace(self.smoothing.waiting, random=random)

"""CONDENSATION (Isard and Blake 1998): the bootstrap filter, as a chain over a body's pose."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...inference.smc import copied, normalised, systematic
from ...models.body.parts import BodyParts, PartMessage
from ...models.body.upper_body import BodyPoses, UpperBody
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from .dynamics import BodyDynamics
from .likelihood import BodyLikelihood, PoseLikelihood
from .samples import BodySamples, part_message

Array = NDArray[np.float64]

GROUPS = 6  # Gaussians of each part's mixture in the message


@short_repr
@dataclass(frozen=True)
class Condensation:
    """Samples that are moved by the dynamics alone and weighed by the likelihood: the usual way, a baseline.

    X is a pose, F the places of head and hands in the picture:

        p(X_t | X_t-1) ~ K(X_t | X_t-1, dt) g(X_t),    p(F | X) = delta(F - parts(X)),    p(I | X)

    with dynamics K and g and the likelihood as in `ArticulatedPose`. The message to F is the prediction of
    each part's place, a mixture of a few Gaussians. The tracker that the RSMCM paper compares with (§4.1,
    Fig. 6): a chain like any other, which alone at its feature node is the filter as published.

    Parameters
    ----------
    body
        lengths and widths.
    samples
        number of poses.
    start
        poses at the first frame, in any number; `None` for anywhere in the picture.
    seed
        of the random numbers.
    dynamics, likelihood
        of poses; those of the body where `None`.

    Raises
    ------
    ValueError
        if there are fewer than two samples or no poses to start from.
    """

    body: UpperBody
    samples: int = 5000
    start: BodyPoses | None = None
    seed: int = 0
    dynamics: BodyDynamics | None = None
    likelihood: PoseLikelihood | None = None
    name: str = "condensation"

    ports = (Port(BodyParts),)

    def __post_init__(self) -> None:
        if self.samples < 2:
            raise ValueError(f"samples: got {self.samples}, expected 2 or more")
        if self.start is not None and not len(self.start):
            raise ValueError("start: got no poses, expected one or more")

    @property
    def _dynamics(self) -> BodyDynamics:
        return self.dynamics or BodyDynamics(self.body)

    def initial(self, frame: Frame) -> BodySamples:
        """The poses to start from, of equal weight."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        height, width = frame.image.shape[:2]
        random = np.random.Generator(np.random.SFC64(self.seed))  # numpy's fastest: most of a step is noise
        if self.start is None:
            poses = self._dynamics.draw_anywhere(self.samples, (height, width), random)
        else:
            poses = self.start.take(np.arange(self.samples) * len(self.start) // self.samples)
        return BodySamples.even(poses, (height, width), random)

    def predict(self, state: BodySamples, dt: float) -> BodySamples:
        """As many draws of each pose as its weight says, each moved at random; none that joints forbid."""
        state, dt = state.origin(dt)
        random = copied(state.random)
        chosen = systematic(state.log_weights, self.samples, random)
        poses = self._dynamics.draw(state.poses.take(chosen), dt, random)
        allowed = self.body.allowed(poses)
        some = np.count_nonzero(allowed) or self.samples
        log_weights = np.full(self.samples, -np.log(some))
        if some < self.samples:
            log_weights[~allowed] = -np.inf
        log_weights = normalised(log_weights + self._dynamics.log_posture(poses, dt))
        return BodySamples(poses, log_weights, state.size, random, before=state, elapsed=dt)

    def message(self, state: BodySamples, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """What the predicted poses say of head and hands, as mixtures with the samples' moments."""
        return part_message(self.body, state.poses, state.weights, GROUPS)

    def update(self, state: BodySamples, incoming: Incoming) -> BodySamples:
        """Weights times the likelihood of the image; as they are where there is none."""
        message = incoming[BodyParts]
        log_factors = np.zeros(len(state.poses))
        if message.stacked.informative.any():
            log_factors += message.log_values(self.body.parts(state.poses))
        if message.image is not None:
            likelihood = self.likelihood or BodyLikelihood(self.body)
            log_factors += likelihood(message.image)(state.poses)
        if message.image is None and not log_factors.any():
            return replace(state, before=None, elapsed=0.0, stationary=True)
        return state.reweighed(log_factors)

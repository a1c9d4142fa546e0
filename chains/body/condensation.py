"""CONDENSATION (Isard and Blake 1998): the bootstrap filter, as a chain over a body's pose."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.generic_chains import ParticleChain, ParticleState
from ...inference.engine.protocols import Incoming, Port
from ...models.body.parts import BodyParts, PartMessage
from ...models.body.upper_body import BodyPoses, UpperBody
from ...models.core.checks import CountFrom0, at_least, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from .dynamics import BodyDynamics
from .likelihood import BodyLikelihood, PoseLikelihood
from .samples import BodySamples, part_message

Array = NDArray[np.float64]

GROUPS = 6  # Gaussians of each part's mixture in the message


@checked
@short_repr
@dataclass(frozen=True)
class Condensation:
    """Bootstrap particle filter of a body's pose, as a baseline.

    X is a pose, F the positions of head and hands in the image:

        p(X_t | X_t-1) ~ K(X_t | X_t-1, dt) g(X_t),    p(F | X) = delta(F - parts(X)),    p(I | X)

    with dynamics K and g and the likelihood as in `ArticulatedPose`. The message to F is the prediction of
    the position of each part, a mixture of a few Gaussians. The RSMCM paper compares with it (§4.1, Fig. 6).
    As the only chain of its feature node it is the published filter.

    Parameters
    ----------
    body
        lengths and widths.
    samples
        number of poses.
    start
        poses at the first frame, any number; `None` for anywhere in the image.
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
    samples: Annotated[int, at_least(2)] = 5000
    start: BodyPoses | None = None
    seed: CountFrom0 = 0
    dynamics: BodyDynamics | None = None
    likelihood: PoseLikelihood | None = None
    name: str = "condensation"

    ports = (Port(BodyParts),)

    def __post_init__(self) -> None:
        if self.start is not None and not len(self.start):
            raise ValueError("start: got no poses, expected one or more")

    @property
    def _dynamics(self) -> BodyDynamics:
        return self.dynamics or BodyDynamics(self.body)

    @property
    def _filter(self) -> ParticleChain:
        """The particle filter, of poses alone."""
        return ParticleChain(
            self._moved,
            lambda poses, weights, feature: part_message(self.body, poses, weights, GROUPS),
            self._log_likelihood,
            self._first,
            features=BodyParts,
            count=self.samples,
            resampling_share=1.0,
            seed=self.seed,
        )

    def _first(self, count: int, frame: Frame, random: np.random.Generator) -> BodyPoses:
        """The poses to start from, each as often as the others."""
        if self.start is None:
            return self._dynamics.draw_anywhere(count, _size(frame), random)
        return self.start.take(np.arange(count) * len(self.start) // count)

    def _moved(self, poses: BodyPoses, dt: float, random: np.random.Generator) -> tuple[BodyPoses, Array]:
        """Poses moved at random, and logs of how usual they are; none that joints forbid."""
        moved = self._dynamics.draw(poses, dt, random)
        posture = self._dynamics.log_posture(moved, dt)
        return moved, np.where(self.body.allowed(moved), posture, -np.inf)

    def _log_likelihood(self, poses: BodyPoses, message: PartMessage, feature: BodyParts) -> Array:
        """Log likelihood of poses given the image and the other chains' messages."""
        log_factors = np.zeros(len(poses))
        if message.stacked.informative.any():
            log_factors += message.log_values(self.body.parts(poses))
        if message.image is not None:
            likelihood = self.likelihood or BodyLikelihood(self.body)
            log_factors += likelihood(message.image)(poses)
        return log_factors

    def initial(self, frame: Frame) -> BodySamples:
        """Return the poses to start from, of equal weight."""
        first = self._filter.initial(frame)
        return BodySamples(cast(Any, first.particles), first.log_weights, _size(frame), first.random)

    def predict(self, state: BodySamples, dt: float) -> BodySamples:
        """Return poses resampled by weight and drawn from the dynamics; impossible ones have weight 0."""
        state, dt = state.origin(dt)
        moved = self._filter.predict(_particles(state), dt)
        return BodySamples(
            cast(Any, moved.particles), moved.log_weights, state.size, moved.random, before=state, elapsed=dt
        )

    def message(self, state: BodySamples, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Return mixtures of the positions of head and hands, with the moments of the predicted poses."""
        message: PartMessage = self._filter.message(_particles(state), feature, incoming)
        return message

    def update(self, state: BodySamples, incoming: Incoming) -> BodySamples:
        """Return the poses weighted by the likelihood of the image, if there is one."""
        message = incoming[BodyParts]
        if message.image is None and not message.stacked.informative.any():
            return replace(state, before=None, elapsed=0.0, stationary=True)
        after = self._filter.update(_particles(state), incoming)
        return BodySamples(
            state.poses, after.log_weights, state.size, state.random, log_evidence=after.log_evidence
        )


def _particles(state: BodySamples) -> ParticleState:
    return ParticleState(cast(Any, state.poses), state.log_weights, state.random)


def _size(frame: Frame) -> tuple[int, int]:
    """`(height, width)` px of the picture."""
    height, width = frame.required_image().shape[:2]
    return height, width

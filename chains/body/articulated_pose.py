"""The pose of a person's upper body in 16 degrees of freedom, by likelihood sampling."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...inference.smc import copied
from ...models.body.parts import BodyParts, PartMessage
from ...models.body.upper_body import BodyPoses, UpperBody
from ...models.core.checks import NOT_EMPTY, CountFrom0, at_least, checked
from ...models.core.frame import Frame
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.core.short_repr import short_repr
from .dynamics import BodyDynamics
from .fixed_lag import PoseTrajectory, predicted_messages, smoothed_poses
from .likelihood import BodyLikelihood, PoseLikelihood
from .proposals import Candidates
from .samples import (
    SAMPLE_STD,
    BodySamples,
    initial_samples,
    part_message,
    predict_samples,
    stationary_samples,
    weighted_moments,
)
from .tempering import temper

Array = NDArray[np.float64]

CANDIDATES, PRESELECTED = 10, 4  # poses that are drawn, and that are compared with edges, per sample
FIRST = 10_000  # poses that are drawn in the first frame, at least: arms are unknown there
IMAGE_ONLY = 0.4  # share of a part's draws without a past that ignore the other chains
PREDICTED = 0.3  # share of the guided hands that are drawn from other chains' messages, not from the image
GROUPS = 4  # Gaussians of each part in the message


@checked
@short_repr
@dataclass(frozen=True)
class ArticulatedPose:
    """Likelihood sampling of an articulated body (RSMCM paper §4.1).

    X is a pose in 16 degrees of freedom, F the positions of head and hands in the image:

        p(X_t | X_t-1) ~ sum_e p(e) K(X_t | e(X_t-1), dt) g(X_t)
        p(F | X)       = delta(F - parts(X))
        p(I | X)       = face(I, X) skin(I, X) clothes(I, X) edges(I, X)

    e keeps or exchanges the hands, K are the `BodyDynamics`, g is small for unusual postures and 0 for
    impossible ones; the likelihood is `BodyLikelihood`. The message to F is the prediction of each part's
    position, a mixture of a few Gaussians.

    In the first frame, head and hands are drawn from the messages at F (face and skin in the image, other
    chains' predictions) and completed to poses by inverse kinematics (`draw_from_likelihood`); then poses are
    drawn from those of the frame before, some with a hand at a detection (`draw_guided`).

    The paper weights its samples once, by the posterior over the proposal. Here weighting gives samples of
    the prediction; the likelihood is then applied by tempering, with Metropolis moves after each step
    (`temper`). Improbable modes keep a share of the samples (`Strata`).

    It needs few samples, since they are drawn at detections, and recovers a lost body; but it depends on the
    detectors. A `FleshTracker` on the same feature bridges their failures.

    If a frame shows no feature, or no possible pose fits, the state is stationary: the prediction, weighted
    by the other chains' messages.

    Parameters
    ----------
    body
        lengths of the segments.
    samples
        number of poses per frame, 10 or more.
    start
        poses near that of the first frame; `None` if it is unknown.
    seed
        of the random numbers.
    dynamics, likelihood
        of this body; the default ones if `None`.
    name
        of the chain.
    """

    body: UpperBody
    samples: Annotated[int, at_least(10)] = 1000
    _: KW_ONLY
    start: Annotated[BodyPoses, NOT_EMPTY] | None = None
    seed: CountFrom0 = 0
    dynamics: BodyDynamics | None = None
    likelihood: PoseLikelihood | None = None
    name: str = "pose"

    ports = (Port(BodyParts),)

    def initial(self, frame: Frame) -> BodySamples:
        """Draw poses about the start, or anywhere in the image."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        random = np.random.default_rng(self.seed)
        return initial_samples(self._dynamics, self.samples, frame.image.shape[:2], random, self.start)

    def predict(self, state: BodySamples, dt: float) -> BodySamples:
        """Draw poses `dt` seconds ahead from the dynamics."""
        return predict_samples(self._dynamics, state, self.samples, dt)

    def message(self, state: BodySamples, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Return the predicted positions of the parts (mu_{X -> F}): mixtures with the samples' moments."""
        return part_message(self.body, state.poses, state.weights, GROUPS)

    def update(self, state: BodySamples, incoming: Incoming) -> BodySamples:
        """Draw samples of the posterior; the prediction if the frame shows nothing that fits a pose."""
        message = incoming[BodyParts]
        image = message.image
        if image is None or not image.mixtures.informative.any():
            return stationary_samples(state, message.log_values(self.body.parts(state.poses)))
        random = copied(state.random)
        candidates = self._candidates(state, message, random)
        if not np.isfinite(candidates.log_weights).any():
            return stationary_samples(state, np.zeros(len(state.poses)))
        likelihood = (self.likelihood or BodyLikelihood(self.body))(image)

        def log_prior(poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
            return candidates.log_prior(poses, owners) + message.log_values(self.body.parts(poses))

        posterior = temper(
            self._dynamics,
            candidates.poses,
            candidates.log_weights,
            log_prior,
            likelihood,
            self.samples,
            random,
            PRESELECTED * self.samples,
        )
        return BodySamples(
            posterior.poses, posterior.log_weights, state.size, random, log_evidence=posterior.log_evidence
        )

    def _candidates(
        self, state: BodySamples, message: PartMessage, random: np.random.Generator
    ) -> Candidates:
        """Draw samples of the prediction, weighted by the other chains' messages."""
        assert message.image is not None
        seen, past, n = message.image.mixtures, state.ancestors, CANDIDATES * self.samples
        starts = self._start_mixtures(message, seen, state)
        if past is None:
            drawn = Candidates.of_first_frame(
                self._dynamics, state.size, starts, max(FIRST, n), random, bare=message.image.bare
            )
        else:
            guides = ((seen, 1 - PREDICTED), (message.predicted, PREDICTED))
            drawn = Candidates.of_next_frame(
                self._dynamics, state.size, past, guides, starts, n, random, message.image.bare
            )
        return drawn.weighted(message.log_values(self.body.parts(drawn.poses)))

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: PoseTrajectory | None = None
    ) -> Smoothed[PoseTrajectory]:
        """Smooth the poses over all frames, given the images and the other chains' messages."""
        likelihood = self.likelihood or BodyLikelihood(self.body)
        return Smoothed(smoothed_poses(self, self._dynamics, likelihood, incoming_over_time))

    def messages(
        self, trajectory: PoseTrajectory, feature: BodyParts, incoming_over_time: Sequence[BatchIncoming] = ()
    ) -> list[PartMessage]:
        """Return the parts predicted from the smoothed poses of the frame before (mu_{X -> F})."""
        return predicted_messages(self, trajectory.samples, trajectory.times, feature)

    @property
    def _dynamics(self) -> BodyDynamics:
        return self.dynamics or BodyDynamics(self.body)

    def _start_mixtures(
        self, message: PartMessage, seen: GaussianMixtures, state: BodySamples
    ) -> GaussianMixtures:
        """Mix the product of all messages with the image's alone: other chains may be wrong."""
        means, covariances = weighted_moments(self.body.parts(state.poses), state.weights)
        covariances += SAMPLE_STD**2 * np.eye(2)
        area = np.log(float(state.size[0]) * state.size[1])
        product, image_only = (each.proper(area, means, covariances) for each in (message.mixtures, seen))
        return product.blended(image_only, IMAGE_ONLY)

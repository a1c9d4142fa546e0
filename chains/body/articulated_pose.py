"""The pose of a person's upper body in 16 degrees of freedom, by likelihood sampling."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...inference.smc import copied
from ...models.body.parts import BodyParts, PartMessage
from ...models.body.upper_body import BodyPoses, UpperBody
from ...models.core.frame import Frame
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.core.short_repr import short_repr
from .dynamics import BodyDynamics
from .fixed_lag import PoseTrajectory, predicted_messages, smoothed_poses
from .likelihood import BodyLikelihood, PoseLikelihood
from .proposals import Candidates
from .samples import LEAST_SPREAD, BodySamples, first, part_message, predicted, stationary, weighted_moments
from .tempering import temper

Array = NDArray[np.float64]

CANDIDATES, LOOKED_AT = 10, 4
"""Poses that are drawn at first, and those of them that are compared with edges, over those that are kept."""

FIRST = 10_000  # poses that are drawn in the first frame, at least: nothing is known of the arms
IMAGE_ONLY = 0.4  # share of a part's draws, of poses without a past, for which other chains are not asked
PREDICTED = 0.3  # share of the hands drawn where other chains expect them, not where they are seen
GROUPS = 4  # Gaussians by which each part is predicted


@short_repr
@dataclass(frozen=True)
class ArticulatedPose:
    """Likelihood sampling of an articulated body (RSMCM paper §4.1).

    X is a pose in 16 degrees of freedom, F the places of head and hands in the picture:

        p(X_t | X_t-1) ~ sum_e p(e) K(X_t | e(X_t-1), dt) g(X_t)
        p(F | X)       = delta(F - parts(X))
        p(I | X)       = face(I, X) skin(I, X) clothes(I, X) edges(I, X)

    e leaves the hands or exchanges them, K are the `BodyDynamics`, g is small for unusual postures and 0 for
    impossible ones; the likelihood is `BodyLikelihood`'s. The message to F is the prediction of each part's
    place, a mixture of a few Gaussians.

    In the first frame head and hands are drawn from what reaches F - face and skin in the image, and the
    other chains' predictions - and completed to poses by inverse kinematics (`draw_from_likelihood`); then
    poses are drawn from those of the frame before, some with a hand where it is seen (`draw_guided`).

    The paper weighs its samples once, with the posterior over the density from which they were drawn. Here
    they are only made samples of the prediction in this way; the likelihood then comes in by tempering, with
    Metropolis moves after each step (`temper`). What is improbable keeps a share of the samples (`Strata`).

    It needs few samples, since they are where the image says that the parts are, and it finds a lost body
    again by itself; but it takes what the detectors say. Together with a tracker of the parts
    (`FleshTracker`) it survives where they fail.

    When no feature was found in a frame, the state is stationary: poses are predicted, weighted by what the
    other chains say, and nothing is invented. Where no pose is possible that fits the features, they are
    predicted as well.

    Parameters
    ----------
    body
        lengths of the segments.
    samples
        poses that are kept in every frame, 10 or more.
    start
        poses of which one is about that of the first frame; `None` if nothing is known of it.
    seed
        of the random numbers.
    dynamics, likelihood
        of this body; the usual ones, unless given.
    name
        of the chain.

    Raises
    ------
    ValueError
        if there are fewer than 10 samples, or no poses to start from.
    """

    body: UpperBody
    samples: int = 1000
    _: KW_ONLY
    start: BodyPoses | None = None
    seed: int = 0
    dynamics: BodyDynamics | None = None
    likelihood: PoseLikelihood | None = None
    name: str = "pose"

    ports = (Port(BodyParts),)

    def __post_init__(self) -> None:
        if self.samples < 10:
            raise ValueError(f"samples: got {self.samples}, expected 10 or more")
        if self.start is not None and not len(self.start):
            raise ValueError("start: got no poses, expected one or more")

    def initial(self, frame: Frame) -> BodySamples:
        """Poses about the start, or anywhere in the picture."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        random = np.random.default_rng(self.seed)
        return first(self._dynamics, self.samples, frame.image.shape[:2], random, self.start)

    def predict(self, state: BodySamples, dt: float) -> BodySamples:
        """Draws of the dynamics around the poses of the frame before."""
        return predicted(self._dynamics, state, self.samples, dt)

    def message(self, state: BodySamples, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Where the parts should be (mu_{X -> F}): mixtures with the moments of the predicted poses."""
        return part_message(self.body, state.poses, state.weights, GROUPS)

    def update(self, state: BodySamples, incoming: Incoming) -> BodySamples:
        """Samples of the posterior, or of the prediction where there is nothing to sample from."""
        message = incoming[BodyParts]
        image = message.image
        if image is None or not image.mixtures.informative.any():
            return stationary(state, message.log_values(self.body.parts(state.poses)))
        random = copied(state.random)
        candidates = self._candidates(state, message, random)
        if not np.isfinite(candidates.log_weights).any():
            return stationary(state, np.zeros(len(state.poses)))
        likelihood = (self.likelihood or BodyLikelihood(self.body))(image)

        def log_prior(poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
            return candidates.log_prior(poses, owners) + message.log_values(self.body.parts(poses))

        found = temper(
            self._dynamics,
            candidates.poses,
            candidates.log_weights,
            log_prior,
            likelihood,
            self.samples,
            random,
            LOOKED_AT * self.samples,
        )
        return BodySamples(
            found.poses, found.log_weights, state.size, random, log_evidence=found.log_evidence
        )

    def _candidates(
        self, state: BodySamples, message: PartMessage, random: np.random.Generator
    ) -> Candidates:
        """Poses that are tried, weighed by what other chains say."""
        assert message.image is not None
        seen, past, n = message.image.mixtures, state.ancestors, CANDIDATES * self.samples
        said = self._mixtures(message, seen, state)
        if past is None:
            found = Candidates.at_first(self._dynamics, state.size, said, max(FIRST, n), random)
        else:
            guides = ((seen, 1 - PREDICTED), (message.predicted, PREDICTED))
            found = Candidates.after(self._dynamics, state.size, past, guides, said, n, random)
        return found.weighed(message.log_values(self.body.parts(found.poses)))

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: PoseTrajectory | None = None
    ) -> Smoothed[PoseTrajectory]:
        """Poses in all frames, given what all frames show and what other chains say."""
        likelihood = self.likelihood or BodyLikelihood(self.body)
        return Smoothed(smoothed_poses(self, self._dynamics, likelihood, incoming_over_time))

    def messages(
        self, trajectory: PoseTrajectory, feature: BodyParts, incoming_over_time: Sequence[BatchIncoming] = ()
    ) -> list[PartMessage]:
        """Where parts should be by the poses of the frame before, with hindsight (mu_{X -> F})."""
        return predicted_messages(self, trajectory.samples, trajectory.times, feature)

    @property
    def _dynamics(self) -> BodyDynamics:
        return self.dynamics or BodyDynamics(self.body)

    def _mixtures(self, message: PartMessage, seen: GaussianMixtures, state: BodySamples) -> GaussianMixtures:
        """What parts are drawn from: all that is said, now and then the image alone (others may be wrong)."""
        means, covariances = weighted_moments(self.body.parts(state.poses), state.weights)
        covariances += LEAST_SPREAD**2 * np.eye(2)
        area = np.log(float(state.size[0]) * state.size[1])
        all_said, image_only = (each.proper(area, means, covariances) for each in (message.mixtures, seen))
        return all_said.blended(image_only, IMAGE_ONLY)

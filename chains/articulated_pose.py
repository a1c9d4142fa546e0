"""The pose of a person's upper body in 13 degrees of freedom, by likelihood sampling."""

import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..inference.body.dynamics import BodyDynamics
from ..inference.body.likelihood_sampling import LikelihoodSampler, Past
from ..inference.body.samples import LEAST_SPREAD, BodySamples, first, part_message, predicted, stationary
from ..inference.body.tempering import temper
from ..inference.core.protocols import Incoming, Port
from ..models.body.likelihood import BodyLikelihood
from ..models.body.parts import BodyParts, PartMessage
from ..models.body.poses import BodyPoses
from ..models.body.upper_body import UpperBody
from ..models.core.frame import Frame
from ..models.core.gaussian_mixtures import GaussianMixtures
from ..models.core.short_repr import short_repr

Array = NDArray[np.float64]

CANDIDATES = 2
"""Poses that are drawn at first, over those that are kept."""

FIRST = 10_000
"""Poses that are drawn in the first frame, at least: nothing is known of the arms."""

IMAGE_ONLY = 0.4
"""Share of a part's draws for which other chains are not asked."""

GROUPS = 4
"""Gaussians by which each part is predicted."""


@short_repr
class ArticulatedPose:
    """Likelihood sampling of an articulated body (RSMCM paper §4.1).

    In every frame positions of head and hands are drawn from what reaches the feature node - face and flesh
    in the image, and the other chains' predictions - and completed to poses by inverse kinematics
    (`LikelihoodSampler`). The posterior is the likelihood of the image (face, flesh, edges) times the other
    chains' messages times the temporal prior: the mixture of the dynamics around the poses of the frame
    before, and around the same with their hands exchanged, in which unusual postures count less
    (`BodyDynamics`).

    The paper weighs its samples once, with the posterior over the density from which they were drawn. Here
    they are only made samples of the prior in this way; the likelihood then comes in by tempering, with
    Metropolis moves after each step (`temper`).

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
        poses that are kept in every frame.
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

    ports = (Port(BodyParts),)

    def __init__(
        self,
        body: UpperBody,
        samples: int = 1000,
        *,
        start: BodyPoses | None = None,
        seed: int = 0,
        dynamics: BodyDynamics | None = None,
        likelihood: BodyLikelihood | None = None,
        name: str = "pose",
    ) -> None:
        if samples < 10:
            raise ValueError(f"samples: got {samples}, expected 10 or more")
        if start is not None and not len(start):
            raise ValueError("start: got no poses, expected one or more")
        self.body = body
        self.samples = samples
        self.start = start
        self.seed = seed
        self.dynamics = dynamics or BodyDynamics(body)
        self.likelihood = likelihood or BodyLikelihood(body)
        self.name = name
        self._sampler = LikelihoodSampler(self.dynamics)

    def initial(self, frame: Frame) -> BodySamples:
        """Poses about the start, or anywhere in the picture."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        size = frame.image.shape[:2]
        random = np.random.default_rng(self.seed)
        return first(self.dynamics, self.samples, size, random, self.start)

    def predict(self, state: BodySamples, dt: float) -> BodySamples:
        """Draws of the dynamics around the poses of the frame before."""
        return predicted(self.dynamics, state, self.samples, dt)

    def message(self, state: BodySamples, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Where the parts should be (mu_{X -> F}): mixtures with the moments of the predicted poses."""
        return part_message(self.body, state.poses, state.weights, GROUPS)

    def update(self, state: BodySamples, incoming: Incoming) -> BodySamples:
        """Samples of the posterior, or of the prediction where there is nothing to sample from."""
        message = incoming[BodyParts]
        others, image = message.predicted, message.image
        if image is None or not image.mixtures.informative.any():
            return stationary(state, others.log_values(self.body.parts(state.poses)).sum(axis=1))
        random = copy.deepcopy(state.random)
        past = _past(state)
        n = CANDIDATES * self.samples if past else max(FIRST, CANDIDATES * self.samples)
        proposal = self._sampler.draw(self._mixtures(message, image.mixtures, state), past, n, random)
        poses = proposal.poses
        if not len(poses):
            return stationary(state, np.zeros(len(state.poses)))

        def log_prior(poses: BodyPoses) -> Array:
            parts = self.body.parts(poses)
            if past is None:
                prior = self.dynamics.log_density_anywhere(poses, state.size)
            else:
                prior = self.dynamics.log_density(poses, past.poses, past.weights, past.elapsed)
            return np.where(self.body.allowed(poses), prior + others.log_values(parts).sum(axis=1), -np.inf)

        def log_likelihood(poses: BodyPoses) -> Array:
            return self.likelihood(image, poses)

        prior = log_prior(poses)
        found = temper(
            self.dynamics,
            poses,
            prior - proposal.log_density,
            log_prior,
            log_likelihood,
            self.samples,
            random,
        )
        return replace(
            state,
            poses=found.poses,
            log_weights=found.log_weights,
            ancestors=None,
            ancestor_weights=None,
            log_evidence=found.log_evidence,
            stationary=False,
            random=random,
        )

    def _mixtures(self, message: PartMessage, seen: GaussianMixtures, state: BodySamples) -> GaussianMixtures:
        """What parts are drawn from: all that is said, and now and then only what the image says.

        Other chains may be mistaken; a part that they do not expect where it is must be drawn to be found.
        What was not detected is where it is predicted to be.
        """
        places, weights = self.body.parts(state.poses), state.weights
        means = np.einsum("n,npx->px", weights, places)
        apart = places - means
        covariances = np.einsum("n,npx,npy->pxy", weights, apart, apart) + LEAST_SPREAD**2 * np.eye(2)
        area = np.log(float(state.size[0]) * state.size[1])
        all_said, image_only = (each.proper(area, means, covariances) for each in (message.mixtures, seen))
        return all_said.blended(image_only, IMAGE_ONLY)


def _past(state: BodySamples) -> Past | None:
    if state.ancestors is None or state.ancestor_weights is None:
        return None
    return Past(state.ancestors, state.ancestor_weights, state.elapsed)

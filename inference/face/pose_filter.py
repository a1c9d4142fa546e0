"""The Rao-Blackwellised particle filter of G-flow: its state, and what a picture makes of it (Table 2)."""

import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...models.background.pixel_labels import PixelMessage
from ...models.face.image_pyramid import Level, image_pyramid
from ...models.face.outline import MeshEdges
from ...models.face.pose import Poses
from ...models.face.texel_noise import TexelNoise
from ...models.points.point_tracks import PointMessage
from ..filters.resampling import log_sum, normalised
from .background_contrast import OccludedBackground, SharedBackground, first_trust, tones, units
from .coverage import MARGIN, Coverage, widened
from .expert_background import ExpertBackground
from .experts import Particles, log_likelihood, propagated, resampled, sampled
from .gauss_newton import find_modes
from .pose_dynamics import PoseDynamics, PosePrior
from .pose_terms import PoseEvidence, measured_points
from .search import apart, likely_places
from .silhouette import Silhouette
from .texture_filter import Texture, explained
from .texture_likelihood import TexturedObject, TextureLikelihood

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_FIT = 0.5
"""Share of the picture's variance under the object that its texture has to explain."""

RETURN_FIT = 0.7
"""The same for an object that was lost and is found elsewhere: chance has had many places to try."""

PATIENCE = 3
"""Pictures in a row without that share after which the object is lost."""


@dataclass(frozen=True, eq=False)
class GFlowState:
    """Experts: each a history of poses, of which the last is kept, and the texture that follows from it.

    Parameters
    ----------
    poses
        of the experts.
    log_weights
        `(n_experts,)`, normalised.
    texture
        of every expert.
    trusted
        poses in the last picture that left no doubt.
    size
        px: of the object at the start.
    elapsed
        s since the last picture.
    frames_seen
        pictures until now.
    log_evidence
        nats: log p(y_t | y_1:t-1) of the last picture, of its effective pixels.
    fit
        share of the picture's variance under the object that the predicted texture explained, from -1 to 1:
        -log(1 - fit) / 2 nats a pixel is the evidence for the texture over a broad alternative, a Gaussian
        with the picture's own mean and variance there, where the noise is not taken for known.
    doubts
        pictures in a row with too low a fit.
    relocations
        how often it was lost and found again.
    random
        source of all draws.
    covariance
        `(n_experts, dimension, dimension)`: of what each expert believed of its pose, by Laplace's method.
    trust
        `(height, width)` float32, from 0 to 1: how well the background of each pixel is known, where another
        chain predicts it; `None` without one.
    background
        of every expert, where each has its own.
    motion
        `(n_experts, dimension)` per second: last change of each expert's pose, where there was one.
    """

    poses: Poses
    log_weights: Array
    texture: Texture
    trusted: Poses
    size: float
    elapsed: float
    frames_seen: int
    log_evidence: float
    fit: float
    doubts: int
    relocations: int
    random: np.random.Generator
    covariance: Array
    trust: NDArray[np.float32] | None = None
    background: ExpertBackground | None = None
    motion: Array | None = None

    @property
    def weights(self) -> Array:
        """`(n_experts,)`, sum 1."""
        weights: Array = np.exp(self.log_weights)
        return weights

    @property
    def lost(self) -> bool:
        """Whether the tracker knows that it does not follow the object."""
        return self.doubts >= PATIENCE


@dataclass(frozen=True, eq=False)
class PoseFilter:
    """What a picture makes of experts.

    Parameters
    ----------
    surface
        shape and texels.
    whole
        the whole mesh, as it hides what is behind it.
    edges
        of its triangles.
    noise
        of the texels.
    dynamics, levels, local_mean, effective_pixels, samples, spread, resample_every, recover, occlusion
        as of `GFlow`.
    own_background
        whether each expert has a map of the background.
    tracked
        `(n_tracked,)` numbers of the vertices whose places messages of points tell.
    texture_given
        whether the texture is known before the first picture.
    """

    surface: TexturedObject
    whole: TexturedObject | None
    edges: MeshEdges
    noise: TexelNoise
    dynamics: PoseDynamics
    levels: int
    local_mean: bool
    effective_pixels: float
    samples: int
    spread: float
    resample_every: int
    recover: bool
    occlusion: bool
    own_background: bool
    tracked: NDArray[np.int64]
    texture_given: bool

    def updated(self, state: GFlowState, message: PixelMessage, points: PointMessage | None) -> GFlowState:
        """The state after a picture, given the messages of the others to its pixels and points.

        An object that fits no longer may have jumped: it is searched for as if it were lost, and believed
        where it is found.
        """
        image = message.image
        if image is None:
            return state
        state = replace(state, random=copy.deepcopy(state.random))
        pyramid = image_pyramid(image, state.size, n_levels=self.levels, local_mean=self.local_mean)
        if state.frames_seen == 0:
            particles, visible = self._weighed(state, pyramid)
        elif state.lost and self.recover:
            particles, visible = self._relocated(state, pyramid)
        else:
            background = self._background(state, message, image)
            particles, visible = self._followed(state, pyramid, background, points)
        after = self._textured(state, particles, visible, pyramid)
        if after.doubts and self.recover and not state.lost:
            astray = replace(state, doubts=PATIENCE)
            elsewhere = self._textured(astray, *self._relocated(astray, pyramid), pyramid)
            after = after if elsewhere.lost else elsewhere
        if self.whole is None or (after.doubts and self.recover):
            return after
        if self.own_background:
            return self._with_own_background(after, particles, image)
        return after if message.background is None else self._with_trust(after, message)

    def prior(self, state: GFlowState) -> PosePrior:
        """Of the poses now, `state.elapsed` seconds after the last picture."""
        return PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)

    def _visible(self, poses: Poses) -> Mask:
        """`(n, n_texels)`: texels that the object does not hide itself."""
        if self.occlusion:
            return self.surface.visible(poses)
        return np.ones((len(poses), len(self.surface.texels)), np.bool_)

    def _likelihood(self, state: GFlowState, pyramid: list[Level], poses: Poses) -> TextureLikelihood:
        texture = state.texture
        return TextureLikelihood(
            self.surface, pyramid, texture.mean, texture.temperature(self.noise), self._visible(poses)
        )

    def _weighed(self, state: GFlowState, pyramid: list[Level]) -> tuple[Particles, Mask]:
        """Weights at t = 1 (Table 2, I), and the texels that are seen in each pose `(n, n_texels)`."""
        likelihood = self._likelihood(state, pyramid, state.poses)
        every = np.arange(len(state.poses))
        weights = state.log_weights + log_likelihood(likelihood, state.poses, every, self.effective_pixels)
        evidence = float(log_sum(weights))
        particles = Particles(state.poses, normalised(weights), every, evidence, state.covariance)
        return particles, likelihood.visible

    def _followed(
        self,
        state: GFlowState,
        pyramid: list[Level],
        background: OccludedBackground | None,
        points: PointMessage | None,
    ) -> tuple[Particles, Mask]:
        """Continuation or resampling frame (Table 2, II)."""
        likelihood = self._likelihood(state, pyramid, state.poses)
        prior = self.prior(state)
        more: list[PoseEvidence] = []
        known = None
        if points is not None and len(self.tracked):
            known = measured_points(self.surface.model, points.positions, self.tracked)
            more.append(known)
        if background is not None:
            more.append(
                Silhouette(self.surface.model, self.edges, background.contrast, self.effective_pixels)
            )
        start = state.poses
        if len(start) > 1 and state.motion is not None:
            start = apart(start, state.elapsed * state.motion, prior.walk, state.random)
        modes = find_modes(likelihood, prior, start, self.effective_pixels, len(pyramid) - 1, more)
        likelihood = replace(likelihood, visible=self._visible(modes.poses))
        background = None if background is None else background.around(modes.poses)

        def density(poses: Poses, owner: NDArray[np.int64]) -> Array:
            nats = log_likelihood(likelihood, poses, owner, self.effective_pixels, background)
            return nats if known is None else nats - known.equations(poses, owner)[0]

        if self.spread == 0 or state.frames_seen % self.resample_every:
            nats = density(modes.poses, np.arange(len(start)))
            return propagated(state.log_weights, modes, prior, nats), likelihood.visible
        proposal = sampled(modes, self.samples, self.spread, state.random)
        nats = density(proposal.poses, proposal.owner)
        particles = resampled(state.log_weights, proposal, prior, nats, state.random)
        return particles, self._visible(particles.poses)

    def _relocated(self, state: GFlowState, pyramid: list[Level]) -> tuple[Particles, Mask]:
        """Search all over the picture, from the likeliest places, with the best expert's texture."""
        n = len(state.poses)
        best = np.full(n, int(state.log_weights.argmax()))
        remembered = replace(state, texture=state.texture.of(best))
        likelihood = self._likelihood(remembered, pyramid, state.trusted[best])
        places = likely_places(likelihood, state.trusted[best[:1]], n)
        prior = PosePrior.after(places, self.dynamics, state.size, 1.0)
        modes = find_modes(likelihood, prior, places, self.effective_pixels, len(pyramid) - 1)
        likelihood = replace(likelihood, visible=self._visible(modes.poses))
        weights = log_likelihood(likelihood, modes.poses, np.arange(n), self.effective_pixels)
        evidence = float(log_sum(weights) - np.log(n))
        particles = Particles(modes.poses, normalised(weights), best, evidence, modes.covariance)
        return particles, likelihood.visible

    def _textured(
        self, state: GFlowState, particles: Particles, visible: Mask, pyramid: list[Level]
    ) -> GFlowState:
        """Textures given the poses (Table 2, III), and how well the predicted ones fitted."""
        texture = state.texture.of(particles.parents)
        observed, seen = self.surface.observe(pyramid, particles.poses, visible)
        fit = 1.0
        if state.frames_seen or self.texture_given:
            shares = explained(observed[:, 0], texture.mean[:, 0], visible, seen)
            fit = float(np.exp(particles.log_weights) @ shares)
        away = state.lost and self.recover
        doubtful = fit < (RETURN_FIT if away else LEAST_FIT)
        poses, log_weights, parents = particles.poses, particles.log_weights, particles.parents
        doubts = 0
        if doubtful:
            doubts = state.doubts + 1
        elif away:
            doubts = 1  # one picture more, before it is believed
        if doubtful and away:
            poses, log_weights, texture = state.trusted, state.log_weights, state.texture
            parents = np.arange(len(poses))
        if doubts and self.recover:
            seen = np.zeros_like(seen)  # what may not be the object teaches nothing about it
        background = state.background
        if background is not None and doubts and self.recover:  # else it follows when it learns
            background = background.of(parents)
        motion = None
        if state.elapsed and not doubts:
            motion = particles.poses.changes_from(state.poses[particles.parents]) / state.elapsed
        return replace(
            state,
            poses=poses,
            log_weights=log_weights,
            texture=texture.updated(observed, seen, self.noise),
            trusted=state.trusted[parents] if doubts else poses,
            background=background,
            elapsed=0.0,
            covariance=particles.covariance,
            motion=motion,
            frames_seen=state.frames_seen + 1,
            log_evidence=particles.log_evidence,
            fit=fit,
            doubts=doubts,
            relocations=state.relocations + int(state.lost and not doubtful),
        )

    def _background(
        self, state: GFlowState, message: PixelMessage, image: NDArray[np.uint8]
    ) -> OccludedBackground | None:
        """The background of this picture near the object, if somebody predicts it."""
        own, trust = state.background, state.trust
        if self.whole is None or (own is None and (message.background is None or trust is None)):
            return None
        coverage = self._coverage(state, message.size, margin=state.size)
        near = coverage.box, tones(image, coverage.inner, coverage.box)
        unit = units(image, state.size, local_mean=self.local_mean)
        if own is not None:
            return OccludedBackground(own.contrast(image, *near, unit), self.whole)
        assert trust is not None
        return OccludedBackground(SharedBackground(message).contrast(trust, *near, unit), self.whole)

    def _with_trust(self, state: GFlowState, message: PixelMessage) -> GFlowState:
        """How well the background is known that another chain predicts."""
        coverage, trust = self._coverage(state, message.size), state.trust
        if trust is None:
            trust = first_trust(coverage.hidden, coverage.box, message.size)
        background = SharedBackground(message)
        return replace(state, trust=background.trust_after(trust, coverage.hidden, coverage.box))

    def _with_own_background(
        self, state: GFlowState, particles: Particles, image: NDArray[np.uint8]
    ) -> GFlowState:
        """Backgrounds given the poses (Table 2, III)."""
        size = (image.shape[0], image.shape[1])
        before = state.background or ExpertBackground.unknown(len(state.poses), size)
        coverage = self._coverage(state, size)
        hidden = np.stack([widened(inside > 0) for inside in coverage.inside]).view(np.uint8)
        return replace(state, background=before.updated(image, particles.parents, hidden, coverage.box))

    def _coverage(self, state: GFlowState, size: tuple[int, int], margin: float = 2 * MARGIN) -> Coverage:
        return Coverage.of(self.surface.model, state.poses, state.weights, size, margin)

"""The Rao-Blackwellised particle filter of G-flow: its state, and what a picture makes of it (Table 2)."""

import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...models.background.pixel_labels import PixelMessage
from ...models.core.short_repr import short_repr
from ...models.face.image_pyramid import Level, image_pyramid
from ...models.face.morphable_model import MorphableModel
from ...models.face.outline import MeshEdges
from ...models.face.pose import Poses
from ...models.face.surface_texels import SurfaceTexels
from ...models.face.texel_noise import TexelNoise
from ...models.points.point_tracks import PointMessage
from ..filters.resampling import log_sum, normalised
from .background_contrast import OccludedBackground, SharedBackground, first_trust, tones, units
from .coverage import MARGIN, Coverage, widened
from .expert_background import ExpertBackground
from .experts import Particles, log_likelihood, propagated, resampled, sampled
from .gauss_newton import find_modes
from .pose_dynamics import SHORTEST, PoseDynamics, PosePrior
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

PATIENCE = 0.1
"""s without that share after which the object is lost; one picture, however late, counts for half of it."""


COVERING_TEXELS = 1500
"""Of the mesh where it is integrated over what it hides."""

ROUNDING = 1e-6
"""s by which sums of frame times may be off."""


@short_repr
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
    doubt
        s for which the fit has been too low; 0 without a doubt.
    since_resampling
        s since experts were resampled.
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
    doubt: float
    since_resampling: float
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
        return self.doubt > PATIENCE - ROUNDING


@dataclass(frozen=True, eq=False)
class PoseFilter:
    """What a picture makes of experts.

    Parameters
    ----------
    surface
        shape and texels.
    noise
        of the texels.
    dynamics, levels, local_mean, effective_pixels, samples, spread, resample_interval, recover, occlusion
        as of `GFlow`.
    own_background
        whether each expert has a map of the background.
    tracked
        `(n_tracked,)` numbers of the vertices whose places messages of points tell.
    texture_given
        whether the texture is known before the first picture.
    """

    surface: TexturedObject
    noise: TexelNoise
    dynamics: PoseDynamics
    levels: int
    local_mean: bool
    effective_pixels: float
    samples: int
    spread: float
    resample_interval: float
    recover: bool
    occlusion: bool
    own_background: bool
    tracked: NDArray[np.int64]
    texture_given: bool

    @cached_property
    def _whole(self) -> TexturedObject | None:
        """The whole mesh, as it hides what is behind it."""
        model = self.surface.model
        if not len(model.triangles):
            return None
        return TexturedObject(model, SurfaceTexels.dense(model, COVERING_TEXELS))

    @cached_property
    def _edges(self) -> MeshEdges:
        return MeshEdges.of(self.surface.model.triangles)

    def updated(self, state: GFlowState, message: PixelMessage, points: PointMessage | None) -> GFlowState:
        """The state after a picture, given the messages of the others to its pixels and points.

        An object that fits no longer may have jumped: it is searched for as if it were lost, and believed
        where it is found.
        """
        image = message.image
        if image is None:
            return state
        state = replace(
            state,
            random=copy.deepcopy(state.random),
            texture=state.texture.predicted(self.noise, state.elapsed),
            since_resampling=state.since_resampling + state.elapsed,
        )
        pyramid = image_pyramid(image, state.size, n_levels=self.levels, local_mean=self.local_mean)
        if state.frames_seen == 0:
            particles, visible = self._weighed(state, pyramid)
        elif state.lost and self.recover:
            particles, visible = self._relocated(state, pyramid)
        else:
            background = self._background(state, message, image)
            particles, visible = self._followed(state, pyramid, background, points)
        after = self._textured(state, particles, visible, pyramid)
        if after.doubt and self.recover and not state.lost:
            astray = replace(state, doubt=PATIENCE)
            elsewhere = self._textured(astray, *self._relocated(astray, pyramid), pyramid)
            after = after if elsewhere.lost else elsewhere
        if self._whole is None or (after.doubt and self.recover):
            return after
        if self.own_background:
            return self._with_own_background(after, particles, image, state.elapsed)
        return after if message.background is None else self._with_trust(after, message, state.elapsed)

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
                Silhouette(self.surface.model, self._edges, background.contrast, self.effective_pixels)
            )
        start = state.poses
        if len(start) > 1 and state.motion is not None:
            start = apart(start, state.elapsed * state.motion, prior.variance, state.random)
        modes = find_modes(likelihood, prior, start, self.effective_pixels, len(pyramid) - 1, more)
        likelihood = replace(likelihood, visible=self._visible(modes.poses))
        background = None if background is None else background.around(modes.poses)

        def density(poses: Poses, owner: NDArray[np.int64]) -> Array:
            nats = log_likelihood(likelihood, poses, owner, self.effective_pixels, background)
            return nats if known is None else nats - known.equations(poses, owner)[0]

        if not self._resamples(state):
            nats = density(modes.poses, np.arange(len(start)))
            return propagated(state.log_weights, modes, prior, nats), likelihood.visible
        proposal = sampled(modes, self.samples, self.spread, state.random)
        nats = density(proposal.poses, proposal.owner)
        particles = resampled(state.log_weights, proposal, prior, nats, state.random)
        return particles, self._visible(particles.poses)

    def _resamples(self, state: GFlowState) -> bool:
        """Whether it is time to resample."""
        return self.spread > 0 and state.since_resampling > self.resample_interval - ROUNDING

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
        one = min(max(state.elapsed, SHORTEST), PATIENCE / 2)
        doubt = 0.0
        if doubtful:
            doubt = state.doubt + one
        elif away:
            doubt = one  # one picture more, before it is believed
        if doubtful and away:
            poses, log_weights, texture = state.trusted, state.log_weights, state.texture
            parents = np.arange(len(poses))
        if doubt and self.recover:
            seen = np.zeros_like(seen)  # what may not be the object teaches nothing about it
        background = state.background
        if background is not None and doubt and self.recover:  # else it follows when it learns
            background = background.of(parents)
        motion = None
        if state.elapsed and not doubt:
            motion = particles.poses.changes_from(state.poses[particles.parents]) / state.elapsed
        return replace(
            state,
            poses=poses,
            log_weights=log_weights,
            texture=texture.updated(observed, seen, self.noise, state.elapsed),
            trusted=state.trusted[parents] if doubt else poses,
            background=background,
            elapsed=0.0,
            covariance=particles.covariance,
            motion=motion,
            frames_seen=state.frames_seen + 1,
            log_evidence=particles.log_evidence,
            fit=fit,
            doubt=doubt,
            since_resampling=0.0 if self._resamples(state) else state.since_resampling,
            relocations=state.relocations + int(state.lost and not doubtful),
        )

    def _background(
        self, state: GFlowState, message: PixelMessage, image: NDArray[np.uint8]
    ) -> OccludedBackground | None:
        """The background of this picture near the object, if somebody predicts it."""
        own, trust = state.background, state.trust
        if self._whole is None or (own is None and (message.background is None or trust is None)):
            return None
        coverage = self._coverage(state, message.size, margin=state.size)
        near = coverage.box, tones(image, coverage.inner, coverage.box)
        unit = units(image, state.size, local_mean=self.local_mean)
        if own is not None:
            return OccludedBackground(own.contrast(image, *near, unit, state.elapsed), self._whole)
        assert trust is not None
        return OccludedBackground(SharedBackground(message).contrast(trust, *near, unit), self._whole)

    def _with_trust(self, state: GFlowState, message: PixelMessage, elapsed: float) -> GFlowState:
        """How well the background is known that another chain predicts."""
        coverage, trust = self._coverage(state, message.size), state.trust
        if trust is None:
            trust = first_trust(coverage.hidden, coverage.box, message.size)
        background = SharedBackground(message)
        return replace(state, trust=background.trust_after(trust, coverage.hidden, coverage.box, elapsed))

    def _with_own_background(
        self, state: GFlowState, particles: Particles, image: NDArray[np.uint8], elapsed: float
    ) -> GFlowState:
        """Backgrounds given the poses (Table 2, III)."""
        size = (image.shape[0], image.shape[1])
        before = state.background or ExpertBackground.unknown(len(state.poses), size)
        coverage = self._coverage(state, size)
        hidden = np.stack([widened(inside > 0) for inside in coverage.inside]).view(np.uint8)
        after = before.updated(image, particles.parents, hidden, coverage.box, elapsed)
        return replace(state, background=after)

    def _coverage(self, state: GFlowState, size: tuple[int, int], margin: float = 2 * MARGIN) -> Coverage:
        return Coverage.of(self.surface.model, state.poses, state.weights, size, margin)


def vertex_moments(model: MorphableModel, state: GFlowState) -> tuple[Array, Array]:
    """Mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px squared of vertices."""
    positions, rows = model.positions(state.poses), model.jacobian_with_depth(state.poses)
    mean = np.einsum("n,nva->va", state.weights, positions)
    off = positions - mean
    spread = np.einsum("n,nva,nvb->vab", state.weights, off, off)
    weighted = rows @ (state.weights[:, None, None] * state.covariance)[:, None]
    return mean, spread + (weighted @ np.swapaxes(rows, -1, -2)).sum(axis=0)

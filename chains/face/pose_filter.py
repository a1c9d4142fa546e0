"""The Rao-Blackwellised particle filter of G-flow: its state, and what a picture makes of it.

The state is a set of experts, each a history of poses and the texture that follows from it.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import log_sum, normalised
from ...models.core.short_repr import short_repr
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.face.surface import MeshEdges, SurfaceTexels
from ...models.pixels.pixel_labels import PixelMessage
from ...models.points.point_tracks import PointMessage
from .background import (
    MARGIN,
    Coverage,
    ExpertBackground,
    OccludedBackground,
    SharedBackground,
    first_trust,
    tones,
    units,
    widened,
)
from .experts import Particles, find_modes, log_likelihood, propagated, resampled, sampled
from .pose_terms import PoseDynamics, PoseEvidence, PosePrior, Silhouette, measured_points
from .recovery import CHANCE, ROUNDING, Finder, Trust, apart, brought_to, likely_places
from .texture_filter import TexelNoise, Texture, explained
from .texture_likelihood import Level, TexturedObject, TextureLikelihood, image_pyramid

Array = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class GFlowState:
    """Experts: each a history of poses, of which the last is kept, and the texture that follows from it."""

    poses: Poses  # of the experts
    log_weights: Array  # `(n_experts,)`, normalised
    texture: Texture  # of every expert
    trusted: Poses  # poses in the last picture that left no doubt
    size: float  # px: of the object at the start
    elapsed: float  # s since the last picture
    frames_seen: int  # pictures until now
    log_evidence: float  # nats: log p(y_t | y_1:t-1) of the last picture, of its effective pixels
    # share of the picture's variance under the object that the predicted texture explained, from -1 to 1:
    # -log(1 - fit) / 2 nats a pixel is the evidence for the texture over a broad alternative, a Gaussian with
    # the picture's own mean and variance there, where the noise is not taken for known
    fit: float
    trust: Trust  # what the tracker believes of itself
    since_resampling: float  # s since experts were resampled
    random: np.random.Generator  # source of all draws
    # `(n_experts, dimension, dimension)`: of what each expert believed of its pose, by Laplace's method
    covariance: Array
    # `(height, width)` float32, from 0 to 1: how well the background of each pixel is known, where another
    # chain predicts it; `None` without one
    known: NDArray[np.float32] | None = None
    background: ExpertBackground | None = None  # of every expert, where each has its own
    # `(n_experts, dimension)` per second: last change of each expert's pose, where there was one
    motion: Array | None = None
    # `(n_experts, n_texels)`: texels that the object in the poses does not hide itself; `None` where that has
    # not been found out
    visible: NDArray[np.bool_] | None = None
    # texture of the best expert as it was lost, where an object with a new one is on trial
    remembered: Texture | None = None

    @classmethod
    def first(cls, poses: Poses, texture: Texture, random: np.random.Generator) -> "GFlowState":
        """Before the first picture: experts in their poses, with one common texture (Table 2, I)."""
        n = len(poses)
        return cls(
            poses=poses,
            trusted=poses,
            log_weights=np.full(n, -np.log(n)),
            texture=texture.of(np.zeros(n, np.int64)),
            size=float(poses.sizes.mean()),
            elapsed=0.0,
            frames_seen=0,
            log_evidence=0.0,
            fit=1.0,
            trust=Trust(),
            since_resampling=0.0,
            random=random,
            covariance=np.zeros((n, poses.dimension, poses.dimension)),
        )

    @property
    def weights(self) -> Array:
        """`(n_experts,)`, sum 1."""
        weights: Array = np.exp(self.log_weights)
        return weights

    @property
    def lost(self) -> bool:
        """Whether the tracker knows that it does not follow the object."""
        return self.trust.lost

    @property
    def doubted(self) -> bool:
        """Whether it may not follow it."""
        return self.trust.doubt > 0

    @property
    def relocations(self) -> int:
        """How often it was lost and found again."""
        return self.trust.relocations


Mask = NDArray[np.bool_]

COVERING_TEXELS = 1500  # of the mesh where it is integrated over what it hides


@dataclass(frozen=True, eq=False)
class Sight:
    """A picture seen with particles and the textures that they remember."""

    particles: Particles  # poses
    texture: Texture  # predicted, of every particle
    observed: NDArray[np.float32]  # `(n, n_levels, n_texels)` grey levels of the picture
    # `(n, n_texels)`: texels that the object does not hide itself, and those that are seen in the picture
    visible: Mask
    inside: Mask
    fit: float  # as of `GFlowState`


@dataclass(frozen=True, eq=False)
class PoseFilter:
    """What a picture makes of experts."""

    surface: TexturedObject  # shape and texels
    noise: TexelNoise  # of the texels
    # the next nine as of `GFlow`
    dynamics: PoseDynamics
    levels: int
    local_mean: bool
    effective_pixels: float
    samples: int
    spread: float
    resample_interval: float
    recover: bool
    occlusion: bool
    own_background: bool  # whether each expert has a map of the background
    tracked: NDArray[np.int64]  # `(n_tracked,)` numbers of the vertices whose places messages of points tell
    texture_given: bool  # whether the texture is known before the first picture
    finder: Finder | None = None  # who is asked where the object is, or `None`

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
        """The state after a picture, given the messages of the others to its pixels and points."""
        image = message.image
        if image is None:
            return state
        state = replace(
            state,
            random=_copied(state.random),
            texture=state.texture.predicted(self.noise, state.elapsed),
            since_resampling=state.since_resampling + state.elapsed,
        )
        pyramid = image_pyramid(image, state.size, n_levels=self.levels, local_mean=self.local_mean)
        if state.frames_seen == 0:
            seen = self._seen(state, *self._weighed(state, pyramid), pyramid)
            after = self._learned(state, seen, state.trust)
        elif state.lost and self.recover and not state.trust.trial:
            seen, after = self._sought(state, pyramid, image)
        else:
            background = self._background(state, message, image)
            seen = self._seen(state, *self._followed(state, pyramid, background, points), pyramid)
            seen, after = self._judged(state, seen, pyramid, image)
        if self._whole is None or (after.doubted and self.recover):
            return after
        if self.own_background:
            return self._with_own_background(after, seen.particles, image, state.elapsed)
        return after if message.background is None else self._with_known(after, message, state.elapsed)

    def _judged(
        self, state: GFlowState, seen: Sight, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Sight, GFlowState]:
        """The state after a picture in which the object was followed, which may be somewhere else.

        An object that fits no longer may have jumped: it is searched for as if it were lost, and believed
        where it is found.
        """
        trust, elapsed = state.trust, state.elapsed
        low = seen.fit < trust.least_fit
        if not self.recover:
            trust = trust.doubted(elapsed) if low else trust.confirmed(seen.fit, elapsed)
            return seen, self._learned(state, seen, trust)
        if trust.trial:
            return self._tried(state, seen, pyramid, image)
        if not low:
            return seen, self._learned(state, seen, trust.confirmed(seen.fit, elapsed))
        elsewhere = self._seen(state, *self._relocated(state, pyramid), pyramid)
        if elsewhere.fit >= trust.return_fit:
            return elsewhere, self._held(state, elsewhere, trust.seen_again(elapsed))
        if not self._is_confirmed(image, seen):
            return seen, self._held(state, seen, trust.doubted(elapsed))
        if seen.fit < CHANCE:  # it is there, but looks like another
            seen = replace(seen, texture=seen.texture.forgotten())
        return seen, self._learned(state, seen, trust.confirmed(seen.fit, elapsed))

    def _sought(
        self, state: GFlowState, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Sight, GFlowState]:
        """The state after a picture in which a lost object was searched for by its texture and the finder.

        Where the finder has it and its texture explains too little, it is tried with a new one.
        """
        trust = state.trust
        best = int(state.log_weights.argmax())
        places = None
        if self.finder is not None:
            places = self.finder.find(image, state.trusted[best], trust.searches)
        seen = self._seen(state, *self._relocated(state, pyramid, places), pyramid)
        if seen.fit >= trust.return_fit:
            return seen, self._held(state, seen, trust.seen_again(state.elapsed))
        if places is None or not len(places):
            return seen, self._remembering(state, seen)
        known = seen.fit >= CHANCE
        n = len(state.poses)
        chosen = seen.particles.poses[int(seen.particles.log_weights.argmax())] if known else places[0]
        begun = Particles(
            chosen[np.zeros(n, np.int64)],
            np.full(n, -np.log(n)),
            np.zeros(n, np.int64),
            seen.particles.log_evidence,
            np.zeros_like(state.covariance),
        )
        anew = replace(
            state, texture=state.texture.forgotten(), remembered=state.texture.of(np.array([best]))
        )
        first = self._seen(anew, begun, self._visible(begun.poses), pyramid)
        return seen, replace(self._learned(anew, first, trust.on_trial(known=known)), fit=seen.fit)

    def _tried(
        self, state: GFlowState, seen: Sight, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Sight, GFlowState]:
        """The state after a picture with an object on trial; the old texture may know better."""
        trust = state.trust
        if state.remembered is not None:
            every = np.zeros(len(state.poses), np.int64)
            rival = replace(state, texture=state.remembered.of(every))
            known = self._seen(rival, *self._relocated(rival, pyramid, seen.particles.poses[:1]), pyramid)
            if known.fit >= trust.return_fit:
                after = self._held(rival, known, trust.seen_again(state.elapsed))
                return known, replace(after, remembered=None)
        if seen.fit < trust.least_fit or not self._is_confirmed(image, seen):
            return seen, self._remembering(state, seen)
        tried = trust.tried(seen.fit, state.elapsed)
        after = self._learned(state, seen, tried)
        return seen, after if tried.trial else replace(after, remembered=None)

    def _is_confirmed(self, image: NDArray[np.uint8], seen: Sight) -> bool:
        """Whether the finder says that the object is where it is followed."""
        if self.finder is None:
            return False
        particles = seen.particles
        return self.finder.confirms(image, particles.poses.mean(np.exp(particles.log_weights)))

    def prior(self, state: GFlowState) -> PosePrior:
        """Of the poses now, `state.elapsed` seconds after the last picture."""
        return PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)

    def _visible(self, poses: Poses) -> Mask:
        """`(n, n_texels)`: texels that the object does not hide itself."""
        if self.occlusion:
            return self.surface.visible(poses)
        return np.ones((len(poses), len(self.surface.texels)), np.bool_)

    def _likelihood(self, state: GFlowState, pyramid: list[Level], visible: Mask) -> TextureLikelihood:
        texture = state.texture
        return TextureLikelihood(
            self.surface, pyramid, texture.mean, texture.temperature(self.noise), visible
        )

    def _weighed(self, state: GFlowState, pyramid: list[Level]) -> tuple[Particles, Mask]:
        """Weights at t = 1 (Table 2, I), and the texels that are seen in each pose `(n, n_texels)`."""
        likelihood = self._likelihood(state, pyramid, self._visible(state.poses))
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
        visible = self._visible(state.poses) if state.visible is None else state.visible
        likelihood = self._likelihood(state, pyramid, visible)
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

    def _relocated(
        self, state: GFlowState, pyramid: list[Level], shown: Poses | None = None
    ) -> tuple[Particles, Mask]:
        """Search with the best expert's texture all over the picture, and where others have `shown` it."""
        n, best = len(state.poses), int(state.log_weights.argmax())
        last = state.trusted[best]
        remembered = replace(state, texture=state.texture.of(np.array([best])))
        visible = self._visible(last)
        likelihood = self._likelihood(remembered, pyramid, visible)
        coarse = partial(likelihood.misfit, level=len(pyramid) - 1)
        size = pyramid[0].image.shape[0], pyramid[0].image.shape[1]
        places = likely_places(coarse, size, last, self.surface.positions(last)[0].mean(axis=0), n)
        if shown is not None and len(shown):
            places = Poses.concatenated([places, brought_to(self.surface.model, last, shown[:n])])
        every = np.full(len(places), best)
        prior = PosePrior.after(places, self.dynamics, state.size, 1.0)
        likelihood = self._likelihood(
            replace(state, texture=state.texture.of(every)), pyramid, visible[0 * every]
        )
        modes = find_modes(likelihood, prior, places, self.effective_pixels, len(pyramid) - 1)
        modes = find_modes(likelihood, prior, modes.poses, self.effective_pixels, 1)
        likelihood = replace(likelihood, visible=self._visible(modes.poses))
        weights = log_likelihood(likelihood, modes.poses, np.arange(len(places)), self.effective_pixels)
        chosen = np.sort(np.argsort(-weights, kind="stable")[:n])
        evidence = float(log_sum(weights[chosen]) - np.log(n))
        particles = Particles(
            modes.poses[chosen],
            normalised(weights[chosen]),
            every[chosen],
            evidence,
            modes.covariance[chosen],
        )
        return particles, likelihood.visible[chosen]

    def _seen(self, state: GFlowState, particles: Particles, visible: Mask, pyramid: list[Level]) -> Sight:
        """What the picture shows of the object in these poses, and how well that was predicted."""
        texture = state.texture.of(particles.parents)
        observed, inside = self.surface.observe(pyramid, particles.poses, visible)
        fit = 1.0
        if state.frames_seen or self.texture_given:
            shares = explained(observed, texture.mean, visible, inside)
            fit = float(np.exp(particles.log_weights) @ shares)
        return Sight(particles, texture, observed, visible, inside, fit)

    def _learned(self, state: GFlowState, seen: Sight, trust: Trust) -> GFlowState:
        """Poses, and textures given the poses (Table 2, III)."""
        particles = seen.particles
        motion = None
        if state.elapsed and not trust.doubt:
            motion = particles.poses.changes_from(state.poses[particles.parents]) / state.elapsed
        texture = seen.texture.updated(seen.observed, seen.inside, self.noise, state.elapsed)
        return replace(
            self._after(state, seen, trust),
            texture=texture,
            trusted=state.trusted[particles.parents] if trust.doubt else particles.poses,
            motion=motion,
        )

    def _held(self, state: GFlowState, seen: Sight, trust: Trust) -> GFlowState:
        """Poses, but nothing is learned of what may not be the object."""
        parents = seen.particles.parents
        background = state.background
        if background is not None:  # else it follows when it learns
            background = background.of(parents)
        after = self._after(state, seen, trust)
        return replace(after, texture=seen.texture, trusted=state.trusted[parents], background=background)

    def _remembering(self, state: GFlowState, seen: Sight) -> GFlowState:
        """As it was last seen: it is not found, or what was on trial is not the object."""
        texture = state.texture
        if state.remembered is not None:
            texture = state.remembered.of(np.zeros(len(state.poses), np.int64))
        trust = state.trust.doubted(state.elapsed)
        return replace(
            self._after(state, seen, replace(trust, searches=trust.searches + 1)),
            poses=state.trusted,
            visible=None,
            log_weights=state.log_weights,
            texture=texture,
            remembered=None,
        )

    def _after(self, state: GFlowState, seen: Sight, trust: Trust) -> GFlowState:
        """What every picture changes."""
        particles = seen.particles
        return replace(
            state,
            poses=particles.poses,
            visible=seen.visible,
            log_weights=particles.log_weights,
            trust=trust,
            elapsed=0.0,
            covariance=particles.covariance,
            motion=None,
            frames_seen=state.frames_seen + 1,
            log_evidence=particles.log_evidence,
            fit=seen.fit,
            since_resampling=0.0 if self._resamples(state) else state.since_resampling,
        )

    def _background(
        self, state: GFlowState, message: PixelMessage, image: NDArray[np.uint8]
    ) -> OccludedBackground | None:
        """The background of this picture near the object, if somebody predicts it."""
        own, known = state.background, state.known
        if self._whole is None or (own is None and (message.background is None or known is None)):
            return None
        coverage = self._coverage(state, message.size, margin=state.size)
        near = coverage.box, tones(image, coverage.inner, coverage.box)
        unit = units(image, state.size, local_mean=self.local_mean)
        if own is not None:
            return OccludedBackground(own.contrast(image, *near, unit, state.elapsed), self._whole)
        assert known is not None
        return OccludedBackground(SharedBackground(message).contrast(known, *near, unit), self._whole)

    def _with_known(self, state: GFlowState, message: PixelMessage, elapsed: float) -> GFlowState:
        """How well the background is known that another chain predicts."""
        coverage, known = self._coverage(state, message.size), state.known
        if known is None:
            known = first_trust(coverage.hidden, coverage.box, message.size)
        background = SharedBackground(message)
        return replace(state, known=background.trust_after(known, coverage.hidden, coverage.box, elapsed))

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


def _copied(random: np.random.Generator) -> np.random.Generator:
    """A generator that draws what this one will (`copy.deepcopy` takes ten times as long)."""
    bits = type(random.bit_generator)(0)
    bits.state = random.bit_generator.state
    return np.random.Generator(bits)


def vertex_moments(model: MorphableModel, state: GFlowState) -> tuple[Array, Array]:
    """Mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px squared of vertices."""
    positions, rows = model.positions(state.poses), model.jacobian_with_depth(state.poses)
    mean = np.einsum("n,nva->va", state.weights, positions)
    off = positions - mean
    spread = np.einsum("n,nva,nvb->vab", state.weights, off, off)
    weighted = rows.reshape(len(rows), -1, rows.shape[3]) @ (state.weights[:, None, None] * state.covariance)
    return mean, spread + np.einsum("nvap,nvbp->vab", weighted.reshape(rows.shape), rows)

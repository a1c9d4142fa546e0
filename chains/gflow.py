"""G-flow as a chain: pose, deformation and texture of an object by a Rao-Blackwellised particle filter."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from ..inference.core.protocols import Cavity, Incoming, Port
from ..inference.face.background_contrast import Behind, Reading, first_trust, tones, units
from ..inference.face.coverage import Coverage, widened
from ..inference.face.expert_background import ExpertBackground
from ..inference.face.experts import Generation, continued, log_likelihood, resampled, sampled
from ..inference.face.gauss_newton import find_peaks
from ..inference.face.pose_dynamics import PoseDynamics, PosePrior
from ..inference.face.pose_terms import PoseEvidence, measured_points, predicted_points
from ..inference.face.relocation import likely_places
from ..inference.face.search_starts import apart
from ..inference.face.silhouette import Silhouette
from ..inference.face.texture_filter import Texture, explained
from ..inference.face.texture_likelihood import TexturedObject, TextureLikelihood
from ..inference.filters.resampling import log_sum, normalised
from ..models.background.pixel_labels import PixelLabels, PixelMessage
from ..models.core.frame import Frame
from ..models.core.short_repr import short_repr
from ..models.face.image_pyramid import Level, picture_levels
from ..models.face.morphable_model import MorphableModel
from ..models.face.outline import MeshEdges
from ..models.face.pose import Poses
from ..models.face.surface_points import SurfacePoints
from ..models.face.surface_texels import SurfaceTexels
from ..models.face.texel_noise import TexelNoise
from ..models.points.point_tracks import PointMessage, PointTracks

Array = NDArray[np.float64]

N_LEVELS = 3
LEAST_FIT = 0.5
"""Share of the picture's variance under the object that its texture has to explain."""

RETURN_FIT = 0.7
"""The same for an object that was lost and is found elsewhere: chance has had many places to try."""

COVERING_TEXELS = 1500
"""Of the mesh where it is integrated over what it hides."""

PATIENCE = 3
"""Looks in a row without that share after which the object is lost."""


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
        poses of the last look that left no doubt.
    size
        px: of the object at the start.
    elapsed
        s since the last picture.
    looks
        pictures seen.
    log_evidence
        nats: log p(y_t | y_1:t-1) of the last picture, of its effective pixels.
    fit
        share of the picture's variance under the object that the predicted texture explained, from -1 to 1:
        -log(1 - fit) / 2 nats a pixel is the evidence for the texture over a broad alternative, a Gaussian
        with the picture's own mean and variance there, where the noise is not taken for known.
    doubts
        looks in a row with too low a fit.
    relocations
        how often it was lost and found again.
    random
        source of all draws.
    covariance
        `(n_experts, dimension, dimension)`: of what each expert believed of its pose, by Laplace's method.
    motion
        `(n_experts, dimension)` per second: last change of each expert's pose, where there was one.
    trust
        `(height, width)` float32, from 0 to 1: how well the background of each pixel is known, where another
        chain predicts it; `None` without one.
    background
        of every expert, where each has its own.
    """

    poses: Poses
    log_weights: Array
    texture: Texture
    trusted: Poses
    size: float
    elapsed: float
    looks: int
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


@short_repr
@dataclass(frozen=True)
class GFlow:
    """Joint filter of pose, deformation and texture (G-flow paper, Table 2).

    Each expert looks ahead: Gauss-Newton finds the peak of its belief on coarse to fine levels. On
    resampling frames samples about the peaks, weighed by the full predictive distribution, become the next
    experts; on the others every expert goes on at its peak. Every expert has its own texture, a Kalman filter
    a texel.

    Departures: the picture is divided by its local mean, which takes light out; sums over pixels are tempered
    to an effective number of independent ones; only the finest level's texture is filtered (see `Texture`);
    experts begin their search apart; the object may be lost, and is then looked for all over the picture. A
    missing picture changes nothing but the time that has passed: points alone are not heard.

    Parameters
    ----------
    model
        shape of the object.
    start
        poses at the first picture, one for all experts or one each; or a function that finds them in it.
    experts
        how many, eta.
    surface
        `"dense"`: texels over all triangles; `"patches"`: discs about the vertices.
    texels
        how many on a dense surface.
    radius
        px, of patches.
    gain
        Kalman gain of the texels in their steady state, from 0 (template) to 1 (optic flow), or `"learned"`
        for each texel.
    temperature
        squared grey levels: noise of a texel's prediction in the steady state, tau.
    effective_pixels
        number of independent pixels that the object's pixels are worth.
    samples
        an expert on resampling frames, lambda.
    spread
        of the samples against Laplace's covariance, alpha; 0 for no resampling frames.
    resample_every
        looks from one resampling frame to the next.
    levels
        of the picture, from the finest; 1 for no coarse search.
    local_mean
        divide the picture by its local mean.
    dynamics
        of the pose.
    texture
        of the object where it is known at the start, of one expert. Without it every expert takes its texture
        from the first picture where it stands: they should then start from one pose, for an expert that
        starts off the object learns a wrong texture there and never comes back (Table 2, I, wants a common
        texture for this reason).
    recover
        doubt what does not fit, and look for the object all over the picture when it is lost.
    background
        `"experts"`: each expert has a map of the background, eq. (2), and no other chain's is used. With
        `"shared"` the background is the one that another chain predicts at the same feature node, or none.
    tracked
        numbers of the vertices that are features of `PointTracks`, in increasing order, where it is connected
        to one: an identity there is the number of a vertex.
    occlusion
        leave out texels that the object hides itself or shows at a grazing angle.
    seed
        of all draws.
    """

    model: MorphableModel
    start: Poses | Callable[[Frame], Poses]
    experts: int = 20
    surface: Literal["dense", "patches"] = "dense"
    texels: int = 2000
    radius: float = 4.0
    gain: float | Literal["learned"] = 0.05
    temperature: float = 36.0
    effective_pixels: float = 150.0
    samples: int = 10
    spread: float = 0.2
    resample_every: int = 5
    levels: int = N_LEVELS
    local_mean: bool = True
    dynamics: PoseDynamics = field(default_factory=PoseDynamics)
    texture: Texture | None = None
    recover: bool = True
    background: Literal["shared", "experts"] = "shared"
    tracked: tuple[int, ...] = ()
    occlusion: bool = True
    seed: int = 0
    name: str = "gflow"

    ports = (Port(PixelLabels, Cavity.OTHERS), Port(PointTracks, optional=True))

    def __post_init__(self) -> None:
        for name in ("experts", "texels", "samples", "resample_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected 1 or more")
        for name in ("temperature", "effective_pixels"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")
        if self.surface not in ("dense", "patches"):
            raise ValueError(f"surface: got {self.surface!r}, expected 'dense' or 'patches'")
        if not self.radius >= 1:
            raise ValueError(f"radius: got {self.radius} px, expected 1 or more")
        if self.gain != "learned" and not (isinstance(self.gain, int | float) and 0 <= self.gain <= 1):
            raise ValueError(f"gain: got {self.gain!r}, expected 0 to 1 or 'learned'")
        if not self.spread >= 0:
            raise ValueError(f"spread: got {self.spread}, expected 0 or more")
        if not 1 <= self.levels <= N_LEVELS:
            raise ValueError(f"levels: got {self.levels}, expected 1 to {N_LEVELS}")
        if self.texture is not None:
            expected = (self.levels, len(self.object.texels))
            if self.texture.mean.shape[1:] != expected:
                raise ValueError(
                    f"texture: got {self.texture.mean.shape[1:]} levels and texels, expected {expected}"
                )
        numbers = np.array(self.tracked, np.int64)
        if (np.diff(numbers) <= 0).any() or not ((numbers >= 0) & (numbers < self.model.n_vertices)).all():
            raise ValueError(
                f"tracked: got {self.tracked}, expected numbers of vertices from 0 to "
                f"{self.model.n_vertices - 1}, increasing"
            )
        if not callable(self.start):
            self._check_start(self.start)

    def _check_start(self, start: Poses) -> None:
        numbers = (start.rotations, start.translations, start.morphs)
        if not all(np.isfinite(part).all() for part in numbers) or not (start.sizes > 0).all():
            raise ValueError("start: got poses with NaN, infinity or a size of 0 or less, expected none")
        if len(start) not in (1, self.experts):
            raise ValueError(f"start: got {len(start)} poses, expected 1 or {self.experts}, one an expert")
        if start.morphs.shape[1] != self.model.n_bases:
            raise ValueError(
                f"start: got {start.morphs.shape[1]} morph coefficients, expected {self.model.n_bases}"
            )

    @cached_property
    def object(self) -> TexturedObject:
        """Shape and texels."""
        if self.surface == "dense":
            return TexturedObject(self.model, SurfaceTexels.dense(self.model, self.texels))
        return TexturedObject(self.model, SurfaceTexels.patches(self.model, self.radius))

    def _visible(self, poses: Poses) -> NDArray[np.bool_]:
        """`(n, n_texels)`: texels that the object does not hide itself."""
        if self.occlusion:
            return self.object.visible(poses)
        return np.ones((len(poses), len(self.object.texels)), np.bool_)

    @cached_property
    def _whole(self) -> TexturedObject:
        """The whole mesh, as it hides what is behind it."""
        return TexturedObject(self.model, SurfaceTexels.dense(self.model, COVERING_TEXELS))

    @cached_property
    def _edges(self) -> MeshEdges:
        return MeshEdges.of(self.model.triangles)

    @cached_property
    def noise(self) -> TexelNoise:
        """Noises of which gain and temperature are the steady state, eq. (33)."""
        return TexelNoise.of_steady_state(0.0 if self.gain == "learned" else self.gain, self.temperature)

    @classmethod
    def optic_flow(
        cls,
        model: MorphableModel,
        start: Poses,
        *,
        surface: Literal["dense", "patches"] = "patches",
        **more: Any,
    ) -> Self:
        """Constrained optic flow (§4.2): one expert at its peak, whose texture is the last picture."""
        return cls(model, start, experts=1, spread=0.0, gain=1.0, surface=surface, recover=False, **more)

    @classmethod
    def template(
        cls,
        model: MorphableModel,
        start: Poses,
        *,
        surface: Literal["dense", "patches"] = "dense",
        **more: Any,
    ) -> Self:
        """Template matching (§4.3): one expert at its peak, whose texture stays as first seen or as given."""
        return cls(model, start, experts=1, spread=0.0, gain=0.0, surface=surface, recover=False, **more)

    def initial(self, frame: Frame) -> GFlowState:
        """Experts at the start, with one common texture (Table 2, I)."""
        start = self.start
        if callable(start):
            start = start(frame)
            self._check_start(start)
        one_each = np.arange(self.experts) if len(start) == self.experts else np.zeros(self.experts, np.int64)
        n_texels, learn = len(self.object.texels), self.gain == "learned"
        texture = Texture.unknown(1, self.levels, n_texels, learn=learn)
        if self.texture is not None:
            texture = replace(texture, mean=self.texture.mean[:1], variance=self.texture.variance[:1])
        return GFlowState(
            poses=start[one_each],
            trusted=start[one_each],
            log_weights=np.full(self.experts, -np.log(self.experts)),
            texture=texture.of(np.zeros(self.experts, np.int64)),
            size=float(start.sizes.mean()),
            elapsed=0.0,
            looks=0,
            log_evidence=0.0,
            fit=1.0,
            doubts=0,
            relocations=0,
            random=np.random.default_rng(self.seed),
            covariance=np.zeros((self.experts, start.dimension, start.dimension)),
        )

    def predict(self, state: GFlowState, dt: float) -> GFlowState:
        """Poses may have changed by more when the next picture comes."""
        return replace(state, elapsed=state.elapsed + dt)

    @overload
    def message(self, state: GFlowState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: GFlowState, feature: PointTracks, incoming: Incoming) -> PointMessage: ...
    def message(
        self, state: GFlowState, feature: PixelLabels | PointTracks, incoming: Incoming
    ) -> PixelMessage | PointMessage:
        """What the object says to a feature (mu_{X -> F}); nothing while it is lost.

        To pixels: which it covers, registered with what reaches the feature where others have predicted the
        background already. To points: where its vertices should be, before the picture.
        """
        if isinstance(feature, PointTracks):
            return self._vertices_predicted(state) or feature.uniform()
        others = incoming[feature]
        if (
            state.lost
            or not len(self.model.triangles)
            or (others.image is None and others.background is None)
        ):
            return feature.uniform()
        seen = state
        if others.background is not None and others.image is not None:
            seen = self._updated(state, incoming)
            if seen.doubts and self.recover:
                return feature.uniform()
        coverage = Coverage.of(self.model, seen.poses, seen.weights, others.size)
        return PixelMessage(layers=coverage.layers(state.trust))

    def update(self, state: GFlowState, incoming: Incoming) -> GFlowState:
        """Experts and textures after the picture."""
        return self._updated(state, incoming)

    def _updated(self, state: GFlowState, incoming: Incoming) -> GFlowState:
        return incoming.once(self._after, state, incoming[PixelLabels], incoming.get(PointTracks))

    def _vertices_predicted(self, state: GFlowState) -> PointMessage | None:
        if (state.doubts and self.recover) or not self.tracked or not state.elapsed:
            return None
        prior = PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)
        chosen = np.array(self.tracked, np.int64)
        return PointMessage(predicted_points(self.model, prior, state.weights, chosen))

    def _after(self, state: GFlowState, others: PixelMessage, points: PointMessage | None) -> GFlowState:
        image = others.image
        if image is None:
            return state
        state = replace(state, random=copy.deepcopy(state.random))
        levels = picture_levels(image, state.size, n_levels=self.levels, local_mean=self.local_mean)
        if state.looks == 0:
            generation = self._first(state, levels)
        elif state.lost and self.recover:
            generation = self._found_again(state, levels)
        else:
            generation = self._followed(state, levels, self._behind(state, others), points)
        after = self._textured(state, generation, levels)
        if after.doubts and self.recover and not state.lost:
            # it may have jumped: looked for as if it were lost, and believed where it is found
            astray = replace(state, doubts=PATIENCE)
            elsewhere = self._textured(astray, self._found_again(astray, levels), levels)
            after = after if elsewhere.lost else elsewhere
        if not len(self.model.triangles) or (after.doubts and self.recover):
            return after
        if self.background == "experts":
            return self._with_own_background(after, generation, image)
        return after if others.background is None else self._with_trust(after, others)

    def _behind(self, state: GFlowState, others: PixelMessage) -> Behind | None:
        """The background of this picture near the object, if somebody predicts it."""
        own, trust, image = state.background, state.trust, others.image
        if image is None or (own is None and (others.background is None or trust is None)):
            return None
        coverage = Coverage.of(self.model, state.poses, state.weights, others.size, margin=state.size)
        usual = tones(image, coverage.inner, coverage.box)
        unit = units(image, state.size, local_mean=self.local_mean)
        if own is not None:
            return Behind(own.backdrop(image, coverage.box, usual, unit), self._whole)
        assert trust is not None
        return Behind(Reading(others).backdrop(trust, coverage.box, usual, unit), self._whole)

    def _with_trust(self, state: GFlowState, others: PixelMessage) -> GFlowState:
        """How well the background is known that another chain predicts."""
        coverage = Coverage.of(self.model, state.poses, state.weights, others.size)
        trust = state.trust
        if trust is None:
            trust = first_trust(coverage.hidden, coverage.box, others.size)
        return replace(state, trust=Reading(others).trust_after(trust, coverage.hidden, coverage.box))

    def _with_own_background(
        self, state: GFlowState, generation: Generation, image: NDArray[np.uint8]
    ) -> GFlowState:
        """Backgrounds given the poses (Table 2, III)."""
        size = (image.shape[0], image.shape[1])
        before = state.background or ExpertBackground.unknown(self.experts, size)
        coverage = Coverage.of(self.model, state.poses, state.weights, size)
        hidden = np.stack([widened(inside > 0) for inside in coverage.inside]).view(np.uint8)
        after = before.after(image, generation.parents, hidden, coverage.box)
        return replace(state, background=after)

    def _likelihood(self, state: GFlowState, levels: list[Level], poses: Poses) -> TextureLikelihood:
        texture = state.texture
        return TextureLikelihood(
            self.object, levels, texture.mean, texture.temperature(self.noise), self._visible(poses)
        )

    def _first(self, state: GFlowState, levels: list[Level]) -> Generation:
        """Weights at t = 1 (Table 2, I)."""
        likelihood = self._likelihood(state, levels, state.poses)
        every = np.arange(self.experts)
        weights = state.log_weights + log_likelihood(likelihood, state.poses, every, self.effective_pixels)
        return Generation(state.poses, normalised(weights), every, float(log_sum(weights)), state.covariance)

    def _followed(
        self, state: GFlowState, levels: list[Level], behind: Behind | None, points: PointMessage | None
    ) -> Generation:
        """Continuation or resampling frame (Table 2, II)."""
        likelihood = self._likelihood(state, levels, state.poses)
        prior = PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)
        more: list[PoseEvidence] = []
        known = None
        if points is not None and self.tracked:
            known = measured_points(self.model, points.positions, np.array(self.tracked, np.int64))
            more.append(known)
        if behind is not None:
            more.append(Silhouette(self.model, self._edges, behind.backdrop, self.effective_pixels))
        start = state.poses
        if self.experts > 1 and state.motion is not None:
            start = apart(start, state.elapsed * state.motion, prior.walk, state.random)
        peaks = find_peaks(likelihood, prior, start, self.effective_pixels, self.levels - 1, more)
        likelihood = replace(likelihood, visible=self._visible(peaks.poses))
        behind = None if behind is None else behind.around(peaks.poses)
        if self.spread == 0 or state.looks % self.resample_every:
            every = np.arange(self.experts)
            density = log_likelihood(likelihood, peaks.poses, every, self.effective_pixels, behind)
            density -= 0.0 if known is None else known.equations(peaks.poses, every)[0]
            return continued(state.log_weights, peaks, prior, density)
        seeds = sampled(peaks, self.samples, self.spread, state.random)
        density = log_likelihood(likelihood, seeds.poses, seeds.owner, self.effective_pixels, behind)
        density -= 0.0 if known is None else known.equations(seeds.poses, seeds.owner)[0]
        return resampled(state.log_weights, seeds, prior, density, self.samples, state.random)

    def _found_again(self, state: GFlowState, levels: list[Level]) -> Generation:
        """Look all over the picture, from the likeliest places, with the best expert's texture."""
        best = np.full(self.experts, int(state.log_weights.argmax()))
        remembered = replace(state, texture=state.texture.of(best))
        likelihood = self._likelihood(remembered, levels, state.trusted[best])
        places = likely_places(likelihood, state.trusted[best[:1]], self.experts)
        prior = PosePrior.after(places, self.dynamics, state.size, 1.0)
        peaks = find_peaks(likelihood, prior, places, self.effective_pixels, self.levels - 1)
        every = np.arange(self.experts)
        likelihood = replace(likelihood, visible=self._visible(peaks.poses))
        weights = log_likelihood(likelihood, peaks.poses, every, self.effective_pixels)
        return Generation(
            peaks.poses,
            normalised(weights),
            best,
            float(log_sum(weights) - np.log(len(weights))),
            peaks.covariance,
        )

    def _textured(self, state: GFlowState, generation: Generation, levels: list[Level]) -> GFlowState:
        """Textures given the poses (Table 2, III), and how well the predicted ones fitted."""
        texture = state.texture.of(generation.parents)
        visible = self._visible(generation.poses)
        looks, seen = self.object.looks(levels, generation.poses, visible)
        fit = 1.0
        if state.looks or self.texture is not None:
            fit = float(
                np.exp(generation.log_weights) @ explained(looks[:, 0], texture.mean[:, 0], visible, seen)
            )
        doubtful = fit < (RETURN_FIT if state.lost and self.recover else LEAST_FIT)
        poses, log_weights, doubts = generation.poses, generation.log_weights, 0
        if doubtful:
            doubts = state.doubts + 1
        elif state.lost and self.recover:
            doubts = 1  # one look more, before it is believed
        parents = generation.parents
        if doubtful and state.lost and self.recover:
            poses, log_weights, texture = state.trusted, state.log_weights, state.texture
            parents = np.arange(self.experts)
        if doubts and self.recover:
            seen = np.zeros_like(seen)  # what may not be the object teaches nothing about it
        background = state.background
        if background is not None and doubts and self.recover:  # else it follows when it learns
            background = background.of(parents)
        motion = None
        if state.elapsed and not doubts:
            motion = generation.poses.changes_from(state.poses[generation.parents]) / state.elapsed
        return replace(
            state,
            poses=poses,
            log_weights=log_weights,
            texture=texture.after(looks, seen, self.noise),
            trusted=state.trusted[parents] if doubts else poses,
            background=background,
            elapsed=0.0,
            covariance=generation.covariance,
            motion=motion,
            looks=state.looks + 1,
            log_evidence=generation.log_evidence,
            fit=fit,
            doubts=doubts,
            relocations=state.relocations + int(state.lost and not doubtful),
        )

    def mean_pose(self, state: GFlowState) -> Poses:
        """One pose: the experts' weighted mean."""
        return state.poses.mean(state.weights)

    def vertices(self, state: GFlowState) -> tuple[Array, Array]:
        """Mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px squared of vertices, with depth.

        The covariance is the experts' spread and what each of them leaves open (nothing in the first one).
        """
        positions, rows = self.model.positions(state.poses), self.model.jacobian_with_depth(state.poses)
        mean = np.einsum("n,nva->va", state.weights, positions)
        off = positions - mean
        spread = np.einsum("n,nva,nvb->vab", state.weights, off, off)
        weighted = rows @ (state.weights[:, None, None] * state.covariance)[:, None]
        return mean, spread + (weighted @ np.swapaxes(rows, -1, -2)).sum(axis=0)

    def points(self, state: GFlowState, points: SurfacePoints) -> Array:
        """`(n, 2)` px: where points of the surface are in the mean pose."""
        projected: Array = points.project(self.model, self.mean_pose(state))[0]
        return projected

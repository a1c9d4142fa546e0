"""G-flow as a chain: pose, deformation and texture of an object by a Rao-Blackwellised particle filter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any, Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...inference.smc import copied, log_sum, normalised
from ...models.core.checks import (
    LOG_WEIGHTS,
    Count,
    CountFrom0,
    NotNegative,
    Positive,
    Shape,
    at_least,
    between,
    checked,
)
from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.morphable_model import KNOWN, MorphableModel, Poses, SurfacePoints
from ...models.face.surface import MeshEdges, SurfaceTexels
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from ...models.points.point_tracks import PointMessage, PointTracks
from .background import (
    MARGIN,
    Coverage,
    ExpertBackground,
    OccludedBackground,
    SharedBackground,
    dilate,
    first_trust,
    tone_densities,
    units,
)
from .experts import Particles, draw_samples, find_modes, log_likelihood, propagate, resample
from .pose_terms import PoseDynamics, PoseEvidence, PosePrior, Silhouette, measured_points, predicted_points
from .recovery import (
    CHANCE,
    CHANCE_ANYWHERE,
    MEMORY,
    ROUNDING,
    Finder,
    Trust,
    align_to_detections,
    disperse,
    search_grid,
)
from .texture_filter import TexelNoise, Texture, explained_variance
from .texture_likelihood import Level, TexturedObject, TextureLikelihood, image_pyramid, local_variance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

__all__ = ["GFlow", "GFlowState"]

N_LEVELS = 3
ONE_AT_MODE: Mapping[str, Any] = {"experts": 1, "covariance_scale": 0.0, "recover": False}


@dataclass(frozen=True, eq=False)
class Memory:
    """Pose and texture, one each, of a picture in which the object was seen without a doubt."""

    pose: Annotated[Poses, KNOWN]
    texture: Texture


@short_repr
@dataclass(frozen=True, eq=False)
class GFlowState:
    """State of all experts: a pose, a weight and the texture that follows from the poses until now."""

    poses: Annotated[Poses, KNOWN]  # one an expert
    log_weights: Annotated[Array, Shape("n_experts", finite=False), LOG_WEIGHTS]  # normalised
    texture: Texture  # one an expert
    last_reliable: Annotated[Poses, KNOWN]  # poses in the last picture without a doubt
    size: Positive  # px: of the object at the start
    elapsed: NotNegative  # s since the last picture
    frames_seen: CountFrom0  # number of pictures until now
    log_evidence: float  # nats: log p(y_t | y_1:t-1) of the last picture, of its effective pixels
    # share of the picture's variance under the object that the predicted texture explained, from -1 to 1:
    # -log(1 - fit) / 2 nats a pixel is the log likelihood ratio of the texture and a Gaussian with the
    # picture's own mean and variance there, both with their noise estimated
    fit: float
    trust: Trust  # whether the object is tracked, doubted, lost or on trial
    since_resampling: NotNegative  # s since the last resampling frame
    random: np.random.Generator  # source of all draws
    # Laplace's, of each expert's pose
    covariance: Annotated[Array, Shape("n_experts", "dimension", "dimension")]
    # from 0 to 1: trust in the background that another chain predicts
    background_trust: Annotated[NDArray[np.float32], Shape("height", "width")] | None = None
    background: ExpertBackground | None = None  # one an expert, where each has its own
    # per second: from the last change of each pose
    velocity: Annotated[Array, Shape("n_experts", "dimension")] | None = None
    # texels not occluded by the object
    visible: Annotated[NDArray[np.bool_], Shape("n_experts", "n_texels")] | None = None
    # of the best expert: the first, with which a lost object is searched for, was seen at least `MEMORY` s
    # before the object was doubted, so that it shows nothing of what covers it
    memories: tuple[Memory, ...] = ()
    since_memory: NotNegative = 0.0  # s since the last of them

    def require_fit(self) -> None:
        """Raise a `ValueError` if poses or textures are not those of all experts."""
        n, _, n_texels = self.texture.mean.shape
        own = (n, self.covariance.shape[1])
        poses_fit = all((len(each), each.dimension) == own for each in (self.poses, self.last_reliable))
        memories_fit = all(memory.texture.fits(1, n_texels) for memory in self.memories)
        memories_fit &= bool(self.memories) or not self.frames_seen
        if not (poses_fit and memories_fit and self.texture.fits(n, n_texels)):
            raise ValueError(f"poses: got {len(self.poses)}, expected {n} with textures of {n_texels} texels")

    @classmethod
    def first(cls, poses: Poses, texture: Texture, random: np.random.Generator) -> "GFlowState":
        """Return the state before the first picture: experts with one common texture (Table 2, I)."""
        n = len(poses)
        return cls(
            poses=poses,
            last_reliable=poses,
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
        """Weights of the experts `(n_experts,)`, sum 1."""
        weights: Array = np.exp(self.log_weights)
        return weights

    @property
    def stated_poses(self) -> Poses:
        """Poses of the object: the last reliable ones while another one may be tracked, which is on trial."""
        return self.last_reliable if self.trust.trial else self.poses

    @property
    def lost(self) -> bool:
        """Whether the object is lost."""
        return self.trust.lost

    @property
    def tracked_probability(self) -> float:
        """Probability that the object is where it is stated to be; 0 while it is lost."""
        return 0.0 if self.lost else self.trust.probability

    @property
    def doubted(self) -> bool:
        """Whether the object may be lost: the fit has been too low in the last picture."""
        return self.trust.doubt > 0

    @property
    def relocations(self) -> int:
        """Number of times that the object was lost and found again."""
        return self.trust.relocations


def _areas(poses: Poses, visible: Mask) -> Array:
    """Return the areas of the texture in view, `(n,)` px^2: number of texels times the squared size."""
    return np.asarray(visible.sum(axis=1) * poses.sizes**2)


CONTRAST = 25.0  # squared grey levels: least contrast of a place where a lost object may be

COVERING_TEXELS = 1500  # of the whole mesh, for integrals over the background that it occludes


@dataclass(frozen=True, eq=False)
class Observation:
    """A picture sampled at the texels of particles, beside their predicted textures."""

    particles: Particles
    texture: Texture  # predicted, of every particle
    observed: NDArray[np.float32]  # `(n, n_levels, n_texels)` grey levels of the picture
    visible: Mask  # `(n, n_texels)`: not occluded by the object itself
    inside: Mask  # `(n, n_texels)`: visible, and inside the picture
    fit: float  # as of `GFlowState`
    area: float  # px^2 of the texture in view, see `_areas`


@checked
@short_repr
@dataclass(frozen=True)
class GFlow(PickledByFields):
    """Joint filter of pose, deformation and texture (G-flow paper, Table 2).

    Generative model, with pose u, texture v, background b and picture y, `dt` seconds after the last one:

        p(u_t | u_s) = N(f(u_s), Q(dt)), `PoseDynamics`
        p(v_t | v_s) = N(v_s, Psi_v dt), p(b_t | b_s) = N(b_s, Psi_b dt), texel by texel, pixel by pixel
        p(y_t | u_t, v_t, b_t) = prod_i N(y_t(x_i(u_t)); v_t,i, sigma^2) prod_j N(y_t,j; b_t,j, sigma^2)

    over visible texels i at x_i(u_t) and pixels j that the object does not cover. The message to
    `PixelLabels` is the probability that the object covers a pixel, to `PointTracks` Gaussians of vertices.

    An expert is a history of poses; given it, texture and background are Kalman filters. Gauss-Newton finds
    the mode of each expert's posterior of the pose on coarse to fine levels. In resampling frames, samples
    around the modes, weighted by the full predictive distribution, become the next experts; in other frames
    each expert continues at its mode.

    Differences from the paper: the image is divided by its local mean, which removes the light; sums over
    pixels are tempered to an effective number of independent ones; only the texture of the finest level is
    filtered (see `Texture`); experts start their search dispersed; a lost object is searched for in the whole
    image. A missing image changes only the elapsed time: points without an image are not used.

    Parameters
    ----------
    model
        shape of the object.
    start
        poses at the first image, one for all experts or one each; or a function that finds them in it.
    experts
        number of experts, eta.
    surface
        `"dense"`: texels over all triangles; `"patches"`: discs about the vertices.
    texels
        number of texels on a dense surface.
    radius
        px, of patches.
    gain
        Kalman gain of the texels in their steady state at 25 frames a second, from 0 (template) to 1 (optic
        flow), or `"learned"` for each texel. It defines a noise per second, so that the gain differs at
        another rate.
    temperature
        squared grey levels: noise of a texel's prediction in the steady state, tau.
    effective_pixels
        effective number of independent pixels among those of the object.
    samples
        number of samples of each expert on resampling frames, lambda.
    covariance_scale
        covariance of the samples over Laplace's, alpha; 0 for no resampling frames.
    resample_interval
        s from one resampling frame to the next.
    levels
        number of levels of the picture, from the finest; 1 for no coarse search.
    local_mean
        divide the picture by its local mean.
    dynamics
        random walk of the pose.
    texture
        of the object if it is known at the start, for one expert. Without it every expert learns its texture
        from the first image at its own pose. Then all should start from one pose, since an expert with a
        wrong start learns a wrong texture and does not recover (hence the common texture of Table 2, I).
    recover
        detect by the fit of the texture that the object is lost, and search for it in the whole image.
    finder
        detector for an object that may be lost, such as `DetectedFace`. Without one it is found again by its
        texture only.
    background
        `"experts"`: each expert has its own background, eq. (2). `"shared"`: another chain of the same
        feature node predicts the background, if there is one.
    tracked
        numbers of the vertices that are points of the `PointTracks` node to which the chain is connected, in
        increasing order; their identities there are these numbers.
    occlusion
        omit texels that are occluded by the object itself, or seen at a grazing angle.
    seed
        of all draws.
    """

    model: MorphableModel
    start: Poses | Callable[[Frame], Poses]
    experts: Count = 20
    surface: Literal["dense", "patches"] = "dense"
    texels: Count = 2000
    radius: Annotated[float, at_least(1)] = 4.0
    gain: Annotated[float, between(0, 1)] | Literal["learned"] = 0.05
    temperature: Positive = 36.0
    effective_pixels: Positive = 150.0
    samples: Count = 10
    covariance_scale: NotNegative = 0.2
    resample_interval: Positive = 0.2
    levels: Annotated[int, between(1, N_LEVELS)] = N_LEVELS
    local_mean: bool = True
    dynamics: PoseDynamics = field(default_factory=PoseDynamics)
    texture: Texture | None = None
    recover: bool = True
    finder: Finder | None = None
    background: Literal["shared", "experts"] = "shared"
    tracked: tuple[int, ...] = ()
    occlusion: bool = True
    seed: CountFrom0 = 0
    name: str = "gflow"

    ports = (Port(PixelLabels, Cavity.OTHERS), Port(PointTracks, optional=True))

    def __post_init__(self) -> None:
        numbers, n_vertices = self._tracked, self.model.n_vertices
        if (np.diff(numbers) <= 0).any() or not ((numbers >= 0) & (numbers < n_vertices)).all():
            raise ValueError(
                f"tracked: got {self.tracked}, expected increasing numbers from 0 to {n_vertices - 1}"
            )
        if self.texture is not None:
            self._check_texture(self.texture)
        if not callable(self.start):
            self._check_start(self.start)

    def _check_texture(self, texture: Texture) -> None:
        got, wanted = texture.mean.shape[1:], (self.levels, len(self.object.texels))
        if got != wanted:
            raise ValueError(f"texture: got {got} levels and texels, expected {wanted}")

    def _check_start(self, start: Poses) -> None:
        if not isinstance(start, Poses):
            raise TypeError(f"start: got a {type(start).__name__}, expected Poses")
        n, n_bases = start.morphs.shape
        if n not in (1, self.experts) or n_bases != self.model.n_bases:
            raise ValueError(
                f"start: got {n} poses with {n_bases} bases, expected 1 or {self.experts}, one an "
                f"expert, with {self.model.n_bases}"
            )
        if not all(np.isfinite(part).all() for part in start.arrays):
            raise ValueError("start: got NaN or infinity, expected finite poses")
        if not (start.sizes > 0).all():
            raise ValueError("start: got a size of 0 or less, expected more than 0")

    @cached_property
    def object(self) -> TexturedObject:
        """Shape and texels."""
        if self.surface == "dense":
            return TexturedObject(self.model, SurfaceTexels.dense(self.model, self.texels))
        return TexturedObject(self.model, SurfaceTexels.patches(self.model, self.radius))

    @cached_property
    def noise(self) -> TexelNoise:
        """Noise variances with this gain and temperature in the steady state, eq. (33)."""
        return TexelNoise.of_steady_state(0.0 if self.gain == "learned" else self.gain, self.temperature)

    @classmethod
    def optic_flow(cls, model: MorphableModel, start: Poses, **more: Any) -> Self:
        """Return constrained optic flow (§4.2): one expert at its mode, its patches as in the last image."""
        return cls(model, start, **{**ONE_AT_MODE, "gain": 1.0, "surface": "patches", **more})

    @classmethod
    def template(cls, model: MorphableModel, start: Poses, **more: Any) -> Self:
        """Return template matching (§4.3): one expert at its mode, with a constant texture."""
        return cls(model, start, **{**ONE_AT_MODE, "gain": 0.0, **more})

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
            # with what it returns to, which would else be what the experts' first poses show
            texture = replace(self.texture.of(np.zeros(1, np.int64)), learned=texture.learned)
        return GFlowState.first(start[one_each], texture, np.random.default_rng(self.seed))

    def predict(self, state: GFlowState, dt: float) -> GFlowState:
        """Add `dt` seconds to the time since the last picture, from which the pose prior follows."""
        self._check_texture(state.texture)  # a state may be loaded
        return replace(state, elapsed=state.elapsed + dt)

    @overload
    def message(self, state: GFlowState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: GFlowState, feature: PointTracks, incoming: Incoming) -> PointMessage: ...
    def message(
        self, state: GFlowState, feature: PixelLabels | PointTracks, incoming: Incoming
    ) -> PixelMessage | PointMessage:
        """Return the message to a feature (mu_{X -> F}); uniform while the object is lost.

        To pixels: the weight of the experts that cover each, at their poses in this image if other chains
        predict the background. To points: the predicted positions of the tracked vertices.
        """
        if isinstance(feature, PointTracks):
            if (state.doubted and self.recover) or not self.tracked or not state.elapsed:
                return feature.uniform()
            prior = self._prior(state)
            return PointMessage(predicted_points(self.model, prior, state.weights, self._tracked))
        others = incoming[feature]
        nothing_there = others.image is None and others.background is None
        if state.lost or not len(self.model.triangles) or nothing_there:
            return feature.uniform()
        seen = state
        if others.background is not None and others.image is not None:
            seen = self.update(state, incoming)
            if seen.doubted and self.recover:
                return feature.uniform()
        coverage = Coverage.of(self.model, seen.poses, seen.weights, others.size)
        return PixelMessage(layers=coverage.layers(state.background_trust))

    def update(self, state: GFlowState, incoming: Incoming) -> GFlowState:
        """Update experts and textures with the picture."""
        return incoming.once(self._process, state, incoming[PixelLabels], incoming.get(PointTracks))

    @checked
    def mean_pose(self, state: GFlowState) -> Poses:
        """Return the experts' weighted mean pose."""
        return state.stated_poses.mean(state.weights)

    @checked
    def vertices(self, state: GFlowState) -> tuple[Array, Array]:
        """Return mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px^2 of vertices, with depth.

        Moments of the mixture over experts, each with its Laplace covariance (zero in the first picture).
        """
        model = self.model
        poses = state.stated_poses
        positions, rows = model.positions(poses), model.jacobian(poses, 3)
        mean = np.einsum("n,nva->va", state.weights, positions)
        off = positions - mean
        between = np.einsum("n,nva,nvb->vab", state.weights, off, off)
        weighted = rows.reshape(len(rows), -1, rows.shape[3]) @ (
            state.weights[:, None, None] * state.covariance
        )
        return mean, between + np.einsum("nvap,nvbp->vab", weighted.reshape(rows.shape), rows)

    @checked
    def points(self, state: GFlowState, points: SurfacePoints) -> Array:
        """Return positions `(n, 2)` px of points of the surface in the mean pose."""
        projected: Array = points.project(self.model, self.mean_pose(state))[0]
        return projected

    @cached_property
    def _tracked(self) -> NDArray[np.int64]:
        return np.array(self.tracked, np.int64)

    @cached_property
    def _whole(self) -> TexturedObject | None:
        """Return texels over the whole mesh, which occludes the background; `None` without triangles."""
        model = self.model
        if not len(model.triangles):
            return None
        return TexturedObject(model, SurfaceTexels.dense(model, COVERING_TEXELS))

    @cached_property
    def _edges(self) -> MeshEdges:
        return MeshEdges.of(self.model.triangles)

    def _process(self, state: GFlowState, message: PixelMessage, points: PointMessage | None) -> GFlowState:
        """Return the state after a picture, given the others' messages to pixels and points."""
        image = message.image
        if image is None:
            return state
        state = replace(
            state,
            random=copied(state.random),
            texture=state.texture.predicted(self.noise, state.elapsed),
            since_resampling=state.since_resampling + state.elapsed,
        )
        pyramid = image_pyramid(image, state.size, n_levels=self.levels, local_mean=self.local_mean)
        if state.frames_seen == 0:
            seen = self._observe(state, *self._weigh_first_frame(state, pyramid), pyramid)
            after = self._learn(state, seen, state.trust)
        elif state.lost and self.recover and not state.trust.trial:
            seen, after = self._search(state, pyramid, image)
        else:
            background = self._occluded_background(state, message, image)
            seen = self._observe(state, *self._track(state, pyramid, background, points), pyramid)
            seen, after = self._check_track(state, seen, pyramid, image)
        if self._whole is None or (after.doubted and self.recover):
            return after
        if self.background == "experts":
            return self._update_own_background(after, seen.particles, image, state.elapsed)
        return after if message.background is None else self._update_trust(after, message, state.elapsed)

    def _check_track(
        self, state: GFlowState, seen: Observation, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Observation, GFlowState]:
        """Return the state after a picture in which the object was tracked; search it if the fit is low."""
        trust, elapsed = state.trust, state.elapsed
        low = trust.evidence(seen.fit, seen.area) < trust.least_fit
        if not self.recover:
            trust = trust.doubted(elapsed) if low else trust.confirmed(seen.fit, seen.area, elapsed)
            return seen, self._learn(state, seen, trust)
        if trust.trial:
            return self._continue_trial(state, seen, pyramid, image)
        if not low:
            return seen, self._learn(state, seen, trust.confirmed(seen.fit, seen.area, elapsed))
        elsewhere, found = self._relocate(state, pyramid)
        if found:
            return elsewhere, self._hold_texture(state, elsewhere, trust.reacquired(elapsed))
        if not self._is_confirmed(image, seen):
            return seen, self._hold_texture(state, seen, trust.doubted(elapsed))
        if seen.fit < CHANCE:  # it looks like another
            return seen, self._begin_trial(state, seen, pyramid, seen.particles.poses[:1], matches=False)
        return seen, self._learn(state, seen, trust.confirmed(seen.fit, seen.area, elapsed))

    def _search(
        self, state: GFlowState, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Observation, GFlowState]:
        """Return the state after a picture in which a lost object was searched for by texture and finder."""
        trust, places = state.trust, None
        if self.finder is not None:
            places = self.finder.find(image, state.memories[0].pose, trust.searches)
        seen, found = self._relocate(state, pyramid, places)
        if found:
            return seen, self._hold_texture(state, seen, trust.reacquired(state.elapsed))
        if places is None or not len(places):
            return seen, self._return_to_last(state, seen)
        matches = seen.fit >= CHANCE_ANYWHERE
        best = int(seen.particles.log_weights.argmax())
        chosen = seen.particles.poses[best] if matches else places[0]
        return seen, self._begin_trial(state, seen, pyramid, chosen, matches=matches)

    def _begin_trial(
        self, state: GFlowState, seen: Observation, pyramid: list[Level], pose: Poses, *, matches: bool
    ) -> GFlowState:
        """Return the state in which an object that was detected in a pose, or another, has a new texture."""
        n = len(state.poses)
        begun = Particles(
            pose[np.zeros(n, np.int64)],
            np.full(n, -np.log(n)),
            np.full(n, state.log_weights.argmax()),
            seen.particles.log_evidence,
            np.zeros_like(state.covariance),
        )
        restarted = replace(state, texture=state.texture.reset())
        first = self._observe(restarted, begun, self._visible_texels(begun.poses), pyramid)
        return replace(self._learn(restarted, first, state.trust.start_trial(matches=matches)), fit=seen.fit)

    def _continue_trial(
        self, state: GFlowState, seen: Observation, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Observation, GFlowState]:
        """Return the state after a picture with an object on trial, of which the old texture is the rival."""
        trust = state.trust
        old, found = self._relocate(state, pyramid, seen.particles.poses[:1])
        if found:
            return old, self._hold_texture(state, old, trust.reacquired(state.elapsed))
        confirmed = seen.fit >= trust.least_fit and self._is_confirmed(image, seen)
        tried = trust.continue_trial(seen.fit, state.elapsed, confirmed=confirmed)
        if tried.lost and not tried.trial:
            return seen, self._return_to_last(state, seen)
        known = state if tried.trial else replace(state, memories=())
        return seen, self._learn(known, seen, tried)

    def _is_confirmed(self, image: NDArray[np.uint8], seen: Observation) -> bool:
        """Return whether the finder detects the object in the tracked pose."""
        if self.finder is None:
            return False
        particles = seen.particles
        return self.finder.confirms(image, particles.poses.mean(np.exp(particles.log_weights)))

    def _prior(self, state: GFlowState) -> PosePrior:
        """Return the prior of the poses, `state.elapsed` seconds after the last picture."""
        return PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)

    def _visible_texels(self, poses: Poses) -> Mask:
        """Return the texels that the object does not occlude itself, `(n, n_texels)`."""
        if self.occlusion:
            return self.object.visible(poses)
        return np.ones((len(poses), len(self.object.texels)), np.bool_)

    def _likelihood(self, state: GFlowState, pyramid: list[Level], visible: Mask) -> TextureLikelihood:
        texture = state.texture
        return TextureLikelihood(self.object, pyramid, texture.mean, texture.temperature(self.noise), visible)

    def _weigh_first_frame(self, state: GFlowState, pyramid: list[Level]) -> tuple[Particles, Mask]:
        """Return weights at t = 1 (Table 2, I), and the visible texels of each pose `(n, n_texels)`."""
        likelihood = self._likelihood(state, pyramid, self._visible_texels(state.poses))
        every = np.arange(len(state.poses))
        weights = state.log_weights + log_likelihood(likelihood, state.poses, every, self.effective_pixels)
        evidence = float(log_sum(weights))
        particles = Particles(state.poses, normalised(weights), every, evidence, state.covariance)
        return particles, likelihood.visible

    def _track(
        self,
        state: GFlowState,
        pyramid: list[Level],
        background: OccludedBackground | None,
        points: PointMessage | None,
    ) -> tuple[Particles, Mask]:
        """Move the experts in a continuation or resampling frame (Table 2, II)."""
        visible = self._visible_texels(state.poses) if state.visible is None else state.visible
        likelihood = self._likelihood(state, pyramid, visible)
        prior = self._prior(state)
        more: list[PoseEvidence] = []
        measured = None
        if points is not None and len(self._tracked):
            measured = measured_points(self.model, points.positions, self._tracked)
            more.append(measured)
        if background is not None:
            more.append(Silhouette(self.model, self._edges, background.contrast, self.effective_pixels))
        start = state.poses
        if len(start) > 1 and state.velocity is not None:
            start = disperse(start, state.elapsed * state.velocity, prior.variance, state.random)
        modes = find_modes(likelihood, prior, start, self.effective_pixels, len(pyramid) - 1, more)
        likelihood = replace(likelihood, visible=self._visible_texels(modes.poses))
        background = None if background is None else background.around(modes.poses)

        def density(poses: Poses, owner: NDArray[np.int64]) -> Array:
            nats = log_likelihood(likelihood, poses, owner, self.effective_pixels, background)
            return nats if measured is None else nats - measured.equations(poses, owner)[0]

        if not self._is_resampling_frame(state):
            nats = density(modes.poses, np.arange(len(start)))
            return propagate(state.log_weights, modes, prior, nats), likelihood.visible
        proposal = draw_samples(modes, self.samples, self.covariance_scale, state.random)
        nats = density(proposal.poses, proposal.owner)
        particles = resample(state.log_weights, proposal, prior, nats, state.random)
        return particles, self._visible_texels(particles.poses)

    def _is_resampling_frame(self, state: GFlowState) -> bool:
        """Return whether this is a resampling frame."""
        return self.covariance_scale > 0 and state.since_resampling > self.resample_interval - ROUNDING

    def _relocate(
        self, state: GFlowState, pyramid: list[Level], detected: Poses | None = None
    ) -> tuple[Observation, bool]:
        """Search with the texture in memory all over the picture, and at `detected` poses; return the best
        poses, and whether the object is there.
        """
        n, best = len(state.poses), int(state.log_weights.argmax())
        last, texture = state.memories[0].pose, state.memories[0].texture
        visible = self._visible_texels(last)
        likelihood = self._likelihood(replace(state, texture=texture), pyramid, visible)
        coarsest = pyramid[-1]
        contrast = local_variance(coarsest.image, float(last.sizes[0]) * coarsest.scale) + CONTRAST
        coarse = partial(likelihood.misfit, level=len(pyramid) - 1, contrast=contrast)
        size = pyramid[0].image.shape[0], pyramid[0].image.shape[1]
        places = search_grid(coarse, size, last, self.object.positions(last)[0].mean(axis=0), n)
        if detected is not None and len(detected):
            places = Poses.concatenated([places, align_to_detections(self.model, last, detected[:n])])
        every = np.zeros(len(places), np.int64)
        prior = PosePrior.after(places, self.dynamics, state.size, 1.0)
        likelihood = self._likelihood(replace(state, texture=texture.of(every)), pyramid, visible[every])
        modes = find_modes(likelihood, prior, places, self.effective_pixels, len(pyramid) - 1)
        modes = find_modes(likelihood, prior, modes.poses, self.effective_pixels, 1)
        likelihood = replace(likelihood, visible=self._visible_texels(modes.poses))
        observed, inside = self.object.observe(pyramid, modes.poses, likelihood.visible)
        shares = explained_variance(observed, likelihood.mean, likelihood.visible, inside)
        evidence = state.trust.evidence(shares, _areas(modes.poses, likelihood.visible))
        chosen = np.argsort(-evidence, kind="stable")[:n]
        found = evidence[chosen] >= state.trust.return_fit
        chosen = np.where(found, chosen, chosen[0])
        weights = log_likelihood(likelihood, modes.poses[chosen], chosen, self.effective_pixels)
        particles = Particles(
            modes.poses[chosen],
            normalised(weights),
            np.full(n, best),
            float(log_sum(weights) - np.log(n)),
            modes.covariance[chosen],
        )
        remembering = replace(state, texture=texture.of(every[:n]))
        return self._observe(remembering, particles, likelihood.visible[chosen], pyramid), bool(found[0])

    def _observe(
        self, state: GFlowState, particles: Particles, visible: Mask, pyramid: list[Level]
    ) -> Observation:
        """Sample the picture at the texels of these poses, and measure how well they were predicted."""
        texture = state.texture.of(particles.parents)
        observed, inside = self.object.observe(pyramid, particles.poses, visible)
        fit = 1.0
        if state.frames_seen or self.texture is not None:
            shares = explained_variance(observed, texture.mean, visible, inside)
            fit = float(np.exp(particles.log_weights) @ shares)
        area = float(np.exp(particles.log_weights) @ _areas(particles.poses, visible))
        return Observation(particles, texture, observed, visible, inside, fit, area)

    def _learn(self, state: GFlowState, seen: Observation, trust: Trust) -> GFlowState:
        """Update poses, and textures given the poses (Table 2, III)."""
        particles = seen.particles
        velocity = None
        if state.elapsed and not trust.doubt:
            velocity = particles.poses.changes_from(state.poses[particles.parents]) / state.elapsed
        texture = seen.texture.updated(seen.observed, seen.inside, self.noise, state.elapsed)
        after = replace(
            self._advance(state, seen, trust),
            texture=texture,
            last_reliable=state.last_reliable[particles.parents] if trust.doubt else particles.poses,
            velocity=velocity,
        )
        if trust.doubt or trust.trial:
            return after
        since = state.since_memory + state.elapsed
        if state.memories and since < MEMORY - ROUNDING:
            return replace(after, since_memory=since)
        best = np.array([after.log_weights.argmax()])
        now = Memory(after.poses[best], after.texture.of(best))
        return replace(after, memories=(*state.memories[-1:], now), since_memory=0.0)

    def _hold_texture(self, state: GFlowState, seen: Observation, trust: Trust) -> GFlowState:
        """Update poses only: the picture may not show the object."""
        parents, background = seen.particles.parents, state.background
        return replace(
            self._advance(state, seen, trust),
            texture=seen.texture,
            last_reliable=state.last_reliable[parents],
            background=None if background is None else background.only(parents),
        )

    def _return_to_last(self, state: GFlowState, seen: Observation) -> GFlowState:
        """Return to the last reliable poses and texture: nothing was found, or a trial has failed."""
        texture = state.memories[0].texture.of(np.zeros(len(state.poses), np.int64))
        trust = state.trust.doubted(state.elapsed)
        return replace(
            self._advance(state, seen, replace(trust, searches=trust.searches + 1)),
            poses=state.last_reliable,
            visible=None,
            log_weights=state.log_weights,
            texture=texture,
        )

    def _advance(self, state: GFlowState, seen: Observation, trust: Trust) -> GFlowState:
        """Update what every picture changes."""
        particles = seen.particles
        if state.elapsed:
            probability = state.trust.probability_after(seen.fit, seen.area, state.elapsed)
            trust = replace(trust, probability=probability)
        return replace(
            state,
            poses=particles.poses,
            visible=seen.visible,
            log_weights=particles.log_weights,
            trust=trust,
            elapsed=0.0,
            covariance=particles.covariance,
            velocity=None,
            frames_seen=state.frames_seen + 1,
            log_evidence=particles.log_evidence,
            fit=seen.fit,
            since_resampling=0.0 if self._is_resampling_frame(state) else state.since_resampling,
        )

    def _occluded_background(
        self, state: GFlowState, message: PixelMessage, image: NDArray[np.uint8]
    ) -> OccludedBackground | None:
        """Return the background of this picture near the object; `None` if no chain predicts it."""
        own, trust = state.background, state.background_trust
        if self._whole is None or (own is None and (message.background is None or trust is None)):
            return None
        coverage = self._coverage(state, message.size, margin=state.size)
        near = coverage.region, tone_densities(image, coverage.inner, coverage.region)
        unit = units(image, state.size, local_mean=self.local_mean)
        if own is not None:
            return OccludedBackground(own.contrast(image, *near, unit, state.elapsed), self._whole)
        assert trust is not None
        return OccludedBackground(SharedBackground(message).contrast(trust, *near, unit), self._whole)

    def _update_trust(self, state: GFlowState, message: PixelMessage, elapsed: float) -> GFlowState:
        """Update the trust in the background that another chain predicts."""
        coverage, trust = self._coverage(state, message.size), state.background_trust
        if trust is None:
            trust = first_trust(coverage.hidden, coverage.region, message.size)
        after = SharedBackground(message).trust_after(trust, coverage.hidden, coverage.region, elapsed)
        return replace(state, background_trust=after)

    def _update_own_background(
        self, state: GFlowState, particles: Particles, image: NDArray[np.uint8], elapsed: float
    ) -> GFlowState:
        """Update the experts' backgrounds given the poses (Table 2, III)."""
        size = (image.shape[0], image.shape[1])
        before = state.background or ExpertBackground.unknown(len(state.poses), size)
        coverage = self._coverage(state, size)
        hidden = np.stack([dilate(inside > 0) for inside in coverage.inside]).view(np.uint8)
        after = before.updated(image, particles.parents, hidden, coverage.region, elapsed)
        return replace(state, background=after)

    def _coverage(self, state: GFlowState, size: tuple[int, int], margin: float = 2 * MARGIN) -> Coverage:
        return Coverage.of(self.model, state.poses, state.weights, size, margin)

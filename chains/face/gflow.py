"""G-flow as a chain: pose, deformation and texture of an object by a Rao-Blackwellised particle filter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...inference.smc import copied, log_sum, normalised
from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.morphable_model import MorphableModel, Poses, SurfacePoints
from ...models.face.surface import MeshEdges, SurfaceTexels
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from ...models.points.point_tracks import PointMessage, PointTracks
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
from .pose_terms import PoseDynamics, PoseEvidence, PosePrior, Silhouette, measured_points, predicted_points
from .recovery import CHANCE, ROUNDING, Finder, Trust, apart, brought_to, likely_places
from .texture_filter import TexelNoise, Texture, explained
from .texture_likelihood import Level, TexturedObject, TextureLikelihood, image_pyramid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

__all__ = ["GFlow", "GFlowState"]

N_LEVELS = 3
ONE_AT_MODE: Mapping[str, Any] = {"experts": 1, "spread": 0.0, "recover": False}


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
    # `(height, width)`, from 0 to 1: how well the background is known that another chain predicts
    known: NDArray[np.float32] | None = None
    background: ExpertBackground | None = None  # of every expert, where each has its own
    # `(n_experts, dimension)` per second: last change of each expert's pose, where there was one
    motion: Array | None = None
    # `(n_experts, n_texels)`: texels that the object does not hide itself; `None` where that is not known
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


@short_repr
@dataclass(frozen=True)
class GFlow(PickledByFields):
    """Joint filter of pose, deformation and texture (G-flow paper, Table 2).

    Generative model, with pose u, texture v, background b and picture y, `dt` seconds after the last one:

        p(u_t | u_s) = N(f(u_s), Q(dt)), `PoseDynamics`
        p(v_t | v_s) = N(v_s, Psi_v dt), p(b_t | b_s) = N(b_s, Psi_b dt), texel by texel, pixel by pixel
        p(y_t | u_t, v_t, b_t) = prod_i N(y_t(x_i(u_t)); v_t,i, sigma^2) prod_j N(y_t,j; b_t,j, sigma^2)

    over texels i that are seen at x_i(u_t) and pixels j that the object does not cover. Its message to
    `PixelLabels` is the probability that it covers a pixel, to `PointTracks` Gaussians of its vertices.

    Given a history of poses, an expert, texture and background are Kalman filters. Gauss-Newton finds the
    mode of each expert's belief of the pose on coarse to fine levels. On resampling frames samples about the
    modes, weighed by the full predictive distribution, become the next experts; on the others every expert
    goes on at its mode.

    Departures: the picture is divided by its local mean, which takes light out; sums over pixels are tempered
    to an effective number of independent ones; only the finest level's texture is filtered (see `Texture`);
    experts begin their search apart; the object may be lost, and is then searched for all over the picture. A
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
        Kalman gain of the texels in their steady state at 25 frames a second, from 0 (template) to 1 (optic
        flow), or `"learned"` for each texel. It stands for a noise per second: at another rate the filter has
        another gain.
    temperature
        squared grey levels: noise of a texel's prediction in the steady state, tau.
    effective_pixels
        number of independent pixels that the object's pixels are worth.
    samples
        an expert on resampling frames, lambda.
    spread
        of the samples against Laplace's covariance, alpha; 0 for no resampling frames.
    resample_interval
        s from one resampling frame to the next.
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
        doubt what does not fit, and search for the object all over the picture when it is lost.
    finder
        who is asked where the object is when it is doubted or lost, a `DetectedFace` say. Without one it is
        found again by its texture only.
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
    resample_interval: float = 0.2
    levels: int = N_LEVELS
    local_mean: bool = True
    dynamics: PoseDynamics = field(default_factory=PoseDynamics)
    texture: Texture | None = None
    recover: bool = True
    finder: Finder | None = None
    background: Literal["shared", "experts"] = "shared"
    tracked: tuple[int, ...] = ()
    occlusion: bool = True
    seed: int = 0
    name: str = "gflow"

    ports = (Port(PixelLabels, Cavity.OTHERS), Port(PointTracks, optional=True))

    def __post_init__(self) -> None:
        gain = self.gain
        for names, right, expected in (
            ("experts texels samples radius", lambda value: value >= 1, "1 or more"),
            ("temperature effective_pixels resample_interval", lambda value: value > 0, "more than 0"),
            ("spread", lambda value: value >= 0, "0 or more"),
            ("levels", lambda value: 1 <= value <= N_LEVELS, f"1 to {N_LEVELS}"),
            ("surface", lambda value: value in ("dense", "patches"), "'dense' or 'patches'"),
        ):
            for name in names.split():
                if not right(getattr(self, name)):
                    raise ValueError(f"{name}: got {getattr(self, name)!r}, expected {expected}")
        if gain != "learned" and not (isinstance(gain, int | float) and 0 <= gain <= 1):
            raise ValueError(f"gain: got {gain!r}, expected 0 to 1 or 'learned'")
        numbers, n_vertices = self._tracked, self.model.n_vertices
        if (np.diff(numbers) <= 0).any() or not ((numbers >= 0) & (numbers < n_vertices)).all():
            raise ValueError(
                f"tracked: got {self.tracked}, expected increasing numbers from 0 to {n_vertices - 1}"
            )
        if self.texture is not None:
            got, wanted = self.texture.mean.shape[1:], (self.levels, len(self.object.texels))
            if got != wanted:
                raise ValueError(f"texture: got {got} levels and texels, expected {wanted}")
        if not callable(self.start):
            self._check_start(self.start)

    def _check_start(self, start: Poses) -> None:
        numbers = start.arrays
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

    @cached_property
    def noise(self) -> TexelNoise:
        """Noises of which gain and temperature are the steady state, eq. (33)."""
        return TexelNoise.of_steady_state(0.0 if self.gain == "learned" else self.gain, self.temperature)

    @classmethod
    def optic_flow(cls, model: MorphableModel, start: Poses, **more: Any) -> Self:
        """Constrained optic flow (§4.2): one expert at its mode, its patches as in the last picture."""
        return cls(model, start, **{**ONE_AT_MODE, "gain": 1.0, "surface": "patches", **more})

    @classmethod
    def template(cls, model: MorphableModel, start: Poses, **more: Any) -> Self:
        """Template matching (§4.3): one expert at its mode, whose texture stays as first seen or as given."""
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
        return PixelMessage(layers=coverage.layers(state.known))

    def update(self, state: GFlowState, incoming: Incoming) -> GFlowState:
        """Experts and textures after the picture."""
        return incoming.once(self._updated, state, incoming[PixelLabels], incoming.get(PointTracks))

    def mean_pose(self, state: GFlowState) -> Poses:
        """One pose: the experts' weighted mean."""
        return state.poses.mean(state.weights)

    def vertices(self, state: GFlowState) -> tuple[Array, Array]:
        """Mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px squared of vertices, with depth.

        The covariance is the experts' spread and what each of them leaves open (nothing in the first one).
        """
        model = self.model
        positions, rows = model.positions(state.poses), model.jacobian(state.poses, 3)
        mean = np.einsum("n,nva->va", state.weights, positions)
        off = positions - mean
        spread = np.einsum("n,nva,nvb->vab", state.weights, off, off)
        weighted = rows.reshape(len(rows), -1, rows.shape[3]) @ (
            state.weights[:, None, None] * state.covariance
        )
        return mean, spread + np.einsum("nvap,nvbp->vab", weighted.reshape(rows.shape), rows)

    def points(self, state: GFlowState, points: SurfacePoints) -> Array:
        """`(n, 2)` px: where points of the surface are in the mean pose."""
        projected: Array = points.project(self.model, self.mean_pose(state))[0]
        return projected

    @cached_property
    def _tracked(self) -> NDArray[np.int64]:
        return np.array(self.tracked, np.int64)

    @cached_property
    def _whole(self) -> TexturedObject | None:
        """The whole mesh, as it hides what is behind it."""
        model = self.model
        if not len(model.triangles):
            return None
        return TexturedObject(model, SurfaceTexels.dense(model, COVERING_TEXELS))

    @cached_property
    def _edges(self) -> MeshEdges:
        return MeshEdges.of(self.model.triangles)

    def _updated(self, state: GFlowState, message: PixelMessage, points: PointMessage | None) -> GFlowState:
        """The state after a picture, given the messages of the others to its pixels and points."""
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
            seen = self._seen(state, *self._weighed(state, pyramid), pyramid)
            after = self._learned(state, seen, state.trust)
        elif state.lost and self.recover and not state.trust.trial:
            seen, after = self._sought(state, pyramid, image)
        else:
            background = self._background_of(state, message, image)
            seen = self._seen(state, *self._followed(state, pyramid, background, points), pyramid)
            seen, after = self._judged(state, seen, pyramid, image)
        if self._whole is None or (after.doubted and self.recover):
            return after
        if self.background == "experts":
            return self._with_own_background(after, seen.particles, image, state.elapsed)
        return after if message.background is None else self._with_known(after, message, state.elapsed)

    def _judged(
        self, state: GFlowState, seen: Sight, pyramid: list[Level], image: NDArray[np.uint8]
    ) -> tuple[Sight, GFlowState]:
        """After a picture in which the object was followed; it is searched for if it fits no longer."""
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
        """The state after a picture in which a lost object was searched for by texture and finder."""
        trust, best, places = state.trust, int(state.log_weights.argmax()), None
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

    def _prior(self, state: GFlowState) -> PosePrior:
        """Of the poses now, `state.elapsed` seconds after the last picture."""
        return PosePrior.after(state.poses, self.dynamics, state.size, state.elapsed)

    def _visible(self, poses: Poses) -> Mask:
        """`(n, n_texels)`: texels that the object does not hide itself."""
        if self.occlusion:
            return self.object.visible(poses)
        return np.ones((len(poses), len(self.object.texels)), np.bool_)

    def _likelihood(self, state: GFlowState, pyramid: list[Level], visible: Mask) -> TextureLikelihood:
        texture = state.texture
        return TextureLikelihood(self.object, pyramid, texture.mean, texture.temperature(self.noise), visible)

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
        prior = self._prior(state)
        more: list[PoseEvidence] = []
        known = None
        if points is not None and len(self._tracked):
            known = measured_points(self.model, points.positions, self._tracked)
            more.append(known)
        if background is not None:
            more.append(Silhouette(self.model, self._edges, background.contrast, self.effective_pixels))
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
        places = likely_places(coarse, size, last, self.object.positions(last)[0].mean(axis=0), n)
        if shown is not None and len(shown):
            places = Poses.concatenated([places, brought_to(self.model, last, shown[:n])])
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
        observed, inside = self.object.observe(pyramid, particles.poses, visible)
        fit = 1.0
        if state.frames_seen or self.texture is not None:
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
            background = background.only(parents)
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

    def _background_of(
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
        return Coverage.of(self.model, state.poses, state.weights, size, margin)

"""G-flow as a chain: pose, deformation and texture of an object by a Rao-Blackwellised particle filter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.morphable_model import MorphableModel, Poses, SurfacePoints
from ...models.face.surface import SurfaceTexels
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from ...models.points.point_tracks import PointMessage, PointTracks
from .background import Coverage
from .pose_filter import GFlowState, PoseFilter, vertex_moments
from .pose_terms import PoseDynamics, predicted_points
from .recovery import Finder
from .texture_filter import TexelNoise, Texture
from .texture_likelihood import TexturedObject

__all__ = ["GFlow", "GFlowState"]

Array = NDArray[np.float64]

N_LEVELS = 3
ONE_AT_MODE: Mapping[str, Any] = {"experts": 1, "spread": 0.0, "recover": False}


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
        numbers, n_vertices = np.array(self.tracked, np.int64), self.model.n_vertices
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

    @cached_property
    def noise(self) -> TexelNoise:
        """Noises of which gain and temperature are the steady state, eq. (33)."""
        return TexelNoise.of_steady_state(0.0 if self.gain == "learned" else self.gain, self.temperature)

    @cached_property
    def _filter(self) -> PoseFilter:
        return PoseFilter(
            surface=self.object,
            noise=self.noise,
            dynamics=self.dynamics,
            levels=self.levels,
            local_mean=self.local_mean,
            effective_pixels=self.effective_pixels,
            samples=self.samples,
            spread=self.spread,
            resample_interval=self.resample_interval,
            recover=self.recover,
            occlusion=self.occlusion,
            own_background=self.background == "experts",
            tracked=np.array(self.tracked, np.int64),
            texture_given=self.texture is not None,
            finder=self.finder,
        )

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
            return self._vertices_predicted(state) or feature.uniform()
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
        return incoming.once(self._filter.updated, state, incoming[PixelLabels], incoming.get(PointTracks))

    def _vertices_predicted(self, state: GFlowState) -> PointMessage | None:
        if (state.doubted and self.recover) or not self.tracked or not state.elapsed:
            return None
        chosen = np.array(self.tracked, np.int64)
        return PointMessage(predicted_points(self.model, self._filter.prior(state), state.weights, chosen))

    def mean_pose(self, state: GFlowState) -> Poses:
        """One pose: the experts' weighted mean."""
        return state.poses.mean(state.weights)

    def vertices(self, state: GFlowState) -> tuple[Array, Array]:
        """Mean `(n_vertices, 3)` px and covariance `(n_vertices, 3, 3)` px squared of vertices, with depth.

        The covariance is the experts' spread and what each of them leaves open (nothing in the first one).
        """
        return vertex_moments(self.model, state)

    def points(self, state: GFlowState, points: SurfacePoints) -> Array:
        """`(n, 2)` px: where points of the surface are in the mean pose."""
        projected: Array = points.project(self.model, self.mean_pose(state))[0]
        return projected

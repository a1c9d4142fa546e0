"""Trials of face trackers on generated faces: errors against the truth, and the floor for any filter."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from ...chains.face.experts import find_modes
from ...chains.face.gflow import GFlow, GFlowState
from ...chains.face.pose_terms import PosePrior
from ...chains.face.texture_filter import UNKNOWN_VARIANCE, Texture
from ...chains.face.texture_likelihood import Level, TextureLikelihood, image_pyramid
from ...inference.engine.protocols import Incoming
from ...models.core.frame import Frame
from ...models.face.morphable_model import Poses
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from ..scenes import FaceScene, face

Numbers = NDArray[np.float64]

LOST_SHARE = 0.5
"""Error from which a face counts as not followed, in sizes of the face."""
LOST_SECONDS = 1.0
"""For how long at a stretch, unless it is so in the last frame."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How a tracker did on a sequence.

    Parameters
    ----------
    errors
        `(n_frames,)` px: distance in the picture of the vertices that were found from the true ones, mean
        over all vertices, hidden ones too.
    errors_3d
        `(n_frames,)` px: the same in space, after the mean offset in depth is taken off, which a weak
        perspective does not show.
    nees
        `(n_frames,)`: normalised estimation error squared of the pose per dimension, about 1 where the
        tracker's covariance is honest; NaN where it was not worked out.
    size
        px: of the face.
    dt
        s from frame to frame.
    time
        ms a frame, mean; NaN where it was not measured.
    """

    errors: Numbers
    errors_3d: Numbers
    nees: Numbers
    size: float
    dt: float
    time: float = np.nan

    @classmethod
    def of(cls, scene: FaceScene, vertices: Numbers, nees: Numbers | None = None) -> Self:
        """Of the vertices `(n_frames, n_vertices, 3)` px that were found in a scene."""
        errors = vertex_errors(vertices, scene.model.positions(scene.poses))
        nees = np.full(len(scene), np.nan) if nees is None else nees
        return cls(*errors, nees, float(scene.poses.sizes[0]), scene.dt)

    @property
    def error(self) -> float:
        """px: mean over the frames after the first, whose pose was given."""
        return float(self.errors[1:].mean())

    @property
    def error_3d(self) -> float:
        """px: mean over the frames after the first."""
        return float(self.errors_3d[1:].mean())

    @property
    def mean_nees(self) -> float:
        """Normalised estimation error squared per dimension, mean over the frames after the first."""
        return float(self.nees[1:].mean())

    @property
    def lost(self) -> bool:
        """Whether the error is above half the face's size at the end, or was for more than a second."""
        off = np.concatenate([[False], self.errors > LOST_SHARE * self.size, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:])
        longest = (ends - starts).max(initial=0) * self.dt
        return bool(off[-2] or longest > LOST_SECONDS)


@dataclass(frozen=True, eq=False)
class Clip:
    """A scene whose pictures are drawn once for all trackers."""

    scene: FaceScene
    frames: Sequence[Frame]

    @classmethod
    def of(cls, **settings: Any) -> "Clip":
        """The scene of these settings of `face`."""
        scene = face(**settings)
        return cls(scene, list(scene))


Amendment = Callable[[GFlowState, GFlowState], GFlowState]
"""From the states before and after a frame's picture, the one to go on with."""


def states(chain: GFlow, frames: Sequence[Frame], amended: Amendment | None = None) -> Iterator[GFlowState]:
    """Yield the state after every frame of a chain that is on its own; all frames have a picture."""
    state, pixels = chain.initial(frames[0]), PixelLabels()
    for number, frame in enumerate(frames):
        before = chain.predict(state, frame.time - frames[number - 1].time) if number else state
        state = chain.update(before, Incoming({pixels: PixelMessage(image=frame.image)}))
        if amended is not None:
            state = amended(before, state)
        yield state


@dataclass(frozen=True)
class Tracker:
    """G-flow with settings, for all sequences alike.

    Parameters
    ----------
    name
        for tables.
    settings
        of `GFlow`, beyond model and start.
    kind
        `"own"`: the tracker, as in life. `"true"`: it learns every texture at the true poses. `"oracle"`: the
        floor, texture learned at the true poses and every search started at the true pose.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    kind: Literal["own", "true", "oracle"] = "own"

    def chain(self, scene: FaceScene) -> GFlow:
        """The chain for a scene, started at the true pose."""
        return GFlow(scene.model, scene.poses[0], **{"recover": False, **self.settings})

    def run(self, clip: Clip) -> Evaluation:
        """Follow the face through the clip."""
        chain = self.chain(clip.scene)
        if self.kind == "oracle":
            return floor(clip, replace(chain, experts=1))
        return follow(clip, chain, true_texture=self.kind == "true")


def follow(clip: Clip, chain: GFlow, *, true_texture: bool = False) -> Evaluation:
    """Run a chain over a clip, by itself."""
    scene, nees = clip.scene, np.full(len(clip.scene), np.nan)
    truth = _GroundTruthTexture(chain, clip)

    def with_true_texture(before: GFlowState, after: GFlowState) -> GFlowState:
        index = truth.learned + 1
        if index:
            mean = chain.mean_pose(after)
            nees[index] = normalised_square(scene.poses[index], mean, truth.covariance(before, after, mean))
        return replace(after, texture=truth.learn(index).of(np.zeros(chain.experts, np.int64)))

    amended = with_true_texture if true_texture else None
    found = [chain.mean_pose(state) for state in states(chain, clip.frames, amended)]
    return Evaluation.of(scene, scene.model.positions(Poses.concatenated(found)), nees)


def floor(clip: Clip, chain: GFlow) -> Evaluation:
    """The oracle: texture learned at the true poses, Gauss-Newton started at the true pose of each frame.

    Its prior is what the filter's would be if all had gone well before: a walk from the true pose of the
    previous frame. What remains is noise of the picture, the model's error, and texture that changes.
    """
    scene, truth = clip.scene, _GroundTruthTexture(chain, clip)
    found = [scene.poses[0]]
    nees = np.full(len(scene), np.nan)
    for index in range(1, len(scene)):
        texture = truth.learn(index - 1)
        likelihood = truth.likelihood(index, texture, scene.poses[index])
        prior = PosePrior.after(scene.poses[index - 1], chain.dynamics, truth.size, scene.dt)
        modes = find_modes(
            likelihood, prior, scene.poses[index], chain.effective_pixels, coarsest=chain.levels - 1
        )
        found.append(modes.poses)
        nees[index] = normalised_square(scene.poses[index], modes.poses, np.linalg.inv(modes.precision[0]))
    return Evaluation.of(scene, scene.model.positions(Poses.concatenated(found)), nees)


def normalised_square(truth: Poses, estimate: Poses, covariance: Numbers) -> float:
    """e' C^-1 e per dimension, for the error e of one pose in the tangent space of the estimate."""
    error = truth.changes_from(estimate)[0]
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


@dataclass(eq=False)
class _GroundTruthTexture:
    """Texture of a chain's object learned at the true poses, frame after frame."""

    chain: GFlow
    clip: Clip
    texture: Texture = field(init=False)
    learned: int = field(init=False, default=-1)

    def __post_init__(self) -> None:
        self.texture = self.chain.initial(self.clip.frames[0]).texture.of(np.zeros(1, np.int64))

    @cached_property
    def size(self) -> float:
        """px: of the face at the start, as the chain takes it."""
        return float(self.clip.scene.poses.sizes[0])

    def levels(self, index: int) -> list[Level]:
        """Picture `index` as the chain prepares it."""
        image = self.clip.frames[index].image
        if image is None:
            raise ValueError(f"frames: got none at index {index}, expected pictures of a generated scene")
        chain = self.chain
        return image_pyramid(image, self.size, n_levels=chain.levels, local_mean=chain.local_mean)

    def likelihood(self, index: int, texture: Texture, poses: Poses) -> TextureLikelihood:
        """What picture `index` says, seen with `texture`; visibility is that of `poses`."""
        surface = self.chain.object
        return TextureLikelihood(
            surface,
            self.levels(index),
            texture.mean,
            texture.predicted(self.chain.noise, self.clip.scene.dt).temperature(self.chain.noise),
            surface.visible(poses),
        )

    def learn(self, index: int) -> Texture:
        """The texture after the pictures up to `index`, of which this is the next."""
        if index != self.learned + 1:
            raise ValueError(f"index: got {index}, expected {self.learned + 1}, frames in turn")
        truth = self.clip.scene.poses[index]
        surface = self.chain.object
        observed, seen = surface.observe(self.levels(index), truth, surface.visible(truth))
        noise, elapsed = self.chain.noise, self.clip.scene.dt if index else 0.0
        predicted = self.texture.predicted(noise, elapsed)
        self.texture, self.learned = predicted.updated(observed, seen, noise, elapsed), index
        return self.texture

    def covariance(self, before: GFlowState, after: GFlowState, mean: Poses) -> Numbers:
        """Of the pose: spread of the experts, and Laplace's about each, taken at their mean."""
        chain, index = self.chain, self.learned + 1
        changes = after.poses.changes_from(mean[np.zeros(len(after.poses), np.int64)])
        spread: Numbers = np.einsum("n,ni,nj->ij", after.weights, changes, changes)
        equations = self.likelihood(index, self.texture, mean).equations(0, mean, np.zeros(1, np.int64))
        prior = PosePrior.after(before.poses, chain.dynamics, before.size, before.elapsed)
        precision = chain.effective_pixels / equations.sums[0, 2] * equations.matrices[0]
        return spread + np.linalg.inv(precision + np.diag(prior.precision))


def ground_truth_texture(clip: Clip, chain: GFlow) -> Texture:
    """What a chain's object looks like in the first picture at the true pose, and surely so."""
    texture = _GroundTruthTexture(replace(chain, start=clip.scene.poses[0], texture=None), clip).learn(0)
    steady = np.full_like(texture.variance, chain.noise.steady_variance)
    seen = texture.variance < 0.5 * UNKNOWN_VARIANCE
    return replace(texture, variance=np.where(seen, steady, texture.variance))


def vertex_errors(found: Numbers, truth: Numbers) -> tuple[Numbers, Numbers]:
    """Mean distance of vertices `(n, n_vertices, 3)`, `(n,)` px: in the picture, and in space without the
    mean offset in depth."""
    off = found - truth
    off[..., 2] -= off[..., 2].mean(axis=1, keepdims=True)
    return np.linalg.norm(off[..., :2], axis=2).mean(axis=1), np.linalg.norm(off, axis=2).mean(axis=1)


Measured = Mapping[str, Sequence[Evaluation]]
"""By tracker, one for each seed."""


def on_one_scene(
    trackers: Sequence[Tracker], scenes: Mapping[str, Mapping[str, Any]], name: str, seed: int
) -> dict[str, Evaluation]:
    """Run all trackers on the scene of a name and a seed."""
    clip = Clip.of(**scenes[name], seed=seed)
    return {tracker.name: tracker.run(clip) for tracker in trackers}


def median(evaluations: Sequence[Evaluation], measure: str = "error") -> float:
    """Median over the sequences of a measure of `Evaluation`."""
    return float(np.median([getattr(evaluation, measure) for evaluation in evaluations]))


def quartiles(evaluations: Sequence[Evaluation], measure: str = "error") -> str:
    """Median and quartiles over the sequences, in words."""
    low, middle, high = np.percentile(
        [getattr(evaluation, measure) for evaluation in evaluations], [25, 50, 75]
    )
    return f"{middle:.3g} ({low:.3g}-{high:.3g})"


def n_lost(evaluations: Sequence[Evaluation]) -> int:
    """Sequences on which the face was lost."""
    return sum(evaluation.lost for evaluation in evaluations)


def as_json(found: Measured) -> dict[str, Any]:
    """Every run's errors (px), whether it was lost, and ms a frame, by system and seed."""
    return {
        name: {
            "error": [evaluation.error for evaluation in evaluations],
            "error_3d": [evaluation.error_3d for evaluation in evaluations],
            "lost": [evaluation.lost for evaluation in evaluations],
            "time": [evaluation.time for evaluation in evaluations],
        }
        for name, evaluations in found.items()
    }

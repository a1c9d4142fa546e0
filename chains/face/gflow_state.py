"""The state of G-flow's filter: experts, each a history of poses and the texture that follows from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.face.pose import Poses
from .expert_background import ExpertBackground
from .texture_filter import Texture
from .trust import Trust

Array = NDArray[np.float64]


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
    trust
        what the tracker believes of itself.
    since_resampling
        s since experts were resampled.
    random
        source of all draws.
    covariance
        `(n_experts, dimension, dimension)`: of what each expert believed of its pose, by Laplace's method.
    known
        `(height, width)` float32, from 0 to 1: how well the background of each pixel is known, where another
        chain predicts it; `None` without one.
    background
        of every expert, where each has its own.
    motion
        `(n_experts, dimension)` per second: last change of each expert's pose, where there was one.
    visible
        `(n_experts, n_texels)`: texels that the object in the poses does not hide itself; `None` where that
        has not been found out.
    remembered
        texture of the best expert as it was lost, where an object with a new one is on trial.
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
    trust: Trust
    since_resampling: float
    random: np.random.Generator
    covariance: Array
    known: NDArray[np.float32] | None = None
    background: ExpertBackground | None = None
    motion: Array | None = None
    visible: NDArray[np.bool_] | None = None
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

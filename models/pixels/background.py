"""The background of pixels: what a message says where it is seen, and the empty scene of a whole film."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .kernels import StoredPlanes

Planes = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class EmptyScene:
    """A picture of the empty scene.

    Parameters
    ----------
    shape
        of an image: `(height, width)` px, or `(height, width, 3)`.
    mean
        `(channels, n_pixels)` float32 in the planes of `models.pixels.colour`.
    variance
        `(n_pixels,)` float32, squared grey levels: of the mean.
    noise
        `(n_pixels,)` float32, squared grey levels: of a single observation.
    light
        `(block_rows, block_columns)` float32: that of the first image relative to that of the mean.
    """

    shape: tuple[int, ...]
    mean: Planes
    variance: Planes
    noise: Planes
    light: Planes


@short_repr
@dataclass(frozen=True, eq=False)
class Subtraction:
    """What an image says of a predicted background, each `(n_pixels,)` int8 in steps of 1/20 nat.

    Parameters
    ----------
    log_odds
        log of P(B=1) N(I; ...) over P(B=0) U, within +-6 nats.
    smoothed
        the same with the neighbours' share (see `BackgroundPrediction`).
    """

    log_odds: NDArray[np.int8]
    smoothed: NDArray[np.int8]


class BackgroundFactor(Protocol):
    """What a message says of pixels that show background, whatever model it comes from."""

    @property
    def size(self) -> tuple[int, int]:
        """`(height, width)` px."""
        ...

    @property
    def colours(self) -> StoredPlanes:
        """What the scene usually shows."""
        ...

    @property
    def prior(self) -> float:
        """P(B=1), that a pixel shows background."""
        ...

    def compare(self, image: NDArray[np.uint8], /) -> Subtraction:
        """Compare an image with the prediction; the same image only once."""
        ...

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None, /) -> float:
        """Log probability of the image (nats).

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0.
        """
        ...

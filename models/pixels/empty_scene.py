"""A picture of the empty scene, with its uncertainty and its light."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .gaussian import fixed_point

State = TypeVar("State")
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

    def known_to(self, state: State) -> State:
        """The state of a background, a dataclass with these fields, that knows the scene."""
        pixels = fixed_point(self.mean, self.variance, self.noise)
        return replace(state, **pixels._asdict(), light=self.light)  # type: ignore[type-var]

"""The empty scene from a sample of frames: what every pixel shows most often, whoever passes in front of it.

Where things move, the scene is what they all leave behind: of the colours that a pixel shows, the one with
the highest density over the frames (the mode), also where it is seen in less than half of them. Colours of
passers-by differ, that of the scene comes back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.threads import over_bands
from .kernels.gaussian import HIGHEST_NOISE, HIGHEST_VARIANCE, LOWEST_NOISE, LOWEST_VARIANCE
from .kernels.modes import find_modes
from .light import LightField

Image = NDArray[np.uint8]
State = TypeVar("State")
Planes = NDArray[np.float32]

PRIOR_FRAMES = 8.0
"""How many frames what is known of the noise beforehand counts for."""


@short_repr
@dataclass(frozen=True, eq=False)
class EmptyScene:
    """A picture of the empty scene.

    Parameters
    ----------
    shape
        of an image: `(height, width)` px, or `(height, width, 3)`.
    mean
        `(channels, n_pixels)` float32 in the planes of `colour`.
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
        return replace(  # type: ignore[type-var]
            state, mean=self.mean, variance=self.variance, noise=self.noise, light=self.light
        )


def empty_scene(images: Sequence[Image], light: Sequence[LightField], noise: float) -> EmptyScene:
    """Find the empty scene.

    Parameters
    ----------
    images
        uint8 `(height, width[, 3])`, all alike; one at least.
    light
        of every image, relative to the light of the mean; one for all of them where it does not change.
    noise
        squared grey levels of a single observation, as it is expected.
    """
    light = light if len(light) == len(images) else [light[0]] * len(images)
    height, width = images[0].shape[:2]
    channels = 1 if images[0].ndim == 2 else 3
    pixels = np.stack([image.reshape(-1) for image in images])
    mean = np.empty((channels, height * width), np.float32)
    scatter, support = (np.empty(height * width, np.float32) for _ in range(2))
    rows = np.stack([field.along_rows.rows for field in light])
    positions = light[0].along_rows.positions
    # colours within two standard deviations of each other in all channels may be the same
    bandwidth = np.float32(8 * channels * noise)

    def find(first: int, end: int) -> None:
        find_modes(first, end, pixels, rows, positions, bandwidth, channels, mean, scatter, support)

    over_bands(find, height)
    seen = (support * scatter + PRIOR_FRAMES * noise) / (support + PRIOR_FRAMES)
    observed = np.clip(seen, LOWEST_NOISE, HIGHEST_NOISE).astype(np.float32)
    variance = np.clip(observed / support, LOWEST_VARIANCE, HIGHEST_VARIANCE)
    return EmptyScene(images[0].shape, mean, variance.astype(np.float32), observed, light[0].blocks)

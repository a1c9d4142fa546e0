"""A background map an expert: the background of G-flow eq. (2) and (4) in its exact form.

Each expert has its own idea of which pixels it has seen the background in, so each has its own map. Their
Kalman filter is that of the texels, eq. (10) to (12), with a gain of 0 where the object hides the pixel.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.pictures import grey_of
from ...models.core.short_repr import short_repr
from ...models.face.outline import Box
from ...models.numerics.threads import over_bands
from .background_contrast import BackgroundContrast
from .kernels import background_maps as background_map_kernels

Map = NDArray[np.float32]

UNKNOWN_VARIANCE = 60.0**2
"""Squared grey levels: of a pixel whose background has never been seen."""

NOISE = 20.0
"""Squared grey levels of a picture at a pixel, sigma_w^2."""

WANDERING = 25.0
"""Squared grey levels per second by which a pixel's background may change, Psi_b."""

LEAST_RATIO = -9.0
"""Nats: no pixel speaks louder against the background, whatever has come before it."""


@short_repr
@dataclass(frozen=True, eq=False)
class ExpertBackground:
    """What each expert believes of the background, a Gaussian a pixel.

    Parameters
    ----------
    mean
        `(n_experts, height, width)` float32, raw grey levels.
    variance
        `(n_experts, height, width)` float32, after the last picture.
    """

    mean: Map
    variance: Map

    @classmethod
    def unknown(cls, n_experts: int, size: tuple[int, int]) -> Self:
        """Of a picture of `size` `(height, width)` of which nothing has been seen."""
        shape = (n_experts, *size)
        return cls(np.zeros(shape, np.float32), np.full(shape, UNKNOWN_VARIANCE, np.float32))

    def of(self, parents: NDArray[np.int64]) -> Self:
        """Backgrounds of the children of `parents`."""
        return replace(self, mean=self.mean[parents], variance=self.variance[parents])

    def contrast(
        self, image: NDArray[np.uint8], box: Box, tones: Map, unit: Map, elapsed: float
    ) -> BackgroundContrast:
        """As poses within the box are judged by it, `elapsed` s after the last picture.

        Trust in a pixel is the share of the first variance that is gone: what was never seen says nothing.
        """
        grey, n = grey_of(image), len(self.mean)
        ratio, trust = np.empty((2, n, box.height, box.width), np.float32)
        everywhere = np.empty(n)

        def work(a: int, b: int) -> None:
            background_map_kernels.compare_with_maps(
                grey, self.mean[a:b], self.variance[a:b], box, _noise(elapsed), np.float32(LEAST_RATIO),
                ratio[a:b], trust[a:b], everywhere[a:b],
            )  # fmt: skip

        over_bands(work, n)
        return BackgroundContrast.of(box, ratio, trust, tones, unit, everywhere)

    def updated(
        self,
        image: NDArray[np.uint8],
        parents: NDArray[np.int64],
        hidden: NDArray[np.uint8],
        box: Box,
        elapsed: float,
    ) -> Self:
        """Backgrounds after a picture, `elapsed` s after the last one, of the children of `parents`.

        Pixels that are `hidden` `(n_experts, height, width)` in the box keep their mean.
        """
        grey, n = grey_of(image), len(parents)
        mean, variance = np.empty((2, n, *grey.shape), np.float32)

        def work(a: int, b: int) -> None:
            background_map_kernels.update_maps(
                grey,
                self.mean,
                self.variance,
                parents[a:b],
                hidden[a:b],
                box,
                _noise(elapsed),
                mean[a:b],
                variance[a:b],
            )

        over_bands(work, n)
        return replace(self, mean=mean, variance=variance)


def _noise(elapsed: float) -> background_map_kernels.MapNoise:
    change = WANDERING * elapsed
    return background_map_kernels.MapNoise(
        np.float32(NOISE), np.float32(change), np.float32(UNKNOWN_VARIANCE)
    )

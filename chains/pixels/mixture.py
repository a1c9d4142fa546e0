"""A mixture of Gaussians per pixel as a prediction of the empty scene, and what an image says of it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.numerics.threads import over_bands
from ...models.pixels import colour
from ...models.pixels.gaussian import Subtraction, log_prior_odds, smooth
from ...models.pixels.kernels.gaussian import StoredPlanes
from .kernels.mixture import Mixture, learn_mixture, mixture_log_evidence, subtract_mixture

Planes = NDArray[np.float32]

REACH = {1: 6.25, 3: 10.9}
"""By number of channels: squared distance over variance within which 98.8 % of what a component shows lies.

It is 2.5 standard deviations of one channel, as in the paper.
"""


@short_repr
@dataclass(frozen=True, eq=False)
class MixturePrediction:
    """Prediction of every pixel's background value: the first components of its mixture, normalised.

    Stauffer and Grimson, "Adaptive background mixture models for real-time tracking", CVPR 1999.

    Parameters
    ----------
    size
        `(height, width)` px.
    mixture
        of all that was seen.
    prior
        P(B=1), that a pixel shows background.
    share
        as many of the first components are background as it takes for their weight to exceed this (their T).
    pooling
        weight of what the 5 x 5 pixels around a pixel show in its own log odds.
    """

    size: tuple[int, int]
    mixture: Mixture
    prior: float
    share: float
    pooling: float
    _compared: dict[int, tuple[NDArray[np.uint8], Planes, Subtraction]] = field(default_factory=dict)

    @property
    def colours(self) -> StoredPlanes:
        """Means of each pixel's most probable component."""
        return StoredPlanes(self.mixture.means[0].reshape(-1, *self.size), np.float32(1))

    def compare(self, image: NDArray[np.uint8]) -> Subtraction:
        """Compare an image with the prediction; the same image only once."""
        return self._comparison(image)[2]

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None) -> float:
        """Log probability of the image, summed over its pixels as if they were independent (nats).

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0.
        """
        planes = self._comparison(image)[1]
        total = mixture_log_evidence(
            self.size[1], planes, self.mixture, np.float32(self.share),
            np.float32(log_prior_odds(self.prior, len(planes))),
            np.zeros(1, np.float32) if pixel_shift is None else pixel_shift,
        )  # fmt: skip
        uniform = np.log1p(-self.prior) - len(planes) * np.log(256.0)
        return float(total + uniform * self.size[0] * self.size[1])

    def update(
        self, image: NDArray[np.uint8], rates: Planes, least_rate: float, first_variance: float
    ) -> Mixture:
        """The mixture after an image.

        With weight w, mean m and variance v of the component that is shown, and rate a: w moves to
        (1 - a) w + a, the other weights to (1 - a) times theirs; with g = a / w the mean moves to
        m + g (I - m) and the variance to (1 - g) v + g (I - m)^2, in which m is the new one. (The paper's g
        is a N(I; m, v), by which a mean hardly moves; a / w makes it an average of what was seen.)

        Parameters
        ----------
        image
            uint8 `(height, width[, 3])`.
        rates
            `(n_pixels,)` float32, a of every pixel.
        least_rate
            at a pixel whose rate does not exceed it, no new component begins.
        first_variance
            squared grey levels, of a new component.
        """
        height, width = self.size
        planes = self._comparison(image)[1]
        after = Mixture(*(np.empty(before.shape, np.float32) for before in self.mixture))
        reach = np.float32(REACH[len(planes)])

        def learn(first: int, end: int) -> None:
            learn_mixture(
                first, end, width, planes, rates, np.float32(least_rate), np.float32(first_variance), reach,
                self.mixture, after,
            )  # fmt: skip

        over_bands(learn, height)
        return after

    def _comparison(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Planes, Subtraction]:
        """The image, its planes, and what they say."""
        if id(image) not in self._compared:
            planes = colour.to_planes(image)
            self._compared[id(image)] = image, planes, self._subtract(planes)
        return self._compared[id(image)]

    def _subtract(self, planes: Planes) -> Subtraction:
        height, width = self.size
        log_prior = np.float32(log_prior_odds(self.prior, len(planes)))
        log_odds = np.empty((height * width,), np.int8)

        def subtract(first: int, end: int) -> None:
            subtract_mixture(
                first, end, width, planes, self.mixture, np.float32(self.share), log_prior, log_odds
            )

        over_bands(subtract, height)
        return Subtraction(log_odds, smooth(log_odds, self.size, self.prior, self.pooling))

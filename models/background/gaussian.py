"""A picture of the empty scene as a prediction of pixels, and what an image says of it.

Per pixel the scene shows `light * mean` plus noise where nothing stands in front of it, and anything where
something does. Comparing an image with that prediction is the one pass over all pixels of a frame; its
result (log odds of "background", and the mean and variances that would follow) is kept with the prediction.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.threads import over_bands
from . import colour
from .kernels.gaussian import (
    HIGHEST_VARIANCE,
    KNOWN,
    ODDS_STEPS,
    Gaussians,
    PixelModel,
    SecondColours,
    log_evidence,
    recall,
    smooth_log_odds,
    subtract_colour,
    subtract_grey,
)
from .kernels.sway import LEAST_RATE, Sway, recall_moved
from .light import LightField

Planes = NDArray[np.float32]


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
    def mean(self) -> Planes:
        """`(channels, n_pixels)` float32, the scene's usual colours in the planes of `colour`."""
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


@short_repr
@dataclass(frozen=True, eq=False)
class BackgroundPrediction:
    """Prediction of every pixel's background value: N(L; light * mean, light^2 * (variance + drift) + noise).

    Parameters
    ----------
    size
        `(height, width)` px.
    pixels
        before this frame; the mean in the planes of `colour`.
    light
        of this frame.
    prior
        P(B=1), that a pixel shows background.
    drift
        squared grey levels added to the variance since the last observation.
    noise_share
        share by which the noise follows what is seen, 0 to keep it fixed.
    first_variance
        squared grey levels, of a value seen once.
    unknown_variance
        squared grey levels, of a value that others take for an object's (see `update_behind`); 0 for none.
    pooling
        weight of what the 5 x 5 pixels around a pixel show in its own log odds: neighbours mostly share their
        label, but are not independent observations. 0 makes every pixel decide for itself.
    second
        second colour of every pixel: once known, what is within `tolerance` (squared grey levels, four times
        the variance of all channels) of it is background too.
    sway
        how often pixels show what is beside them.
    """

    size: tuple[int, int]
    pixels: Gaussians
    light: LightField
    prior: float
    drift: float
    noise_share: float
    first_variance: float
    unknown_variance: float
    pooling: float
    second: SecondColours
    tolerance: float
    sway: Sway
    _compared: dict[int, tuple[NDArray[np.uint8], Subtraction]] = field(default_factory=dict)
    _updates: dict[int, Gaussians] = field(default_factory=dict)

    @property
    def mean(self) -> Planes:
        """`(channels, n_pixels)` float32."""
        return self.pixels.mean

    @property
    def channels(self) -> int:
        """1 for grey, 3 for colour."""
        return len(self.pixels.mean)

    @cached_property
    def model(self) -> PixelModel:
        """What loops need to know beside the pixels."""
        numbers = (
            log_prior_odds(self.prior, self.channels),
            np.log(self.prior) - np.log1p(-self.prior),
            self.drift,
            self.noise_share,
            self.first_variance,
            self.unknown_variance,
        )
        return PixelModel(*map(np.float32, numbers))

    def compare(self, image: NDArray[np.uint8]) -> Subtraction:
        """Compare an image with the prediction; the same image only once."""
        known = self._compared.get(id(image))
        if known is None:
            subtraction, update = self._subtract(image)
            known = self._compared[id(image)] = (image, subtraction)
            self._updates[id(image)] = update
        return known[1]

    def update(self, image: NDArray[np.uint8]) -> Gaussians:
        """The background after the image. The arrays are the caller's to change: they are forgotten here."""
        self.compare(image)
        return self._updates.pop(id(image), None) or self._subtract(image)[1]

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None) -> float:
        """Log probability of the image, summed over its pixels as if they were independent (nats).

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0. This is the integral
        of the prediction as it stands: second colours and neighbours, which only help to decide labels, are
        left out.
        """
        shift = np.zeros(1, np.float32) if pixel_shift is None else pixel_shift
        flat = np.ascontiguousarray(image).reshape(-1)
        total = log_evidence(flat, self.pixels, self.light.along_rows, self.model, shift)
        uniform = np.log1p(-self.prior) - self.channels * np.log(256.0)
        return float(total + uniform * self.size[0] * self.size[1])

    def _subtract(self, image: NDArray[np.uint8]) -> tuple[Subtraction, Gaussians]:
        height, width = self.size
        after = Gaussians(*(np.empty(before.shape, np.float32) for before in self.pixels))
        log_odds = np.empty((height * width,), np.int8)
        flat = np.ascontiguousarray(image).reshape(-1)
        kernel = subtract_colour if self.channels == 3 else subtract_grey
        light, model, tolerance = self.light.along_rows, self.model, np.float32(self.tolerance)
        sways = self.sway.rates.max() >= LEAST_RATE

        def subtract(first: int, end: int) -> None:
            kernel(first, end, flat, self.pixels, light, model, after, log_odds)
            recall(first * width, end * width, flat, self.second, tolerance, model, log_odds)
            if sways:
                recall_moved(first, end, flat, self.pixels, light, model, self.sway, log_odds)

        over_bands(subtract, height)
        smoothed = smooth(log_odds, self.size, self.prior, self.pooling)
        if self.pixels.variance.max() > HIGHEST_VARIANCE:
            # neighbours tell nothing of a value that nobody knows
            smoothed[self.pixels.variance > HIGHEST_VARIANCE] = np.int8(model.label_odds * ODDS_STEPS)
        return Subtraction(log_odds, smoothed), after


def log_prior_odds(prior: float, channels: int) -> float:
    """Log of P(B=1) over P(B=0) times the uniform density, in the units of the planes.

    The factor of 2 pi in the density of a Gaussian is part of it.
    """
    odds = np.log(prior) - np.log1p(-prior)
    return float(
        odds + channels * (np.log(256.0) - 0.5 * np.log(2 * np.pi)) + np.log(colour.VOLUME[channels])
    )


def smooth(log_odds: NDArray[np.int8], size: tuple[int, int], prior: float, share: float) -> NDArray[np.int8]:
    """Give log odds with `share` of what the 5 x 5 pixels around show, both `(n_pixels,)` int8."""
    height, width = size
    smoothed: NDArray[np.int8] = np.empty(log_odds.shape, np.int8)
    prior_steps = np.int16(round(ODDS_STEPS * float(np.log(prior) - np.log1p(-prior))))
    over_bands(
        lambda first, end: smooth_log_odds(
            first, end, height, width, log_odds, prior_steps, np.float32(share), smoothed
        ),
        height,
    )
    return smoothed


def keep_old_colours(
    old: Gaussians, light: LightField, revealed: NDArray[np.bool_], second: SecondColours
) -> None:
    """What a pixel showed before something else was `revealed` `(n_pixels,)` there stays its second colour.

    It is known at once, so that it is background again at once if the verdict was wrong; and it wears off as
    any second colour does once something else lasts there.
    """
    (pixels,) = np.nonzero(revealed)
    if not len(pixels):
        return
    channels, (row, column) = len(old.mean), np.divmod(pixels, light.size[1])
    rows, position = light.along_rows
    above = position[row].astype(np.intp)
    glow = rows[above, column] + (position[row] - above) * (rows[above + 1, column] - rows[above, column])
    shown = np.clip(np.rint(colour.to_pixels(channels) @ (glow * old.mean[:, pixels])), 0, 255)
    second.colours.reshape(-1, channels)[pixels] = shown.T
    second.seen[pixels] = KNOWN

"""A picture of the empty scene under a frame's light as a prediction of pixels, and what an image says of it.

Per pixel the scene shows `light * mean` plus noise where nothing stands in front of it, and anything where
something does. The light is a smooth field over the picture, followed where the empty scene can be seen.
Comparing an image with the prediction is the one pass over all pixels of a frame; its result (log odds of
"background", and the mean and variances that would follow) is kept with the prediction.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.numerics.threads import over_bands
from ...models.pixels import colour
from ...models.pixels.background import Subtraction
from ...models.pixels.kernels import ODDS_STEPS, StoredPlanes
from .kernels.gaussian import (
    COARSE_STEPS,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    MEAN_STEPS,
    NOISE_STEPS,
    ROUNDING,
    ROUNDING_PERIOD,
    VARIANCE_STEPS,
    Certain,
    Gaussians,
    Light,
    PixelModel,
    log_evidence,
    smooth_log_odds,
)
from .kernels.light import Following, follow, interpolate, light_ratios, share_covered
from .kernels.second_colours import SecondColours
from .kernels.subtraction import subtract
from .kernels.sway import Sway

Planes = NDArray[np.float32]

CERTAIN = 6.0
"""Nats: the bound of the log odds of a pixel by itself."""

CHORDS = (LOWEST_NOISE, 100.0, 1000.0)
"""Squared grey levels of variance, between which the bound of `Certain` is made of straight lines."""

FASTEST_LIGHT = 1.25
"""Log of the most that light changes in a second; a lamp that is switched takes a few frames."""

STEADY_LIGHT, LIGHT_TIME = 0.02, 0.2
"""Log of a change below which it may be noise, and s, the time constant with which it is followed then."""

UNSEEN = 1e-5
"""Probability at most that a block all behind objects shows the empty scene, before its texture is looked at.

What it leaks must be small against `OWN_WEIGHT`, for an object may stay for as long as it likes."""

DARKEST, BRIGHTEST = 0.1, 10.0
"""Light relative to that of the remembered picture; beyond there is nothing to be seen."""

LEAST_AGREEMENT = 0.3
"""Share of a block's samples that must change by one factor; else something stands there that is new."""

SAME_LIGHT = 0.05
"""Log of a ratio within which a block agrees with the light that its neighbourhood has."""

HIDDEN_TIME = 1.0
"""s in which the light of a block that is not seen, or disagrees, becomes that of the blocks around it."""

SAMPLED = 4
"""px between those of which the covered share of a block is counted."""

WINDOW_WEIGHT, OWN_WEIGHT = 1.0, 0.05
"""In blocks: what the next wider window counts in a window, and what all of them count in a block itself."""


@short_repr
@dataclass(frozen=True, eq=False)
class LightField:
    """How bright the scene is lit now, relative to the picture that is remembered, on a grid of blocks.

    Parameters
    ----------
    blocks
        `(block_rows, block_columns)` float32, 1 where the light is as it was.
    size
        `(height, width)` px of the picture.
    """

    blocks: Planes
    size: tuple[int, int]

    @cached_property
    def along_rows(self) -> Light:
        """The field along x at the blocks' centres, and where between them each row lies.

        There is one more block on every side, as the slope of the logarithm goes on.
        """
        left, share = _neighbours(self.size[1], self.blocks.shape[1])
        rows: Planes = np.empty((len(self.blocks) + 2, self.size[1]), np.float32)
        interpolate(self.blocks, left, share, DARKEST, BRIGHTEST, rows)
        return Light(rows, _positions(self.size[0], self.blocks.shape[0]))


@lru_cache(maxsize=16)
def _positions(n_pixels: int, n_blocks: int) -> Planes:
    """Where the centres of pixels lie between those of blocks, `(n_pixels,)`; block 0 is before the first."""
    return ((np.arange(n_pixels) + 0.5) * n_blocks / n_pixels + 0.5).astype(np.float32)


@lru_cache(maxsize=16)
def _neighbours(n_pixels: int, n_blocks: int) -> tuple[NDArray[np.intp], Planes]:
    """The block left of every pixel, and the share of the one right of it."""
    position = _positions(n_pixels, n_blocks)
    left = position.astype(np.intp)
    return left, (position - left).astype(np.float32)


def followed(
    before: LightField, image: NDArray[np.uint8], mean: NDArray[np.int16], covered: Planes, elapsed: float
) -> LightField:
    """Light of a frame: smooth, and moved only by what most of a neighbourhood agrees on.

    Objects change the ratio of seen to predicted brightness too. A block behind known ones speaks only if it
    shows the scene's texture nevertheless; else it takes the change of those around it, over windows as wide
    as it needs, and nothing from itself. A new object would have to fill most of three by three blocks with
    one and the same factor.

    Parameters
    ----------
    before
        of the frame before.
    image
        uint8 `(height, width[, 3])`.
    mean
        `(channels, n_pixels)` int16, the empty scene (see `Gaussians`).
    covered
        `(block_rows, block_columns)` share of the block behind known objects.
    elapsed
        s since the frame before.
    """
    ratios, agreement, texture = (np.empty_like(before.blocks) for _ in range(3))
    flat = np.ascontiguousarray(image).reshape(-1)
    light = before.along_rows  # made before the threads ask for it

    def work(first: int, end: int) -> None:
        light_ratios(first, end, flat, mean, light, ratios, agreement, texture)

    over_bands(work, len(before.blocks))
    rule = Following(
        FASTEST_LIGHT * elapsed, STEADY_LIGHT, -math.expm1(-elapsed / LIGHT_TIME),
        -math.expm1(-elapsed / HIDDEN_TIME), SAME_LIGHT, LEAST_AGREEMENT, UNSEEN, WINDOW_WEIGHT, OWN_WEIGHT,
        DARKEST, BRIGHTEST,
    )  # fmt: skip
    blocks: Planes = np.empty_like(before.blocks)
    follow(before.blocks, ratios, agreement, texture, covered, rule, blocks)
    return LightField(blocks, before.size)


def light_grid(height: int, width: int) -> tuple[int, int]:
    """Blocks of light over a picture: 24 along its longer side, at least two each way."""
    block = max(height, width) / 24
    return max(round(height / block), 2), max(round(width / block), 2)


def share_of_blocks(covered: NDArray[np.uint8], grid: tuple[int, ...]) -> Planes:
    """Share of every block of light that is covered: `(height, width)` uint8, 255 where it is."""
    shares: Planes = np.zeros(grid, np.float32)
    share_covered(
        covered, min(SAMPLED, *(max(n // m, 1) for n, m in zip(covered.shape, grid, strict=True))), shares
    )
    return shares


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
    frames
        seen before this one.
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
    frames: int
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
    def colours(self) -> StoredPlanes:
        """Means of all pixels."""
        return stored_planes(self.pixels.mean, self.size)

    @cached_property
    def model(self) -> PixelModel:
        """What loops need to know beside the pixels."""
        numbers = (
            log_prior_odds(self.prior, len(self.pixels.mean)),
            np.log(self.prior) - np.log1p(-self.prior),
            self.drift,
            self.noise_share,
            self.first_variance,
            self.unknown_variance,
        )
        return PixelModel(*map(np.float32, numbers))

    @cached_property
    def rounding(self) -> Planes:
        """What the update's numbers are rounded by: `(width + ROUNDING_PERIOD,)` float32, with `ROUNDING`.

        Over the frames each pixel has all numbers from 0 to 1 equally often, evenly mixed (the additive
        recurrence of Roberts' plastic number), and so have neighbours in each frame.
        """
        along = np.arange(self.size[1] + ROUNDING_PERIOD) * 0.7548776662466927
        steps = np.floor((along + self.frames * 0.5698402909980532) % 1 * 128)  # as float32 beside `ROUNDING`
        rounding: Planes = (steps / 128 + ROUNDING).astype(np.float32)
        return rounding

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
        uniform = np.log1p(-self.prior) - len(self.pixels.mean) * np.log(256.0)
        return float(total + uniform * self.size[0] * self.size[1])

    def _subtract(self, image: NDArray[np.uint8]) -> tuple[Subtraction, Gaussians]:
        mean, variance, noise = self.pixels
        after = Gaussians(np.empty_like(mean), np.empty_like(variance), np.empty_like(noise))
        log_odds, smoothed = np.empty((2, self.size[0] * self.size[1]), np.int8)
        flat = np.ascontiguousarray(image).reshape(-1)
        light, certain = self.light.along_rows, certain_model(self.model, len(mean))
        prior, rounding = _prior_steps(self.prior), self.rounding

        def work(first: int, end: int) -> None:
            subtract(
                first, end, flat, self.pixels, light, self.model, certain, rounding, self.second,
                np.float32(self.tolerance), self.sway, prior, np.float32(self.pooling), after, log_odds,
                smoothed,
            )  # fmt: skip

        over_bands(work, self.size[0])
        return Subtraction(log_odds, smoothed), after


def fixed_point(mean: Planes, variance: Planes, noise: Planes) -> Gaussians:
    """The nearest numbers of 16 bits.

    Parameters
    ----------
    mean
        `(channels, n_pixels)` grey levels.
    variance, noise
        `(n_pixels,)` squared grey levels.
    """
    beyond = HIGHEST_VARIANCE * (VARIANCE_STEPS - COARSE_STEPS)
    variances = np.minimum(variance * VARIANCE_STEPS, variance * COARSE_STEPS + beyond)
    return Gaussians(
        np.rint(mean * MEAN_STEPS).clip(-32768, 32767).astype(np.int16),
        np.rint(variances).clip(0, 65535).astype(np.uint16),
        np.rint(noise * NOISE_STEPS).clip(0, 65535).astype(np.uint16),
    )


def stored_planes(mean: NDArray[np.int16], size: tuple[int, int]) -> StoredPlanes:
    """Means `(channels, n_pixels)` of 16 bits as planes of a picture of this size."""
    return StoredPlanes(mean.reshape(-1, *size), np.float32(1 / MEAN_STEPS))


def certain_model(model: PixelModel, channels: int) -> Certain:
    """What pixels need of the model that show background for sure."""
    most = 2 * (float(model.log_prior_odds) - CERTAIN)
    bounds = [total * (most - channels * math.log(total)) for total in CHORDS]
    slopes = [(bounds[k + 1] - bounds[k]) / (CHORDS[k + 1] - CHORDS[k]) for k in (0, 1)]
    lines = [(VARIANCE_STEPS / channels * (bounds[1] - a * CHORDS[1]), a / channels) for a in slopes]
    weight = 1 / (1 + math.exp(-CERTAIN))
    numbers = (
        *lines[0], *lines[1], CHORDS[2] * VARIANCE_STEPS, model.drift * VARIANCE_STEPS,
        weight, weight * (1 - weight), weight * MEAN_STEPS,
        weight * model.noise_share * NOISE_STEPS / VARIANCE_STEPS,
    )  # fmt: skip
    return Certain(*(np.float32(number) for number in numbers))


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
    over_bands(
        lambda first, end: smooth_log_odds(
            first, end, height, width, log_odds, _prior_steps(prior), np.float32(share), smoothed
        ),
        height,
    )
    return smoothed


def _prior_steps(prior: float) -> np.int16:
    return np.int16(round(ODDS_STEPS * float(np.log(prior) - np.log1p(-prior))))

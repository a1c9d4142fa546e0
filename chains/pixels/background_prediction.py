"""A picture of the empty scene under a frame's light as a prediction of pixels, and what an image says of it.

Per pixel the scene shows `light * mean` plus noise where nothing stands in front of it, and anything where
something does. The light is a smooth field over the picture, followed where the empty scene can be seen.
Comparing an image with the prediction is the one pass over all pixels of a frame; its result (log odds of
"background", and the mean and variances that would follow) is kept with the prediction.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.numerics.compiled import compiled, inlined
from ...models.numerics.threads import over_bands
from ...models.pixels import colour
from ...models.pixels.background import ODDS_STEPS, SPAN, StoredPlanes, Subtraction, foreground_spans
from ...models.pixels.colour import planes_of
from .gaussians import (
    CERTAIN,
    COARSE_STEPS,
    HIGHEST_NOISE,
    HIGHEST_VARIANCE,
    LOWEST_NOISE,
    LOWEST_VARIANCE,
    MEAN_STEPS,
    NOISE_STEPS,
    ROUNDING,
    ROUNDING_PERIOD,
    SURE,
    VARIANCE_STEPS,
    FastPathThresholds,
    Gaussians,
    PixelModel,
    is_sure,
    light_beside,
    log_evidence,
    mean_of,
    mean_steps,
    noise_of,
    noise_steps,
    posterior,
    rounding_along,
    smooth_log_odds,
    variance_of,
    variance_steps,
    whole_steps,
)
from .light import LightField
from .mirror import EVERY, find_axes, recall_mirrored
from .second_colours import SecondColours, recall
from .shade import Shade, recall_shaded
from .sleeping_blocks import BLOCK_COLUMNS, BLOCK_ROWS, Flags, find_awake, sleep_through
from .sway import LEAST_RATE, Sway, recall_moved

_f4, _i4 = np.float32, np.int32
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)
_SPAN = np.uint64(SPAN)
_ODDS, _PLANES, _VARIANCES, _NOISES = (np.uint64(number * SPAN) for number in (1, 2, 5, 6))

_UNSURE = np.int8(-128)  # where the log odds are not known yet

_HIGHEST = HIGHEST_VARIANCE * VARIANCE_STEPS

ASLEEP = 0.2  # of what it costs to compare and to smooth a block that is awake, what one asleep costs

HALO = 2  # rows beyond a band that its smoothed log odds depend on


@inlined
def fast_update(distance, light, variance, noise, fast):
    """Return what `posterior` does where the log odds are at their bound, without logarithm and exponential.

    Everything is in the steps of the numbers that are stored: `variance`, the variance with the drift, and
    `distance` per channel in those of variances. Gives the step of the mean in theirs per grey level,
    variance and noise to be stored, and whether the log odds are at their bound indeed.
    """
    over = light * variance
    total = light * over + _f4(VARIANCE_STEPS / NOISE_STEPS) * noise
    gain = over / total
    narrower = variance - gain * (fast.weight * over - fast.weights * gain * distance)
    narrower = min(max(narrower, _f4(LOWEST_VARIANCE * VARIANCE_STEPS)), _f4(_HIGHEST))
    noisier = noise + fast.noise_share * (distance - total)
    noisier = min(max(noisier, _f4(LOWEST_NOISE * NOISE_STEPS)), _f4(HIGHEST_NOISE * NOISE_STEPS))
    return fast.step * gain, narrower, noisier, is_sure(distance, total, fast)


@compiled
def fast_rows_of_colour(
    first, end, left, right, pixels, before, light_field, fast, rounding, after, log_odds
):
    """Compare and update pixels of a colour picture where they surely show the background.

    They are those of rows `first` to `end` and columns `left` to `right`. Their `log_odds`, which begin with
    row `first`, are `_UNSURE` where they do not; what follows for the Gaussians holds only where they do. (A
    loop over rows that is a function of its own keeps the constants of the inner one from being spilled: a
    third of the time.)
    """
    luma, red, blue = before.mean[0], before.mean[1], before.mean[2]
    new_luma, new_red, new_blue = after.mean[0], after.mean[1], after.mean[2]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        cut = rounding_along(rounding, y)
        base, base_odds = np.uint64(y * width), np.uint64((y - first) * width)
        for x in range(np.uint64(left), np.uint64(right)):
            i = base + x
            k = _THREE * i
            c0, c1, c2 = planes_of(pixels[k], pixels[k + _ONE], pixels[k + _TWO])
            light = upper[x] + below_share * (lower[x] - upper[x])
            glow = light * _f4(1 / MEAN_STEPS)
            m0, m1, m2 = _f4(luma[i]), _f4(red[i]), _f4(blue[i])
            d0, d1, d2 = c0 - glow * m0, c1 - glow * m1, c2 - glow * m2
            distance = (d0 * d0 + d1 * d1 + d2 * d2) * _f4(VARIANCE_STEPS / 3)
            known, grain = _f4(variance[i]), _f4(noise[i])
            step, narrower, noisier, sure = fast_update(distance, light, known + fast.drift, grain, fast)
            new_luma[i] = whole_steps(m0 + step * d0, cut[x])
            new_red[i] = whole_steps(m1 + step * d1, cut[x])
            new_blue[i] = whole_steps(m2 + step * d2, cut[x])
            new_variance[i] = np.uint16(_i4(narrower + cut[x]))
            new_noise[i] = np.uint16(_i4(noisier + cut[x]))
            log_odds[base_odds + x] = SURE if sure & (known <= _f4(_HIGHEST)) else _UNSURE


@compiled
def fast_rows_of_grey(first, end, left, right, pixels, before, light_field, fast, rounding, after, log_odds):
    """Compare and update pixels of a grey picture, as `fast_rows_of_colour`."""
    luma, new_luma = before.mean[0], after.mean[0]
    variance, noise, new_variance, new_noise = before.variance, before.noise, after.variance, after.noise
    width = light_field.rows.shape[1]
    for y in range(first, end):
        upper, lower, below_share = light_beside(light_field, y)
        cut = rounding_along(rounding, y)
        base, base_odds = np.uint64(y * width), np.uint64((y - first) * width)
        for x in range(np.uint64(left), np.uint64(right)):
            i = base + x
            light = upper[x] + below_share * (lower[x] - upper[x])
            m0 = _f4(luma[i])
            d0 = _f4(pixels[i]) - light * _f4(1 / MEAN_STEPS) * m0
            known, grain = _f4(variance[i]), _f4(noise[i])
            distance = d0 * d0 * _f4(VARIANCE_STEPS)
            step, narrower, noisier, sure = fast_update(distance, light, known + fast.drift, grain, fast)
            new_luma[i] = whole_steps(m0 + step * d0, cut[x])
            new_variance[i] = np.uint16(_i4(narrower + cut[x]))
            new_noise[i] = np.uint16(_i4(noisier + cut[x]))
            log_odds[base_odds + x] = SURE if sure & (known <= _f4(_HIGHEST)) else _UNSURE


@compiled
def slow_rows(first, end, pixels, before, light_field, model, rounding, spans, work, after, log_odds):
    """Compare and update those spans of rows `first` to `end` in which not all is sure background.

    Gives the greatest variance there, as it is stored. A span is worked on in one array of its own: loops
    over many arrays find out first, each time, that they do not overlap.
    """
    channels, width = before.mean.shape[0], light_field.rows.shape[1]
    most = _i4(0)
    for y in range(first, end):
        own = (y - first) * width
        for k in range(foreground_spans(log_odds[own : own + width], spans)):
            left, right = spans[k], min(spans[k] + SPAN, width)
            start = y * width + left
            _load_planes(pixels[channels * start : channels * (y * width + right)], channels, work)
            _take_in_light(light_field, y, left, right, work)
            here = slice(start, y * width + right)
            most = max(most, _load_state(before, here, work))
            _posteriors(model, _f4(channels), work)
            _store_state(work, rounding_along(rounding, y)[left:right], before, after, here)
            odds = log_odds[own + left : own + right]
            for x in range(odds.size):
                odds[x] = np.int8(work[_ODDS + np.uint64(x)] * _f4(ODDS_STEPS))
    return most


@compiled
def _load_planes(shown, channels, work):
    """Planes of a span of pixels."""
    if channels == 3:
        for x in range(np.uint64(shown.size // 3)):
            k = _THREE * x
            luma, red, blue = planes_of(shown[k], shown[k + _ONE], shown[k + _TWO])
            work[_PLANES + x] = luma
            work[_PLANES + _SPAN + x], work[_PLANES + _SPAN + _SPAN + x] = red, blue
    else:
        for x in range(np.uint64(shown.size)):
            work[_PLANES + x] = _f4(shown[x])


@compiled
def _take_in_light(light_field, y, left, right, work):
    upper, lower, below_share = light_beside(light_field, y)
    above, below = upper[left:right], lower[left:right]
    for x in range(above.size):
        work[x] = above[x] + below_share * (below[x] - above[x])


@compiled
def _load_state(before, here, work):
    """Differences from the means of a span, its variances and noises; gives the greatest variance stored."""
    for channel in range(before.mean.shape[0]):
        mean, seen = before.mean[channel, here], work[(2 + channel) * SPAN : (3 + channel) * SPAN]
        for x in range(mean.size):
            seen[x] -= work[x] * mean_of(mean[x])
    variance, noise = before.variance[here], before.noise[here]
    most = _i4(0)
    for x in range(np.uint64(variance.size)):
        work[_VARIANCES + x] = variance_of(variance[x])
        most = max(most, _i4(variance[x]))
    for x in range(np.uint64(noise.size)):
        work[_NOISES + x] = noise_of(noise[x])
    return most


@compiled
def _posteriors(model, channels, work):
    """Log odds, steps, variances and noises of a whole span."""
    for x in range(_SPAN):
        d0 = work[_PLANES + x]
        d1, d2 = work[_PLANES + _SPAN + x], work[_PLANES + _SPAN + _SPAN + x]
        odds, step, variance, grain = posterior(
            d0 * d0 + d1 * d1 + d2 * d2, work[x], work[_VARIANCES + x], work[_NOISES + x], model, channels
        )
        work[_ODDS + x] = odds
        work[x] = step
        work[_VARIANCES + x] = variance
        work[_NOISES + x] = grain


@compiled
def _store_state(work, cut, before, after, here):
    """What follows for the Gaussians of a span."""
    for channel in range(before.mean.shape[0]):
        old, new = before.mean[channel, here], after.mean[channel, here]
        away = work[(2 + channel) * SPAN : (3 + channel) * SPAN]
        for x in range(new.size):
            new[x] = mean_steps(mean_of(old[x]) + work[x] * away[x], cut[x])
    variance, noise = after.variance[here], after.noise[here]
    for x in range(np.uint64(variance.size)):
        variance[x] = variance_steps(work[_VARIANCES + x], cut[x])
    for x in range(np.uint64(noise.size)):
        noise[x] = noise_steps(work[_NOISES + x], cut[x])


@compiled
def compare_rows(first, end, pixels, before, light_field, model, fast, rounding, awake, after, log_odds):
    """Write log odds of background in rows `first` to `end`, of each pixel by itself, and the update.

    `fast` is what pixels need of the `model` that show background for sure, `rounding` what is added to
    numbers before they are cut off. In blocks that are not `awake` (see `sleeping_blocks`) all pixels
    do, but where a span reaches into them; a row of blocks begins with `first`. Returns the greatest variance
    of pixels that are not sure, as it is stored.
    """
    channels, width = before.mean.shape[0], light_field.rows.shape[1]
    spans, work = np.empty(width // SPAN + 1, np.int64), np.zeros(8 * SPAN, np.float32)
    most = _i4(0)
    for start in range(first, end, BLOCK_ROWS):
        stop, blocks, block = min(start + BLOCK_ROWS, end), awake[start // BLOCK_ROWS], 0
        odds = log_odds[(start - first) * width : (stop - first) * width]
        while block < blocks.size:
            left, is_awake = block * BLOCK_COLUMNS, blocks[block]
            while block < blocks.size and blocks[block] == is_awake:
                block += 1
            right = min(block * BLOCK_COLUMNS, width)
            if is_awake == 0:
                sleep_through(start, stop, left, right, width, before, fast.drift, rounding, after, odds)
            elif channels == 3:
                fast_rows_of_colour(
                    start, stop, left, right, pixels, before, light_field, fast, rounding, after, odds
                )
            else:
                fast_rows_of_grey(
                    start, stop, left, right, pixels, before, light_field, fast, rounding, after, odds
                )
        most = max(
            most,
            slow_rows(start, stop, pixels, before, light_field, model, rounding, spans, work, after, odds),
        )
    return most


Planes = NDArray[np.float32]


class Compared(NamedTuple):
    """What an image says of a prediction, and what follows."""

    subtraction: Subtraction
    after: Gaussians | None
    shade_counts: NDArray[np.int64]  # see `recall_shaded`
    mirror_seen: Planes  # see `find_axes`
    mirrored: NDArray[np.uint8] | None  # see `recall_mirrored`; none where nothing is


CHORDS = (LOWEST_NOISE, 100.0, 1000.0)
"""Squared grey levels of variance, between which the bound of `FastPathThresholds` is linear."""


@short_repr
@dataclass(frozen=True, eq=False)
class BackgroundPrediction:
    """Prediction of every pixel's background value.

    That is N(L; light * mean, light^2 * (variance + drift) + noise).
    """

    size: tuple[int, int]  # (height, width) px
    pixels: Gaussians  # before this frame; the mean in the planes of `colour`
    frames: int  # seen before this one
    light: LightField  # of this frame
    prior: float  # P(B=1), that a pixel shows background
    drift: float  # squared grey levels added to the variance since the last observation
    noise_share: float  # share by which the noise follows what is seen, 0 to keep it fixed
    first_variance: float  # squared grey levels, of a value seen once
    unknown_variance: float  # of one that others take for an object's (see `update_behind`); 0 for none
    # weight of what the 5 x 5 pixels around show: most have one label, but they are not independent
    pooling: float
    second: SecondColours  # once known, what is within `tolerance` of it is background too
    tolerance: float  # squared grey levels, four times the variance of all channels
    sway: Sway  # how often pixels show what is beside them
    shade: Shade  # how often they stand in something's shade
    mirroring: NDArray[np.bool_]  # (block_columns,): which show what is above
    in_turn: Flags  # blocks that are compared whatever they show (see `sleeping_blocks`)
    _compared: dict[int, tuple[NDArray[np.uint8], "Compared"]] = field(default_factory=dict)

    @property
    def colours(self) -> StoredPlanes:
        """Means of all pixels."""
        return stored_planes(self.pixels.mean, self.size)

    @property
    def looks_for_mirrors(self) -> bool:
        """Whether columns are looked at that are not known to mirror."""
        return self.frames % EVERY == 0

    @cached_property
    def model(self) -> PixelModel:
        """Parameters that loops need beside the pixels."""
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
        """Offsets for rounding the update: `(width + ROUNDING_PERIOD,)` float32, with `ROUNDING`.

        Over the frames each pixel has all numbers from 0 to 1 equally often, evenly mixed (the additive
        recurrence of Roberts' plastic number), and so have neighbours in each frame.
        """
        along = np.arange(self.size[1] + ROUNDING_PERIOD) * 0.7548776662466927
        steps = np.floor((along + self.frames * 0.5698402909980532) % 1 * 128)  # as float32 beside `ROUNDING`
        return np.asarray((steps / 128 + ROUNDING).astype(np.float32))

    def compare(self, image: NDArray[np.uint8]) -> Subtraction:
        """Compare an image with the prediction; the same image is compared only once."""
        return self._comparison(image).subtraction

    def shade_counts(self, image: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return how much of each block is not the plain scene, and in shade; see `recall_shaded`."""
        return self._comparison(image).shade_counts

    def mirror_seen(self, image: NDArray[np.uint8]) -> Planes:
        """Return which columns of blocks had foreground, and an axis of reflection; see `find_axes`."""
        return self._comparison(image).mirror_seen

    def mirrored(self, image: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        """Return 255 for pixels that show a reflection, `(n_pixels,)`; none if no pixel does."""
        return self._comparison(image).mirrored

    def update(self, image: NDArray[np.uint8]) -> Gaussians:
        """Return the background after the image. The caller owns the arrays: they are forgotten here."""
        compared = self._comparison(image)
        self._compared[id(image)] = image, compared._replace(after=None)
        after = compared.after or self._subtract(image).after
        assert after is not None
        return after

    def _comparison(self, image: NDArray[np.uint8]) -> "Compared":
        if id(image) not in self._compared:
            self._compared[id(image)] = image, self._subtract(image)
        return self._compared[id(image)][1]

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None) -> float:
        """Return the log probability of the image (nats), summed over pixels as if independent.

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0. This is the integral
        of the prediction as it stands: second colours and neighbours, which only help to decide labels, are
        left out.
        """
        shift = np.zeros(1, np.float32) if pixel_shift is None else pixel_shift
        flat = np.ascontiguousarray(image).reshape(-1)
        total = log_evidence(flat, self.pixels, self.light.along_rows, self.model, shift)
        uniform = np.log1p(-self.prior) - len(self.pixels.mean) * np.log(256.0)
        return float(total + uniform * self.size[0] * self.size[1])

    def _subtract(self, image: NDArray[np.uint8]) -> Compared:
        mean, variance, noise = self.pixels
        after = Gaussians(np.empty_like(mean), np.empty_like(variance), np.empty_like(noise))
        log_odds, smoothed, unshaded = np.empty((3, self.size[0] * self.size[1]), np.int8)
        flat = np.ascontiguousarray(image).reshape(-1)
        light, fast = self.light.along_rows, fast_path_thresholds(self.model, len(mean))
        prior, rounding = _prior_steps(self.prior), self.rounding

        (height, width), tolerance, pooling = self.size, np.float32(self.tolerance), np.float32(self.pooling)
        sways, highest = bool(self.sway.rates.max() >= LEAST_RATE), []

        awake = self.in_turn
        if not awake.all():
            awake = find_awake(awake, self.frames, flat, self.pixels, light, fast)

        def compare(first_block: int, end_block: int) -> None:
            first, end = BLOCK_ROWS * first_block, min(BLOCK_ROWS * end_block, height)
            own = log_odds[first * width : end * width]
            most = compare_rows(
                first, end, flat, self.pixels, light, self.model, fast, rounding, awake, after, own
            )
            highest.append(most)
            recall(first * width, flat, self.second, tolerance, self.model, own)
            if sways:
                recall_moved(first, flat, self.pixels, light, self.model, self.sway, own)

        busy = awake.sum(axis=1) + ASLEEP * awake.shape[1]
        over_bands(compare, len(awake), costs=busy)
        some_unknown = max(highest) > HIGHEST_VARIANCE * VARIANCE_STEPS
        mirror_seen, mirrored = np.zeros((2, self.mirroring.size), np.float32), None
        axes, shares = np.full(self.mirroring.size, -1), np.zeros(self.mirroring.size, np.float32)
        wanted = self.mirroring | self.looks_for_mirrors
        if wanted.any():
            find_axes(flat, self.pixels, light, self.model, log_odds, wanted, axes, shares, mirror_seen)
        axes[~self.mirroring] = -1
        if axes.max() >= 0:
            mirrored = np.zeros(log_odds.size, np.uint8)
            recall_mirrored(flat, self.pixels, light, self.model, axes, shares, log_odds, mirrored)
        counts = []

        def pool(first: int, end: int) -> None:
            top, bottom = max(first - HALO, 0), min(end + HALO, height)
            band, of_band = slice(first * width, end * width), np.zeros((3, *self.shade.log_odds.shape), int)
            shaded = log_odds[top * width : bottom * width].copy()
            first_turned, end_turned = recall_shaded(
                first, end, HALO, flat, self.pixels, light, self.model, self.shade, log_odds, shaded, of_band
            )
            counts.append(of_band)
            around = smoothed[top * width : bottom * width]
            smooth_log_odds(first - top, end - top, bottom - top, width, shaded, prior, pooling, around)
            unshaded[band] = smoothed[band]
            if first_turned < end_turned:
                rows = max(first_turned - HALO, first), min(end_turned + HALO, end)
                smooth_log_odds(*rows, height, width, log_odds, prior, pooling, unshaded)
            if some_unknown:  # neighbours say nothing of an unknown value
                unknown = variance[band] > HIGHEST_VARIANCE * VARIANCE_STEPS
                for each in (smoothed, unshaded):
                    each[band][unknown] = np.int8(self.model.label_odds * np.float32(ODDS_STEPS))

        over_bands(pool, height, costs=np.repeat(busy, BLOCK_ROWS)[:height])
        subtraction = Subtraction(log_odds, smoothed, unshaded)
        return Compared(subtraction, after, np.sum(counts, axis=0), mirror_seen, mirrored)


def fixed_point(mean: Planes, variance: Planes, noise: Planes) -> Gaussians:
    """Return the nearest numbers of 16 bits."""
    beyond = HIGHEST_VARIANCE * (VARIANCE_STEPS - COARSE_STEPS)
    variances = np.minimum(variance * VARIANCE_STEPS, variance * COARSE_STEPS + beyond)
    return Gaussians(
        np.rint(mean * MEAN_STEPS).clip(-32768, 32767).astype(np.int16),
        np.rint(variances).clip(0, 65535).astype(np.uint16),
        np.rint(noise * NOISE_STEPS).clip(0, 65535).astype(np.uint16),
    )


def stored_planes(mean: NDArray[np.int16], size: tuple[int, int]) -> StoredPlanes:
    """Return means `(channels, n_pixels)` of 16 bits as planes of a picture of this size."""
    return StoredPlanes(mean.reshape(-1, *size), np.float32(1 / MEAN_STEPS))


def fast_path_thresholds(model: PixelModel, channels: int) -> FastPathThresholds:
    """Return the thresholds by which pixels surely show background."""
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
    return FastPathThresholds(*(np.float32(number) for number in numbers))


def log_prior_odds(prior: float, channels: int) -> float:
    """Return the log of P(B=1) over P(B=0) times the uniform density, in the units of the planes."""
    odds = np.log(prior) - np.log1p(-prior)
    return float(
        odds + channels * (np.log(256.0) - 0.5 * np.log(2 * np.pi)) + np.log(colour.VOLUME[channels])
    )


def smooth(log_odds: NDArray[np.int8], size: tuple[int, int], prior: float, share: float) -> NDArray[np.int8]:
    """Return log odds with `share` of what the 5 x 5 pixels around show, both `(n_pixels,)` int8."""
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

"""The empty scene from a sample of frames, as it is when the film begins, without what moves in front of it.

What a pixel shows unchanged for the first seconds is taken for the scene, as a tracker takes it that knows no
better: a parked car, or a person who stands. Where something moves at first, the scene is what comes back
behind them: of the colours that a pixel shows, the one that is seen often and at times far apart.
Colours of passers-by differ, and a person who stays is seen for one stretch of time.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, inlined
from ...models.numerics.threads import over_bands
from ...models.pixels.background import EmptyScene
from .gaussians import HIGHEST_NOISE, HIGHEST_VARIANCE, LOWEST_NOISE, LOWEST_VARIANCE
from .light import LightField

_f4 = np.float32


class Modes(NamedTuple):
    """Colours `(channels, n_pixels)`, mean squares by channel and number of their frames; float32."""

    mean: NDArray[np.float32]
    scatter: NDArray[np.float32]
    support: NDArray[np.float32]


STEADY = _f4(0.8)  # share of the early frames in which a pixel must show one colour to be taken for still


@compiled
def find_modes(first, end, pixels, covered, times, early, light, positions, bandwidth, after):
    """Find the colour of the empty scene at every pixel of rows `first` to `end`, over a sample of frames.

    `pixels` is `(n_frames, channels * n_pixels)` uint8 at `times` (float32 s, in order), `light` `(n_frames,
    block_rows + 1, width)` the rows of every frame's `Light`, and `positions` those of all. Where `covered`
    `(n_frames, n_pixels)` bool is true a frame does not count, unless all are. The density at a colour is the
    sum of max(0, 1 - d^2 / bandwidth) over the frames. What is still in the `early` first frames is taken as
    it is; else it is the colour with the highest product of its density and the mean distance in time of the
    frames that show it. `after` gets what is within the bandwidth of it, of a still pixel in the early frames
    alone: what comes later may be an object in similar colours.
    """
    mean, scatter, support = after.mean, after.scatter, after.support
    channels, n_frames, width = mean.shape[0], pixels.shape[0], light.shape[2]
    values = np.empty((3, n_frames), np.float32)
    closeness, weights = np.empty(n_frames, np.float32), np.empty(n_frames, np.float32)
    values[:] = _f4(0)
    for y in range(first, end):
        above = int(positions[y])
        share = positions[y] - _f4(above)
        for x in range(width):
            i = y * width + x
            clear = _f4(0)
            for frame in range(n_frames):
                weights[frame] = _f4(0) if covered[frame, i] else _f4(1)
                clear += weights[frame]
            if clear == _f4(0):
                weights[:] = _f4(1)
            for frame in range(n_frames):
                upper, lower = light[frame, above, x], light[frame, above + 1, x]
                dimmed = _f4(1) / (upper + share * (lower - upper))
                _take_colour(pixels[frame], i, channels, dimmed, values[:, frame])
            best, last = _still(values, weights, early, bandwidth, closeness), early
            if best < 0:
                best, last = _lasting(values, weights, times, bandwidth, closeness), n_frames
            count = _near(values, weights, best, last, bandwidth, closeness)
            squares = _f4(0)
            for channel in range(channels):
                total = _f4(0)
                for other in range(last):
                    total += closeness[other] * values[channel, other]
                middle = total / count
                mean[channel, i] = middle
                for other in range(last):
                    away = values[channel, other] - middle
                    squares += closeness[other] * away * away
            scatter[i] = squares / (count * _f4(channels))
            support[i] = count


@inlined
def _take_colour(pixels, i, channels, dimmed, out):
    if channels == 1:
        out[0] = dimmed * _f4(pixels[i])
        return
    b, g, r = _f4(pixels[3 * i]), _f4(pixels[3 * i + 1]), _f4(pixels[3 * i + 2])
    grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
    out[0] = dimmed * grey
    out[1] = dimmed * _f4(1.426) * (r - grey)
    out[2] = dimmed * _f4(1.128) * (b - grey)


@compiled
def _near(values, weights, frame, end, bandwidth, closeness):
    """Weights of the frames until `end` that show the colour of `frame`; returns their sum."""
    count = _f4(0)
    for other in range(end):
        d0 = values[0, other] - values[0, frame]
        d1 = values[1, other] - values[1, frame]
        d2 = values[2, other] - values[2, frame]
        closeness[other] = weights[other] if d0 * d0 + d1 * d1 + d2 * d2 < bandwidth else _f4(0)
        count += closeness[other]
    return count


@compiled
def _still(values, weights, early, bandwidth, closeness):
    """A frame with the one colour of the `early` first ones, -1 where there is none."""
    clear = _f4(0)
    for frame in range(early):
        clear += weights[frame]
    for frame in range(early):
        count = _near(values, weights, frame, early, bandwidth, closeness)
        if weights[frame] > _f4(0) and count >= STEADY * clear:
            return frame
    return -1


@compiled
def _lasting(values, weights, times, bandwidth, closeness):
    """The frame whose colour has the highest density times mean distance in time."""
    best, highest = 0, _f4(-1)
    for frame in range(times.size):
        density = middle = _f4(0)
        for other in range(times.size):
            d0 = values[0, other] - values[0, frame]
            d1 = values[1, other] - values[1, frame]
            d2 = values[2, other] - values[2, frame]
            closeness[other] = weights[other] * max(_f4(0), bandwidth - d0 * d0 - d1 * d1 - d2 * d2)
            density += closeness[other]
            middle += closeness[other] * times[other]
        if weights[frame] == _f4(0) or density == _f4(0):
            continue
        middle /= density
        extent = _f4(0)
        for other in range(times.size):
            extent += closeness[other] * abs(times[other] - middle)
        extent += bandwidth * _f4(1e-3)  # of a single frame
        if extent > highest:
            best, highest = frame, extent
    return best


Image = NDArray[np.uint8]
Numbers = NDArray[np.float64]

STILL = 3.0  # s: what does not change from the first frame on for so long is part of the scene
PRIOR_FRAMES = 8.0  # how many frames what is known of the noise beforehand counts for


def empty_scene(
    images: Sequence[Image],
    times: Numbers,
    light: Sequence[LightField],
    noise: float,
    covered: Sequence[NDArray[np.bool_]] | None = None,
) -> EmptyScene:
    """Find the empty scene of images uint8 `(height, width[, 3])`, in order of `times` `(n_images,)` s.

    `light` is that of every image, relative to the light of the mean, or one for all of them; `noise` squared
    grey levels of a single observation, as it is expected; `covered` as of `AdaptiveBackground.empty_scene`.
    """
    light = light if len(light) == len(images) else [light[0]] * len(images)
    height, width = images[0].shape[:2]
    channels = 1 if images[0].ndim == 2 else 3
    pixels = np.stack([image.reshape(-1) for image in images])
    found = Modes(
        np.empty((channels, height * width), np.float32),
        *(np.empty(height * width, np.float32) for _ in range(2)),
    )
    since = (np.asarray(times) - times[0]).astype(np.float32)
    early = int(np.count_nonzero(since <= STILL)) if since[-1] > STILL else 0
    behind = np.zeros((len(images), height * width), bool)
    if covered is not None:
        behind = np.stack([each.reshape(-1) for each in covered])
    rows = np.stack([field.along_rows.rows for field in light])
    positions = light[0].along_rows.positions
    # colours within two standard deviations of each other in all channels may be the same
    bandwidth = np.float32(8 * channels * noise)

    def find(first: int, end: int) -> None:
        find_modes(first, end, pixels, behind, since, early, rows, positions, bandwidth, found)

    over_bands(find, height)
    mean, scatter, support = found
    seen = (support * scatter + PRIOR_FRAMES * noise) / (support + PRIOR_FRAMES)
    observed = np.clip(seen, LOWEST_NOISE, HIGHEST_NOISE).astype(np.float32)
    variance = np.clip(observed / support, LOWEST_VARIANCE, HIGHEST_VARIANCE)
    return EmptyScene(images[0].shape, mean, variance.astype(np.float32), observed, light[0].blocks)

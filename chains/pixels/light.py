"""Loops over a picture for its light: the field between blocks, and how bright every block is seen."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.numerics.compiled import compiled, logarithm, put
from ...models.numerics.threads import over_bands
from .gaussians import Light, mean_of

Planes = NDArray[np.float32]

_f4 = np.float32
_UNUSABLE = _f4(1e30)  # in place of a ratio

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

SAME_LIGHT = 0.05  # log of a ratio within which a block agrees with the light that its neighbourhood has

HIDDEN_TIME = 1.0
"""s in which the light of a block that is not seen, or disagrees, becomes that of the blocks around it."""

SAMPLED = 4  # px between those of which the covered share of a block is counted

WINDOW_WEIGHT, OWN_WEIGHT = 1.0, 0.05
"""In blocks: what the next wider window counts in a window, and what all of them count in a block itself."""

LUMA_NOISE = 20.0
"""Squared grey levels: what luma differs by in any case, so that two flat surfaces are alike."""


@compiled
def follow(before, ratios, agreement, texture, covered, fastest, slowly, hidden, after):
    """Write the blocks of light `after` a frame, by what is measured in it (see `light_ratios`).

    `fastest` is the log of the most that it changes; of a slight change only the share `slowly` is followed,
    and the share `hidden` is what a block that is not seen takes from those around it.
    """
    rows, columns = before.shape
    weight, change, moved = np.empty((3, rows, columns))
    for i in range(rows):
        for j in range(columns):
            # by what is known to be there (the median is that of the larger half), and by its texture
            clear = min(max(max(1 - 2 * covered[i, j], 0.0) ** 2, UNSEEN), 1 - UNSEEN)
            odds = min(max(math.log(clear / (1 - clear)) + texture[i, j], -30.0), 30.0)
            agrees = agreement[i, j] > LEAST_AGREEMENT
            weight[i, j] = agreement[i, j] / (1 + math.exp(-odds)) if agrees else 0.0
            change[i, j] = math.log(ratios[i, j])
    around, medians, nine = _extrapolated(_filled(change, weight)), np.empty((rows, columns)), np.empty(9)
    for i in range(rows):
        for j in range(columns):
            for k in range(9):
                value, place = around[i + k // 3, j + k % 3], k
                while place > 0 and nine[place - 1] > value:
                    nine[place] = nine[place - 1]
                    place -= 1
                nine[place] = value
            medians[i, j] = nine[4]
    around = _extrapolated(medians)  # smoothed by 1 2 1 both ways: errors of no wavelength grow
    for i in range(rows):
        for j in range(columns):
            step = 0.0
            for k in range(9):
                step += around[i + k // 3, j + k % 3] * (2 - abs(k // 3 - 1)) * (2 - abs(k % 3 - 1)) / 16
            if abs(change[i, j] - step) >= SAME_LIGHT:
                weight[i, j] = 0.0
            step *= 1.0 if abs(step) > STEADY_LIGHT else slowly
            moved[i, j] = math.log(before[i, j]) + min(max(step, -fastest), fastest)
    filled = _filled(moved, weight)
    for i in range(rows):
        for j in range(columns):
            moved[i, j] += (1 - weight[i, j]) * hidden * (filled[i, j] - moved[i, j])
            after[i, j] = min(max(math.exp(moved[i, j]), DARKEST), BRIGHTEST)


@compiled
def _extrapolated(blocks):
    """Return the blocks with one more all around, by their slopes."""
    rows, columns = blocks.shape
    wide = np.empty((rows + 2, columns + 2))
    wide[1:-1, 1:-1] = blocks
    wide[0, 1:-1], wide[-1, 1:-1] = 2 * blocks[0] - blocks[1], 2 * blocks[-1] - blocks[-2]
    wide[:, 0], wide[:, -1] = 2 * wide[:, 1] - wide[:, 2], 2 * wide[:, -2] - wide[:, -3]
    return wide


@compiled
def _filled(values, weight):
    """Normalised convolution over narrowing windows: where the weight is small, what is around counts."""
    rows, columns = weight.shape
    # sums above and left of a corner, of weighted values and weights
    total, count = np.zeros((2, rows + 1, columns + 1))
    for i in range(rows):
        for j in range(columns):
            value, one = weight[i, j] * values[i, j], weight[i, j]
            total[i + 1, j + 1] = value + total[i, j + 1] + total[i + 1, j] - total[i, j]
            count[i + 1, j + 1] = one + count[i, j + 1] + count[i + 1, j] - count[i, j]
    filled = np.full(weight.shape, total[rows, columns] / (count[rows, columns] + 1))
    reach = 1
    while reach < max(rows, columns):
        reach *= 2
    while reach > 0:
        reach //= 2
        wider = WINDOW_WEIGHT if reach > 0 else OWN_WEIGHT
        for i in range(rows):
            top, bottom = max(i - reach, 0), min(i + reach + 1, rows)
            for j in range(columns):
                left, right = max(j - reach, 0), min(j + reach + 1, columns)
                values_in = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
                weight_in = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left]
                filled[i, j] = (values_in + wider * filled[i, j]) / (weight_in + wider)
    return filled


@compiled
def light_ratios(first, end, pixels, mean, light, ratios, agreement, texture):
    """Measure the brightness of the picture relative to the prediction, in rows `first` to `end` of blocks.

    A block is sampled on a grid of 6 x 6 pixels. `ratios` gets the median of luma seen over luma predicted,
    `agreement` the share of samples within 5 % of it, and `texture` nats for the scene's own texture under
    that light, over a flat surface: the log ratio of two Gaussian densities of the samples' luma.
    """
    channels, luma = mean.shape[0], mean[0]
    height, width = light.positions.size, light.rows.shape[1]
    block_rows, block_columns = ratios.shape
    samples = 6 * block_columns
    columns = np.empty(samples, np.uint32)
    for k in range(samples):
        columns[k] = int((k + 0.5) * width / samples)
    values = np.empty((6, samples), np.float32)
    predicted = np.empty((6, samples), np.float32)
    lit = _sampled_light(light.rows, columns)
    shown, known = np.zeros((3, samples), np.uint8), np.empty(samples, np.int16)
    block = np.full((8, 6), _UNUSABLE)
    below = np.empty(48, np.float32)
    for row in range(first, end):
        for sample_row in range(6):
            y = int((6 * row + sample_row + 0.5) * height / (6 * block_rows))
            # bytes first, and nothing else: what is not in the cache is waited for all at once
            _sample(pixels[channels * y * width :], luma[y * width :], columns, channels, shown, known)
            above = int(light.positions[y])
            below_share = light.positions[y] - _f4(above)
            upper, lower, out, scene = lit[above], lit[above + 1], values[sample_row], predicted[sample_row]
            for k in range(samples):
                if channels == 3:
                    b, g, r = _f4(shown[0, k]), _f4(shown[1, k]), _f4(shown[2, k])
                    seen = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                else:
                    seen = _f4(shown[0, k])
                expected = (upper[k] + below_share * (lower[k] - upper[k])) * mean_of(known[k])
                usable = (expected > _f4(16.0)) & (seen > _f4(2.0)) & (seen < _f4(250.0))
                out[k] = seen / expected if usable else _UNUSABLE
                scene[k] = expected
        for column in range(block_columns):
            for row_of_block in range(6):
                put(values[row_of_block, 6 * column : 6 * column + 6], block[row_of_block])
            ratios[row, column], agreement[row, column] = _agreed(block.reshape(-1), below)
            texture[row, column] = _texture(
                block, predicted[:, 6 * column : 6 * column + 6], ratios[row, column]
            )


@compiled
def _sampled_light(rows, columns):
    out = np.empty((rows.shape[0], columns.size), np.float32)
    for row in range(rows.shape[0]):
        for k in range(columns.size):
            out[row, k] = rows[row, columns[k]]
    return out


@compiled
def _sample(pixels, luma, columns, channels, shown, stored):
    """Some pixels of a row of a picture, and of the stored means."""
    if channels == 3:
        blue, green, red = shown[0], shown[1], shown[2]
        for k in range(columns.size):
            x = np.uint64(columns[k])
            start = x + x + x
            blue[k] = pixels[start]
            green[k], red[k] = pixels[start + np.uint64(1)], pixels[start + np.uint64(2)]
            stored[k] = luma[x]
    else:
        for k in range(columns.size):
            shown[0, k] = pixels[columns[k]]
            stored[k] = luma[columns[k]]


@compiled
def _agreed(values, below):
    """Median of the usable ones of 36 values, and the share of them within 5 % of it; 1 and 0 if under 12.

    `values` has 48, the last of them unusable: a whole number of vectors. The median is the largest value
    that has no more than half of the others below it: counting is vector code, which sorting is not.
    """
    count = _f4(0)
    for k in range(48):
        below[k] = _f4(0)
        count += _f4(1) if values[k] < _UNUSABLE else _f4(0)
    if count < _f4(12):
        return _f4(1), _f4(0)
    for j in range(36):
        value = values[j]
        for k in range(48):
            below[k] += _f4(1) if value < values[k] else _f4(0)
    half = np.floor(count * _f4(0.5))
    median = close = _f4(0)
    for k in range(48):
        median = max(median, values[k] if below[k] <= half else _f4(0))
    for k in range(48):
        close += _f4(1) if abs(values[k] - median) < _f4(0.05) * median else _f4(0)
    return median, close / count


@compiled
def _texture(values, predicted, ratio):
    """Nats for the `predicted` luma times `ratio` over a constant; `values` is seen over predicted."""
    count = mean = squares = residual = _f4(0)
    for y in range(6):
        for x in range(6):
            if values[y, x] < _UNUSABLE:
                expected = predicted[y, x]
                seen = values[y, x] * expected
                count += _f4(1)
                mean += seen
                squares += seen * seen
                residual += (seen - ratio * expected) ** 2
    if count < _f4(12):
        return _f4(0)
    flat = max(squares / count - (mean / count) ** 2, _f4(0))
    noise = _f4(LUMA_NOISE)
    return _f4(0.5) * count * (logarithm(flat + noise) - logarithm(residual / count + noise))


@short_repr
@dataclass(frozen=True, eq=False)
class LightField:
    """Brightness of the scene relative to the remembered picture, on a grid of blocks."""

    blocks: Planes
    size: tuple[int, int]

    @cached_property
    def along_rows(self) -> Light:
        """Field along x at the blocks' centres, and where between them each row lies."""
        rows = np.empty((self.blocks.shape[0] + 2, self.size[1]), np.float32)
        interpolate(self.blocks, _positions(self.size[1], self.blocks.shape[1]), rows)
        return Light(rows, _positions(self.size[0], self.blocks.shape[0]))


@compiled
def interpolate(blocks, positions, rows):
    """Write the light `(block_rows + 2, width)` along x at the blocks' centres, one more on either side."""
    around = _extrapolated(np.log(blocks.astype(np.float64)))
    for i in range(around.shape[0]):
        values = np.empty(around.shape[1], np.float32)
        for j in range(values.size):
            values[j] = min(max(math.exp(around[i, j]), DARKEST), BRIGHTEST)
        for x in range(positions.size):
            left = int(positions[x])
            rows[i, x] = values[left] + (positions[x] - _f4(left)) * (values[left + 1] - values[left])


@lru_cache(maxsize=16)
def _positions(n_pixels: int, n_blocks: int) -> Planes:
    """Where the centres of pixels lie between those of blocks, `(n_pixels,)`; block 0 is before the first."""
    return ((np.arange(n_pixels) + 0.5) * n_blocks / n_pixels + 0.5).astype(np.float32)


def track_light(
    before: LightField, image: NDArray[np.uint8], mean: NDArray[np.int16], covered: Planes, elapsed: float
) -> LightField:
    """Return the light of a frame: smooth, and moved only by what most of a neighbourhood agrees on.

    Objects change the ratio of seen to predicted brightness too. A block behind known ones speaks only if it
    shows the scene's texture nevertheless; else it takes the change of those around it, over windows as wide
    as it needs, and nothing from itself. A new object would have to fill most of three by three blocks with
    one and the same factor.

    Parameters
    ----------
    before
        of the frame before, `elapsed` s ago.
    image
        uint8 `(height, width[, 3])`.
    mean
        `(channels, n_pixels)` int16, the empty scene (see `Gaussians`).
    covered
        `(block_rows, block_columns)` share of the block behind known objects.
    """
    ratios, agreement, texture = (np.empty_like(before.blocks) for _ in range(3))
    flat = np.ascontiguousarray(image).reshape(-1)
    light = before.along_rows  # made before the threads ask for it

    def work(first: int, end: int) -> None:
        light_ratios(first, end, flat, mean, light, ratios, agreement, texture)

    over_bands(work, len(before.blocks))
    slowly, hidden = (-math.expm1(-elapsed / time) for time in (LIGHT_TIME, HIDDEN_TIME))
    fastest = FASTEST_LIGHT * elapsed
    blocks = np.empty_like(before.blocks)
    follow(before.blocks, ratios, agreement, texture, covered, fastest, slowly, hidden, blocks)
    return LightField(blocks, before.size)


def light_grid(height: int, width: int) -> tuple[int, int]:
    """Return the blocks of light over a picture: 24 along its longer side, at least two each way."""
    block = max(height, width) / 24
    return max(round(height / block), 2), max(round(width / block), 2)


def share_of_blocks(covered: NDArray[np.uint8], grid: tuple[int, ...]) -> Planes:
    """Return the covered share of every block of light; `(height, width)` uint8 are 255 where covered."""
    every = min(SAMPLED, *(max(n // m, 1) for n, m in zip(covered.shape, grid, strict=True)))
    shares = np.empty(grid, np.float32)
    count_covered(covered, every, shares)
    return shares


@compiled
def count_covered(covered, every, shares):
    """Write the share of 255 in each block, of the pixels `every` so many px."""
    (height, width), (block_rows, block_columns) = covered.shape, shares.shape
    samples = np.arange(0, width, every)
    starts = np.searchsorted(samples * block_columns // width, np.arange(block_columns + 1))
    counts, rows = np.zeros((block_rows, block_columns), np.int64), np.zeros(block_rows, np.int64)
    for y in range(0, height, every):
        row = y * block_rows // height
        rows[row] += 1
        for column in range(block_columns):
            hidden = 0
            for k in range(starts[column], starts[column + 1]):
                hidden += covered[y, k * every] == 255
            counts[row, column] += hidden
    for row in range(block_rows):
        for column in range(block_columns):
            seen = rows[row] * (starts[column + 1] - starts[column])
            shares[row, column] = counts[row, column] / max(seen, 1)

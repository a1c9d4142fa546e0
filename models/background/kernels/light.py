"""Loops over a picture for its light: the field between blocks, and how bright every block is seen."""

import numpy as np

from ...numerics.compiled import compiled, logarithm
from .gaussian import light_beside

_f4 = np.float32
_UNUSABLE = _f4(1e30)

LUMA_NOISE = 20.0
"""Squared grey levels: what luma differs by in any case, so that two flat surfaces are alike."""


@compiled
def interpolate(blocks, left, share, rows):
    """Rows of blocks along x: between the block `left` of every pixel and the next."""
    for row in range(rows.shape[0]):
        values, out = blocks[row], rows[row]
        for x in range(out.size):
            out[x] = values[left[x]] + share[x] * (values[left[x] + 1] - values[left[x]])


@compiled
def light_ratios(pixels, mean, light, ratios, agreement, texture):
    """Robust brightness of the picture relative to the prediction, per block of the light field.

    A block is sampled on a grid of 6 x 6 pixels. `ratios` gets the median of luma seen over luma predicted,
    `agreement` the share of samples within 5 % of it, and `texture` nats for the scene's own texture under
    that light, over a flat surface: the log ratio of two Gaussian densities of the samples' luma.
    """
    channels = mean.shape[0]
    luma = mean[0]
    height, width = light.positions.size, light.rows.shape[1]
    block_rows, block_columns = ratios.shape
    samples = 6 * block_columns
    columns = np.empty(samples, np.int64)
    for k in range(samples):
        columns[k] = int((k + 0.5) * width / samples)
    values = np.empty((6, samples), np.float32)
    predicted = np.empty((6, samples), np.float32)
    block = np.full((8, 6), _UNUSABLE)
    below = np.empty(48, np.float32)
    for row in range(block_rows):
        for sample_row in range(6):
            y = int((6 * row + sample_row + 0.5) * height / (6 * block_rows))
            upper, lower, below_share = light_beside(light, y)
            own = luma[y * width : (y + 1) * width]
            shown = pixels[channels * y * width : channels * (y + 1) * width]
            out, scene = values[sample_row], predicted[sample_row]
            for k in range(samples):
                x = columns[k]
                if channels == 3:
                    b, g, r = _f4(shown[3 * x]), _f4(shown[3 * x + 1]), _f4(shown[3 * x + 2])
                    seen = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                else:
                    seen = _f4(shown[x])
                expected = (upper[x] + below_share * (lower[x] - upper[x])) * own[x]
                usable = (expected > _f4(16.0)) & (seen > _f4(2.0)) & (seen < _f4(250.0))
                out[k] = seen / expected if usable else _UNUSABLE
                scene[k] = expected
        for column in range(block_columns):
            block[:6] = values[:, 6 * column : 6 * column + 6]
            ratios[row, column], agreement[row, column] = _agreed(block.reshape(-1), below)
            texture[row, column] = _texture(
                block, predicted[:, 6 * column : 6 * column + 6], ratios[row, column]
            )


@compiled
def _agreed(values, below):
    """Median of the usable ones of 36 values, and the share of them within 5 % of it; 1 and 0 if under 12.

    `values` has 48, the last of them unusable: a whole number of vectors. The median is the largest value
    that has no more than half of the others below it: counting them is vector code, which sorting is not.
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

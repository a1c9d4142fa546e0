"""Loops over the patches of blobs: finding one in the picture, and learning its shape and colours.

A patch is a small array; `(top, left)` places it in the picture, over whose edges it may reach.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...background.kernels.gaussian import ODDS_STEPS, foreground_spans
from ...background.kernels.layers import Sprite, colour_distance
from ...numerics.compiled import compiled, exponential, logarithm

_f4 = np.float32

HIGHEST_COVER = 0.97
"""Masks stay below certainty, so that evidence can always win them back."""


UNKNOWN_COLOUR = -1e4
"""In an appearance: no colour is known of this pixel."""

_NOT_YET = _f4(-1e30)
_VECTOR = 16


class Patch(NamedTuple):
    """A box cut out of the picture, all float32.

    `(channels, height, width)` planes, and `(height, width)` each: log odds of background in nats, and what
    nothing else covers (0 outside the picture).
    """

    planes: NDArray[np.float32]
    log_odds: NDArray[np.float32]
    free: NDArray[np.float32]


class Expected(NamedTuple):
    """Where a blob is expected, px from the middle of its patch, and how surely, 1/px^2 along either axis."""

    y: float
    x: float
    precision: float


@compiled
def gather(image, log_odds, top, left, patch):
    """Cut a box out of a picture `(height, width, channels)` and int8 log odds `(height, width)`."""
    planes, odds, free = patch
    height, width, channels = image.shape
    rows, columns = free.shape
    first, end = min(max(0, -left), columns), max(min(columns, width - left), 0)
    for row in range(rows):
        y = top + row
        if y < 0 or y >= height or end - first < columns:
            free[row] = _f4(0)
            odds[row] = _f4(0)
            planes[:, row] = _f4(0)
            if y < 0 or y >= height or end <= first:
                continue
        free[row, first:end] = _f4(1)
        steps, out = log_odds[y, left + first : left + end], odds[row, first:end]
        for x in range(steps.size):
            out[x] = _f4(steps[x]) * _f4(1 / ODDS_STEPS)
        seen, luma = image[y, left + first : left + end], planes[0, row, first:end]
        if channels == 3:
            red, blue = planes[1, row, first:end], planes[2, row, first:end]
            for x in range(steps.size):
                b, g, r = _f4(seen[x, 0]), _f4(seen[x, 1]), _f4(seen[x, 2])
                grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                luma[x] = grey
                red[x] = _f4(1.426) * (r - grey)
                blue[x] = _f4(1.128) * (b - grey)
        else:
            for x in range(steps.size):
                luma[x] = _f4(seen[x, 0])


@compiled
def density_without(odds, prior):
    """1 / b, b = (1 - P(B)) (1 + odds): the pixels' density without the blob, relative to the uniform one."""
    out = np.empty(odds.shape, np.float32)
    flat, result = odds.reshape(-1), out.reshape(-1)
    for i in range(flat.size):
        result[i] = _f4(1) / ((_f4(1) - prior) * (_f4(1) + exponential(flat[i])))
    return out


@compiled
def cover(free, top, left, mask):
    """Take away from `free` what a mask placed at `(top, left)` in it covers."""
    rows, columns = free.shape
    first, end = max(0, -left), min(mask.shape[1], columns - left)
    for row in range(max(0, -top), min(mask.shape[0], rows - top)):
        for x in range(first, end):
            free[top + row, left + x] *= _f4(1) - mask[row, x]


@compiled
def _agreement(start, step, planes, rivals, free, sprite):
    """Sum of log{[M f + (1 - M) b] / b} over every `step`-th row of a blob at `start` in the patch.

    `rivals` is b, what pixels are without the blob, relative to the uniform density; f its colours' density.
    Rows are whole vectors (see `_padded`): an inner loop of fixed length leaves no remainder to scalar code,
    and most blobs are only a few vectors wide.
    """
    mask, appearance, half_precision = sprite.mask, sprite.appearance, sprite.half_precision
    log_ratio, outliers = sprite.log_ratio, sprite.outliers
    total = _f4(0)
    channels, rows, columns = appearance.shape
    width = rivals.shape[1]
    inlying = _f4(1) - outliers
    seen, own = planes.reshape(-1), appearance.reshape(-1)
    covers, other, open_ = mask.reshape(-1), rivals.reshape(-1), free.reshape(-1)
    red, blue = np.uint64(rivals.size), np.uint64(2 * rivals.size)
    own_red, own_blue = np.uint64(mask.size), np.uint64(2 * mask.size)
    for row in range(0, rows, step):
        for first in range(0, columns, _VECTOR):
            there, here = np.uint64(start + row * width + first), np.uint64(row * columns + first)
            part = _f4(0)
            for k in range(np.uint64(_VECTOR)):
                i, j = there + k, here + k
                d0 = seen[i] - own[j]
                distance = d0 * d0
                if channels == 3:
                    d1, d2 = seen[i + red] - own[j + own_red], seen[i + blue] - own[j + own_blue]
                    distance += d1 * d1 + d2 * d2
                density = inlying * exponential(log_ratio - half_precision * distance) + outliers
                part += open_[i] * logarithm(_f4(1) + covers[j] * (density * other[i] - _f4(1)))
            total += part
    return total * _f4(step)


@compiled
def _padded(maps, columns):
    """Maps with zeros to the right of their rows, `columns` in all."""
    out = np.zeros((maps.shape[0], maps.shape[1], columns), np.float32)
    out[:, :, : maps.shape[2]] = maps
    return out


@compiled
def search(reach, expected, temper, step, patch, rivals, sprite):
    """Where in the patch the blob is: coarse to fine about `(reach, reach)`, prior and pixels together.

    The prior is a Gaussian about the place that is `expected`; the sum over every `step`-th row of pixels is
    tempered, for neighbouring pixels are not independent. `rivals` is what pixels are without the blob (see
    `density_without`).

    Returns
    -------
    y, x
        px, sub-pixel, from the middle of the patch.
    variance_y, variance_x
        px^2, from the curvature of the pixels' part at the best place.
    """
    spare = -sprite.mask.shape[1] % _VECTOR
    width, patch_width = sprite.mask.shape[1] + spare, rivals.shape[1] + spare
    padded = Sprite(
        _padded(sprite.mask.reshape(1, *sprite.mask.shape), width)[0],
        _padded(sprite.appearance, width),
        sprite.half_precision,
        sprite.log_ratio,
        sprite.outliers,
    )
    seen = _padded(patch.planes, patch_width)
    others = _padded(rivals.reshape(1, *rivals.shape), patch_width)[0]
    opens = _padded(patch.free.reshape(1, *rivals.shape), patch_width)[0]
    best = _NOT_YET
    best_y = best_x = 0
    size = 2 * reach + 1
    scores = np.full((size, size), _NOT_YET, np.float32)
    stride = max(reach // 2, 1)
    centre_y = centre_x = 0
    spread = 2
    while True:
        for i in range(-spread, spread + 1):
            for j in range(-spread, spread + 1):
                y, x = centre_y + i * stride, centre_x + j * stride
                if abs(y) > reach or abs(x) > reach:
                    continue
                prior = -0.5 * expected.precision * ((y - expected.y) ** 2 + (x - expected.x) ** 2)
                if scores[reach + y, reach + x] == _NOT_YET:
                    start = (reach + y) * patch_width + reach + x
                    scores[reach + y, reach + x] = temper * _agreement(
                        start, step, seen, others, opens, padded
                    )
                score = scores[reach + y, reach + x] + prior
                if score > best:
                    best, best_y, best_x = score, y, x
        moved = best_y != centre_y or best_x != centre_x
        centre_y, centre_x = best_y, best_x
        spread = 1
        if stride > 1:
            stride = max(stride // 2, 1)
        elif not moved:
            break
    fine_y, variance_y = _peak(scores[:, reach + best_x], reach + best_y)
    fine_x, variance_x = _peak(scores[reach + best_y], reach + best_x)
    return best_y + fine_y, best_x + fine_x, variance_y, variance_x


@compiled
def _peak(scores, middle):
    """Sub-pixel peak of a parabola through three scores and its variance."""
    if middle == 0 or middle == scores.size - 1:
        return 0.0, 25.0
    before, here, after = scores[middle - 1], scores[middle], scores[middle + 1]
    if before == _NOT_YET or after == _NOT_YET:
        return 0.0, 25.0
    curvature = 2 * here - before - after
    if not curvature > 0.04:
        return 0.0, 25.0
    return min(max(0.5 * (after - before) / curvature, -0.5), 0.5), max(1.0 / curvature, 0.1)


@compiled
def learn(patch, explained, sprite, strength, mask_share, colour_share, least_kept, new_mask, new_appearance):
    """Shape and colours of a blob after a frame.

    The mask follows what the background's chain says alone (log odds), but keeps `least_kept` of likely
    pixels that fit the blob's own colours as well; of pixels that it loses, the colours are forgotten.
    `explained` is by all layers together (see `Region.explained`): a pixel that another blob explains better
    is not learned, nor is one that something in front covers.

    Returns
    -------
    total, visible, seen
        mass of the mask, of its part that nothing covers, and of that part that is foreground and its own.
    variance
        mean squared difference of its pixels from the remembered colours, per channel.
    """
    planes, odds, free = patch
    mask, appearance, half_precision, log_ratio, outliers = sprite
    rows, columns = mask.shape
    distance, rates = np.empty(columns, np.float32), np.empty(columns, np.float32)
    inlying = _f4(1) - outliers
    total = visible = seen = 0.0
    squares = inside = 1e-6
    for row in range(rows):
        colour_distance(planes, 0, 0, appearance, row, 0, columns, distance)
        covers, open_, out = mask[row], free[row], new_mask[row]
        own_odds, all_layers = odds[row], explained[row]
        sum_covers = sum_open = sum_seen = sum_squares = sum_inner = _f4(0)
        for x in range(columns):
            density = inlying * exponential(log_ratio - half_precision * distance[x]) + outliers
            clear = open_[x] * covers[x]
            share = min((strength * clear * density + _f4(1)) / all_layers[x], _f4(1))
            target = share / (_f4(1) + exponential(own_odds[x]))
            sum_covers += covers[x]
            sum_open += clear
            sum_seen += clear * target
            # a likely pixel that fits the blob's colours as well as the background's tells nothing
            doubt = (covers[x] > _f4(0.35)) & (density > _f4(1))
            least = least_kept if doubt else _f4(0)
            after = covers[x] + mask_share * open_[x] * (max(target, least) - covers[x])
            out[x] = min(max(after, _f4(0)), _f4(HIGHEST_COVER))
            # a pixel that is new to the blob takes the colour that it shows
            rate = _f4(1) if (covers[x] < _f4(0.2)) & (colour_share > _f4(0)) else colour_share
            taken = open_[x] * target > _f4(0.5)
            rates[x] = rate if taken else _f4(0)
            inner = _f4(1) if taken & (covers[x] > _f4(0.5)) else _f4(0)
            sum_squares += inner * distance[x]
            sum_inner += inner
        total += sum_covers
        visible += sum_open
        seen += sum_seen
        squares += sum_squares
        inside += sum_inner
        out = new_mask[row]
        for channel in range(appearance.shape[0]):
            old, shown, new = appearance[channel, row], planes[channel, row], new_appearance[channel, row]
            for x in range(columns):
                colour = old[x] + rates[x] * (shown[x] - old[x])
                new[x] = _f4(UNKNOWN_COLOUR) if out[x] < _f4(0.1) else colour
    return total, visible, seen, squares / (inside * appearance.shape[0])


@compiled
def outline_contrasts(planes, free, mask, reach, out):
    """Contrasts of planes `(channels, height, width)` about a mask's outline: across it, and right outside.

    They compare colours `reach` px inside of every step of the outline (right inside, where the mask is
    thinner) and as far outside, and the latter with one twice as far again. Steps whose three places are not
    all free are left out.

    Returns
    -------
    count
        of the columns of `out` `(2, 4 * height * width)` that were filled, grey levels: across, outside.
    """
    channels, rows, columns = planes.shape
    count = 0
    for y in range(reach, rows - reach):
        for x in range(reach, columns - reach):
            if mask[y, x] <= _f4(0.5):
                continue
            for direction in range(4):
                down = (1, -1, 0, 0)[direction]
                right = (0, 0, 1, -1)[direction]
                if mask[y + down, x + right] > _f4(0.5):
                    continue
                y1, x1 = y - reach * down, x - reach * right
                if mask[y1, x1] <= _f4(0.5):
                    y1, x1 = y, x
                y2, x2 = y + reach * down, x + reach * right
                y3, x3 = y + 3 * reach * down, x + 3 * reach * right
                if not (0 <= y3 < rows and 0 <= x3 < columns):
                    y3, x3 = y2 + 2 * reach * right, x2 + 2 * reach * down
                if not (0 <= y3 < rows and 0 <= x3 < columns):
                    continue
                if min(free[y1, x1], free[y2, x2], free[y3, x3]) < _f4(0.5):
                    continue
                across = outside = _f4(0)
                for channel in range(channels):
                    middle = planes[channel, y2, x2]
                    across += (planes[channel, y1, x1] - middle) ** 2
                    outside += (planes[channel, y3, x3] - middle) ** 2
                out[0, count], out[1, count] = np.sqrt(across), np.sqrt(outside)
                count += 1
    return count


@compiled
def count_foreground(log_odds, width, scale, counts):
    """Number of foreground pixels (negative log odds) in every block of `scale` x `scale` px."""
    counts[:] = 0
    spans = np.empty(log_odds.size // 64 + 1, np.int64)
    for k in range(foreground_spans(log_odds, spans)):
        for i in range(spans[k], min(spans[k] + 64, log_odds.size)):
            if log_odds[i] < 0:
                y = i // width
                counts[y // scale, (i - y * width) // scale] += 1

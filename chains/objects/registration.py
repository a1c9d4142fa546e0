"""Finding blobs again: the place in the picture where mask and colours of each fit best, front to back."""

from functools import partial
from typing import NamedTuple

import numpy as np

from ...models.numerics.compiled import compiled, exponential, inlined, logarithm, put
from ...models.numerics.threads import side_by_side, thread_count
from ...models.pixels.layers import Sprite, log_uniform
from ...models.pixels.pixel_labels import PixelMessage
from .blob_records import (
    FRESH,
    Picture,
    colours_of,
    corner_of,
    cover_by,
    gather,
    length_of,
    mask_of,
    patch_in,
)
from .blobs import Blobs

_f4 = np.float32

WIDEST_REACH = 24  # px, by which a blob is looked for off its expected place at most

TRACE = 0.05
"""Probability of cover from which on pixels are compared with the picture: what grows is faint at first."""

FINEST_ROWS = 1500  # px of a patch, for each of which one row more is left out
ASTRAY, ASTRAY_TIME = 0.05, 0.1  # lengths, and s for which, a mask is off the object that a detector finds

_NOT_YET = _f4(-1e30)  # a score that no place has
_VECTOR = 16  # float32 numbers of the widest vector unit (AVX-512)
_ROWS = 4  # whose factors are multiplied before their logarithm is taken: within 2 ** +-80


class Expected(NamedTuple):
    """Expected place of a blob, px from the middle of its patch, and precision, 1/px^2 along either axis."""

    y: float
    x: float
    precision: float


class Matching(NamedTuple):
    """Parameters by which blobs are compared with pixels; see `register_blobs`."""

    log_uniform: float
    outliers: float
    likelihood_power: float
    elapsed: float


@compiled
def sprite_of(blob, mask, colours, terms):
    """Return a blob's mask and colours as a `Sprite`."""
    channels = colours.shape[0]
    log_ratio = (
        terms.log_uniform - 0.5 * channels * np.log(2 * np.pi * blob.colour_variance) if channels else 0.0
    )
    return Sprite(mask, colours, _f4(0.5 / blob.colour_variance), _f4(log_ratio), _f4(terms.outliers))


@compiled
def set_rivals(patch, prior, rivals):
    """1 / b, b = (1 - P(B)) (1 + odds): the pixels' density without the blob, relative to the uniform one.

    Gives whether all pixels are either free or not; where they are not, the density is 0 then.
    """
    odds, free, result = patch.log_odds.reshape(-1), patch.free.reshape(-1), rivals.reshape(-1)
    partly = np.int32(0)
    for i in range(odds.size):
        result[i] = _f4(1) / ((_f4(1) - prior) * (_f4(1) + exponential(odds[i])))
        partly |= np.int32((free[i] > _f4(0)) & (free[i] < _f4(1)))
    if partly:
        return False
    for i in range(odds.size):
        result[i] *= free[i]
    return True


@inlined
def _factor(seen, own, i, j, planes, covers, other, free, terms):
    """[M f + (1 - M) b] / b of pixel `i`, by its distance from the blob's colour `j` in all planes."""
    red, blue, own_red, own_blue = planes
    chroma, half_precision, log_ratio, inlying, outliers = terms
    d0, d1 = seen[i] - own[j], seen[i + red] - own[j + own_red]
    d2 = seen[i + blue] - own[j + own_blue]
    distance = d0 * d0 + chroma * (d1 * d1 + d2 * d2)
    density = inlying * exponential(log_ratio - half_precision * distance) + outliers
    return _f4(1) + covers * (density * other - free)


@compiled
def agreement(start, step, every, patch, rivals, whole, sprite):
    """Sum of log{[M f + (1 - M) b] / b} over the rows of a sprite at `start` in the patch, `step` px apart.

    Only `every` row of the sprite, one or two, is looked at. `rivals` is 1 / b, what pixels are without the
    blob, relative to the uniform density; f its colours' density. Rows are whole vectors, and as many as are
    multiplied (see `packed`): an inner loop of fixed length leaves no remainder to scalar code, and most
    blobs are only a few vectors wide. Where pixels are free or not (`whole`), factors of several rows have
    one logarithm.
    """
    channels, rows, columns = sprite.appearance.shape
    seen, own, covers = patch.planes.reshape(-1), sprite.appearance.reshape(-1), sprite.mask.reshape(-1)
    other, free = rivals.reshape(-1), patch.free.reshape(-1)
    # no branch within a loop, which would be no vector code then
    chroma = _f4(1) if channels == 3 else _f4(0)
    red, own_red = np.uint64(rivals.size * (channels // 3)), np.uint64(covers.size * (channels // 3))
    planes = red, np.uint64(2) * red, own_red, np.uint64(2) * own_red
    terms = (chroma, sprite.half_precision, sprite.log_ratio, _f4(1) - sprite.outliers, sprite.outliers)
    down, own_down = np.uint64(every * step * rivals.shape[1]), np.uint64(every * columns)
    total = _f4(0)
    for row in range(0, rows, every * (_ROWS if whole else 1)):
        for first in range(0, columns, _VECTOR):
            there = np.uint64(start + row * step * rivals.shape[1] + first)
            here = np.uint64(row * columns + first)
            part = _f4(0)
            if whole:
                for k in range(np.uint64(_VECTOR)):
                    i, j = there + k, here + k
                    one = _factor(seen, own, i, j, planes, covers[j], other[i], free[i], terms)
                    i, j = i + down, j + own_down
                    two = _factor(seen, own, i, j, planes, covers[j], other[i], free[i], terms)
                    i, j = i + down, j + own_down
                    three = _factor(seen, own, i, j, planes, covers[j], other[i], free[i], terms)
                    i, j = i + down, j + own_down
                    four = _factor(seen, own, i, j, planes, covers[j], other[i], free[i], terms)
                    part += logarithm((one * two) * (three * four))
            else:
                for k in range(np.uint64(_VECTOR)):
                    i, j = there + k, here + k
                    one = _factor(seen, own, i, j, planes, covers[j], other[i], _f4(1), terms)
                    part += free[i] * logarithm(one)
            total += part
    return total * _f4(every * step)


@compiled
def packed(sprite, within, step, scratch):
    """Every `step`-th row of a part of a sprite, with zeros to the right and below; the rest of `scratch`."""
    channels = sprite.appearance.shape[0]
    top, left, bottom, right = within
    kept, columns = -(-(bottom - top) // step), right - left
    height, width = kept + -kept % (2 * _ROWS), columns + -columns % _VECTOR
    size = height * width
    maps = scratch[: (1 + channels) * size].reshape(1 + channels, height, width)
    for row in range(height):
        if row < kept:
            put(sprite.mask[top + row * step, left:right], maps[0, row, :columns])
            for channel in range(channels):
                own = sprite.appearance[channel, top + row * step, left:right]
                put(own, maps[1 + channel, row, :columns])
            maps[:, row, columns:] = _f4(0)
        else:
            maps[:, row] = _f4(0)
    small = Sprite(maps[0], maps[1:], sprite.half_precision, sprite.log_ratio, sprite.outliers)
    return small, scratch[(1 + channels) * size :]


@compiled
def search(reach, expected, likelihood_power, step, patch, rivals, whole, sprite, scratch):
    """Find a sprite in its patch: coarse to fine about the middle, by prior and pixels together.

    The prior is a Gaussian about the place that is `expected`; the sum over the sprite's rows, `step` px
    apart in the patch, is tempered, for neighbouring pixels are not independent; until the place is known to
    two pixels, every other row is enough. `rivals` and `whole` are as of `set_rivals`. Gives y and x,
    sub-pixel, from the middle of the patch, and their variances px^2 from the curvature of the pixels' part
    at the best place.
    """
    best = _NOT_YET
    best_y = best_x = 0
    size = 2 * reach + 1
    both = scratch[: 2 * size * size].reshape(2, size, size)
    both[:] = _NOT_YET
    rough, scores = both[0], both[1]
    stride = max(reach // 2, 1)
    centre_y = centre_x = 0
    around = 2
    while True:
        every, known = (2, rough) if stride > 1 else (1, scores)
        for i in range(-around, around + 1):
            for j in range(-around, around + 1):
                y, x = centre_y + i * stride, centre_x + j * stride
                if abs(y) > reach or abs(x) > reach:
                    continue
                prior = -0.5 * expected.precision * ((y - expected.y) ** 2 + (x - expected.x) ** 2)
                if known[reach + y, reach + x] == _NOT_YET:
                    start = (reach + y) * rivals.shape[1] + reach + x
                    known[reach + y, reach + x] = likelihood_power * agreement(
                        start, step, every, patch, rivals, whole, sprite
                    )
                score = known[reach + y, reach + x] + prior
                if score > best:
                    best, best_y, best_x = score, y, x
        moved = best_y != centre_y or best_x != centre_x
        centre_y, centre_x = best_y, best_x
        around = 1
        if stride > 1:
            stride = max(stride // 2, 1)
            best = best if stride > 1 else _NOT_YET
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
def scratch_for_search(blobs, channels):
    """Return how many numbers of scratch `register` needs for the largest of some blobs."""
    most = 0
    for k in range(blobs.size):
        rows, columns = _widest_patch(blobs[k], WIDEST_REACH)
        most = max(most, rows * columns)
    return (2 * channels + 4) * most + 2 * (2 * WIDEST_REACH + 1) ** 2


@compiled
def _widest_patch(blob, reach):
    """Rows and columns of the largest patch that a blob, `packed`, may need, with `reach` px about it."""
    return blob.rows + 2 * (reach + _ROWS * _step(blob)), blob.columns + 2 * reach + _VECTOR


@compiled
def _step(blob):
    return max(1, blob.rows * blob.columns // FINEST_ROWS)


@compiled
def _traced_part(mask):
    """Top, left, bottom and right of the part of a mask in which there is more than a trace of it."""
    rows, columns = mask.shape
    top, left, bottom, right = rows, columns, 0, 0
    for row in range(rows):
        highest = _f4(0)
        for x in range(columns):
            highest = max(highest, mask[row, x])
        if highest > _f4(TRACE):
            top, bottom = min(top, row), row + 1
            first, end = 0, columns
            while first < left and mask[row, first] <= _f4(TRACE):
                first += 1
            while end > right and mask[row, end - 1] <= _f4(TRACE):
                end -= 1
            left, right = min(left, first), max(right, end)
    return (top, left, bottom, right) if bottom > 0 else (0, 0, rows, columns)


@compiled
def _reach(blob):
    """px by which a blob is looked for off its expected place."""
    most = max(6.0, min(0.35 * length_of(blob), float(WIDEST_REACH)))
    return int(min(max(2.5 * np.sqrt(blob.covariance[0, 0]) + 1, 2.0), most))


@compiled
def patch_bounds(blob):
    """Return top, left, rows and columns of all pixels that a blob may be compared with."""
    (top, left), reach = corner_of(blob), _reach(blob)
    rows, columns = _widest_patch(blob, reach)
    return top - reach, left - reach, rows, columns


@compiled
def assign_shards(blobs, count, shards):
    """Assign blobs, front to back, to `count` shards `(n,)` of about as many pixels each.

    No blob is compared with pixels that one of another shard covers, however far that one moves.
    """
    for k in range(blobs.size):
        shards[k] = k
        top, left, rows, columns = patch_bounds(blobs[k])
        for j in range(k):
            down, right = corner_of(blobs[j])
            moves = _reach(blobs[j]) + 1
            meets = top - moves < down + blobs[j].rows and down - moves < top + rows
            if meets and left - moves < right + blobs[j].columns and right - moves < left + columns:
                own, other = shards[k], shards[j]
                for i in range(k + 1):
                    shards[i] = other if shards[i] == own else shards[i]
    loads = np.zeros(count, np.int64)
    of_group = np.full(blobs.size, -1)
    for k in range(blobs.size):
        group = shards[k]
        if of_group[group] < 0:
            of_group[group] = np.argmin(loads)
        shards[k] = of_group[group]
        loads[shards[k]] += blobs[k].rows * blobs[k].columns


@compiled
def register(blobs, pools, picture, terms, shards, shard, scratch):
    """Update place and velocity of a shard of blobs, front to back, by pixels that no blob in front covers.

    Records change. `shards` `(n,)` are those of `assign_shards`, `scratch` is memory for `scratch_for_search`
    numbers.
    """
    for k in range(blobs.size):
        if shards[k] != shard:
            continue
        blob = blobs[k]
        if blob.detected and (blob.confidence < 0.5 or blob.seen < FRESH):
            continue  # its mask shows nothing that could be found again
        top, left = corner_of(blob)
        place, both, speed = blob.covariance[0, 0], blob.covariance[0, 1], blob.covariance[1, 1]
        reach, step = _reach(blob), _step(blob)
        channels = picture.image.shape[2]
        mask = mask_of(blob, pools)
        whole_sprite = sprite_of(blob, mask, colours_of(blob, pools, channels), terms)
        within = _traced_part(mask)
        sprite, rest = packed(whole_sprite, within, step, scratch)
        rows, columns = 2 * reach + step * sprite.mask.shape[0], 2 * reach + sprite.mask.shape[1]
        patch, rest = patch_in(rest, channels, rows, columns)
        first_row, first_column = top + within[0] - reach, left + within[1] - reach
        gather(picture.image, picture.log_odds, first_row, first_column, patch)
        cover_by(patch.free, first_row, first_column, blobs[:k], pools)
        rivals, rest = rest[: rows * columns].reshape(rows, columns), rest[rows * columns :]
        whole = set_rivals(patch, picture.prior, rivals)
        expected = Expected(blob.position[0] - top, blob.position[1] - left, 1 / max(place, 0.25))
        down, right, variance_y, variance_x = search(
            reach, expected, _f4(terms.likelihood_power), step, patch, rivals, whole, sprite, rest
        )
        variance = min(max(variance_y, variance_x, 0.25), 100.0)
        if blob.detected:
            # a mask errs with its box, and for a while: detections know better
            astray = (ASTRAY * length_of(blob)) ** 2
            variance = max(variance, astray * max(ASTRAY_TIME / max(terms.elapsed, 1e-3), 1.0))
        gain, speed_gain = place / (place + variance), both / (place + variance)
        off_y, off_x = top + down - blob.position[0], left + right - blob.position[1]
        blob.position[0] += gain * off_y
        blob.position[1] += gain * off_x
        blob.velocity[0] += speed_gain * off_y
        blob.velocity[1] += speed_gain * off_x
        blob.covariance[0, 0] = (1 - gain) * place
        blob.covariance[0, 1] = blob.covariance[1, 0] = (1 - gain) * both
        blob.covariance[1, 1] = speed - speed_gain * both


def make_picture(pixels: PixelMessage) -> Picture:
    """Return a frame with an image and a background as a `Picture`."""
    assert pixels.image is not None
    assert pixels.background is not None
    assert pixels.subtraction is not None
    image = np.ascontiguousarray(pixels.image)
    image = image if image.ndim == 3 else image[:, :, None]
    odds, unshaded = (
        each.reshape(image.shape[:2]) for each in (pixels.subtraction.smoothed, pixels.subtraction.unshaded)
    )
    return Picture(image, odds, unshaded, np.float32(pixels.background.prior))


def register_blobs(
    blobs: Blobs, pixels: PixelMessage, outliers: float, likelihood_power: float, elapsed: float
) -> Blobs:
    """Update place and velocity of blobs, front to back, by the pixels that no blob in front covers.

    `pixels` have an image and a background; `outliers` is the share of a blob's pixels that look otherwise,
    `likelihood_power` how many independent observations one pixel is worth, `elapsed` s since the last frame.
    """
    if not len(blobs):
        return blobs
    table = blobs.table.copy()
    terms = Matching(log_uniform(blobs.channels), outliers, likelihood_power, elapsed)
    picture, room = make_picture(pixels), scratch_for_search(table, blobs.channels)
    shards, count = np.zeros(len(table), np.int64), min(thread_count(), len(table))
    if count > 1:
        assign_shards(table, count, shards)

    def work(shard: int) -> None:
        register(table, blobs.pools, picture, terms, shards, shard, np.empty(room, np.float32))

    side_by_side([partial(work, shard) for shard in range(count)])
    return blobs.with_table(table)

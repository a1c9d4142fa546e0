"""Loops over the patches of blobs: finding one in the picture, and learning its shape and colours.

A patch is a small array; `(top, left)` places it in the picture, over whose edges it may reach.
"""

import numpy as np

from .background_kernels import ODDS_STEPS
from .compiled import compiled, exponential, logarithm
from .layer_kernels import colour_distance

_f4 = np.float32

HIGHEST_COVER = 0.97
"""Masks stay below certainty, so that evidence can always win them back."""


CAUTION = 0.2
"""Share of the usual rate at which a mask gives up pixels that show the blob's colours."""

_NOT_YET = _f4(-1e30)


@compiled
def gather(image, log_odds, top, left, planes, odds, free):  # type: ignore[no-untyped-def]
    """Cut planes and log odds (nats) of a box out of the picture; `free` is 1 inside the picture, 0 outside.

    `image` is `(height, width, channels)`, `log_odds` `(height, width)` int8.
    """
    height, width, channels = image.shape
    rows, columns = free.shape
    first, end = max(0, -left), min(columns, width - left)
    for row in range(rows):
        y = top + row
        if y < 0 or y >= height or end <= first:
            free[row] = _f4(0)
            odds[row] = _f4(0)
            planes[:, row] = _f4(0)
            continue
        for x in range(columns):
            if x < first or x >= end:
                free[row, x] = _f4(0)
                odds[row, x] = _f4(0)
                planes[:, row, x] = _f4(0)
        for x in range(first, end):
            free[row, x] = _f4(1)
            odds[row, x] = _f4(log_odds[y, left + x]) * _f4(1 / ODDS_STEPS)
            if channels == 3:
                b, g, r = _f4(image[y, left + x, 0]), _f4(image[y, left + x, 1]), _f4(image[y, left + x, 2])
                grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                planes[0, row, x] = grey
                planes[1, row, x] = _f4(1.426) * (r - grey)
                planes[2, row, x] = _f4(1.128) * (b - grey)
            else:
                planes[0, row, x] = _f4(image[y, left + x, 0])


@compiled
def cover(free, top, left, mask):  # type: ignore[no-untyped-def]
    """Take away from `free` what a mask placed at `(top, left)` in it covers."""
    rows, columns = free.shape
    first, end = max(0, -left), min(mask.shape[1], columns - left)
    for row in range(max(0, -top), min(mask.shape[0], rows - top)):
        for x in range(first, end):
            free[top + row, left + x] *= _f4(1) - mask[row, x]


@compiled
def agreement(
    down, right, step, planes, rivals, free, mask, appearance, half_precision, log_ratio, outliers, distance
):  # type: ignore[no-untyped-def]
    """Sum of log{[M f + (1 - M) b] / b} over every `step`-th row, the blob shifted to `(down, right)` in the patch.

    `rivals` is b, what pixels are without the blob, relative to the uniform density; f its colours' density.
    """
    total = _f4(0)
    columns = mask.shape[1]
    inlying = _f4(1) - outliers
    for row in range(0, mask.shape[0], step):
        colour_distance(planes, down, right, appearance, row, 0, columns, distance)
        covers = mask[row]
        other = rivals[down + row, right : right + columns]
        open_ = free[down + row, right : right + columns]
        part = _f4(0)
        for x in range(columns):
            density = inlying * exponential(log_ratio - half_precision * distance[x]) + outliers
            part += open_[x] * logarithm(_f4(1) + covers[x] * (density * other[x] - _f4(1)))
        total += part
    return total * _f4(step)


@compiled
def search(
    reach, offset_y, offset_x, precision, temper, step, planes, rivals, free, mask, appearance, half_precision,
    log_ratio, outliers,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """Where in the patch the blob is: coarse to fine about `(reach, reach)`, prior and pixels together.

    The prior is a Gaussian of `precision` (1 / px^2) about `(reach + offset_y, reach + offset_x)`; the sum over
    pixels is tempered, for neighbouring pixels are not independent.

    Returns
    -------
    y, x
        px, sub-pixel, from the middle of the patch.
    variance_y, variance_x
        px^2, from the curvature of the pixels' part at the best place.
    """
    distance = np.zeros(mask.shape[1], np.float32)
    best = _NOT_YET
    best_y = best_x = 0
    size = 2 * reach + 1
    scores = np.full((size, size), _NOT_YET, np.float32)
    stride = max(reach // 2, 1)
    centre_y = centre_x = 0
    while True:
        for i in range(-2, 3):
            for j in range(-2, 3):
                y, x = centre_y + i * stride, centre_x + j * stride
                if abs(y) > reach or abs(x) > reach or (stride == 1 and (abs(i) > 1 or abs(j) > 1)):
                    continue
                prior = -0.5 * precision * ((y - offset_y) ** 2 + (x - offset_x) ** 2)
                if scores[reach + y, reach + x] == _NOT_YET:
                    scores[reach + y, reach + x] = temper * agreement(
                        reach + y, reach + x, step, planes, rivals, free, mask, appearance, half_precision,
                        log_ratio, outliers, distance,
                    )  # fmt: skip
                score = scores[reach + y, reach + x] + prior
                if score > best:
                    best, best_y, best_x = score, y, x
        moved = best_y != centre_y or best_x != centre_x
        centre_y, centre_x = best_y, best_x
        if stride > 1:
            stride = max(stride // 2, 1)
        elif not moved:
            break
    fine_y, variance_y = _peak(scores[:, reach + best_x], reach + best_y)
    fine_x, variance_x = _peak(scores[reach + best_y], reach + best_x)
    return best_y + fine_y, best_x + fine_x, variance_y, variance_x


@compiled
def _peak(scores, middle):  # type: ignore[no-untyped-def]
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
def learn(
    planes, odds, free, others, mask, appearance, half_precision, log_ratio, outliers, strength, mask_rate,
    colour_rate, new_mask, new_appearance,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """Shape and colours of a blob after a frame.

    The mask follows what the background's chain says alone (`odds`), slowly where the blob's own colours fit
    too. `others` is what all layers together explain (see `Region.explained`): a
    pixel that another blob explains better is not learned, nor is one that something in front covers.

    Returns
    -------
    total, visible, seen
        mass of the mask, of its part that nothing covers, and of that part that is foreground and its own.
    variance
        mean squared difference of its pixels from the remembered colours, per channel.
    """
    channels = appearance.shape[0]
    rows, columns = mask.shape
    distance = np.zeros(columns, np.float32)
    total = visible = seen = 0.0
    squares = weights = 1e-6
    for row in range(rows):
        colour_distance(planes, 0, 0, appearance, row, 0, columns, distance)
        for x in range(columns):
            covers, open_ = mask[row, x], free[row, x]
            total += covers
            density = (_f4(1) - outliers) * exponential(log_ratio - half_precision * distance[x]) + outliers
            own = strength * open_ * covers * density
            share = min((own + _f4(1)) / others[row, x], _f4(1))
            against = exponential(odds[row, x])
            target = share / (_f4(1) + against)
            # a likely pixel that fits the blob's colours as well as the background's tells little
            doubt = covers > _f4(0.6) and density > _f4(1) and target < covers
            pace = mask_rate * (_f4(CAUTION) if doubt else _f4(1))
            visible += open_ * covers
            seen += open_ * covers * target
            after = covers + pace * open_ * (target - covers)
            new_mask[row, x] = min(max(after, _f4(0)), _f4(HIGHEST_COVER))
            rate = colour_rate if open_ * target > _f4(0.5) else _f4(0)
            if rate > _f4(0) and covers > _f4(0.5):
                squares += distance[x]
                weights += channels
            for channel in range(channels):
                old = appearance[channel, row, x]
                # a pixel that is new to the blob takes the colour that it shows
                blend = _f4(1) if covers < _f4(0.2) and rate > _f4(0) else rate
                new_appearance[channel, row, x] = old + blend * (planes[channel, row, x] - old)
    return total, visible, seen, squares / weights


@compiled
def outline_contrast(planes, picture, free, mask, reach):  # type: ignore[no-untyped-def]
    """Mean contrast across a mask's outline in the image and in the background picture.

    Both are compared `reach` px inside and outside the outline.
    """
    channels, rows, columns = planes.shape
    in_image = in_picture = 0.0
    count = 0
    for y in range(reach, rows - reach):
        for x in range(reach, columns - reach):
            if mask[y, x] <= 0.5:
                continue
            for direction in range(4):
                down = (1, -1, 0, 0)[direction]
                right = (0, 0, 1, -1)[direction]
                if mask[y + down, x + right] > 0.5:
                    continue
                y1, x1 = y - reach * down, x - reach * right
                y2, x2 = y + reach * down, x + reach * right
                if free[y1, x1] < 0.5 or free[y2, x2] < 0.5:
                    continue
                seen = remembered = 0.0
                for channel in range(channels):
                    seen += (planes[channel, y1, x1] - planes[channel, y2, x2]) ** 2
                    remembered += (picture[channel, y1, x1] - picture[channel, y2, x2]) ** 2
                in_image += np.sqrt(seen)
                in_picture += np.sqrt(remembered)
                count += 1
    return in_image / max(count, 1), in_picture / max(count, 1), count


@compiled
def count_foreground(log_odds, width, scale, counts):  # type: ignore[no-untyped-def]
    """Number of foreground pixels (negative log odds) in every block of `scale` x `scale` px."""
    counts[:] = 0
    whole = log_odds.size // 8 * 8
    words = log_odds[:whole].view(np.uint64)
    for start in range(0, log_odds.size, 8):
        if start < whole and words[start // 8] & np.uint64(0x8080808080808080) == np.uint64(0):
            continue
        for i in range(start, min(start + 8, log_odds.size)):
            if log_odds[i] < 0:
                y = i // width
                counts[y // scale, (i - y * width) // scale] += 1

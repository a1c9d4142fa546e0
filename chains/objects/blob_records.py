"""Blobs as records of one table, and loops over them, their masks, and the picture where they are.

Masks of all blobs lie one after the other in one flat array, and so do their colours: of a blob with a patch
of `rows` x `columns` px they begin at `start`, and at `channels * start`, plane by plane. A patch is a small
array; `(top, left)` places it in the picture, over whose edges it may reach.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled
from ...models.pixels.background import ODDS_STEPS
from ...models.pixels.colour import planes_of
from ...models.pixels.layers import Pools

RECORD = np.dtype(
    [
        ("identity", np.int64),  # from 1
        ("position", np.float64, (2,)),  # px, (down, right), of the patch's top left corner
        ("velocity", np.float64, (2,)),  # px/s
        ("covariance", np.float64, (2, 2)),  # of position and velocity along either axis
        ("colour_variance", np.float64),  # squared grey levels: of its colours about the remembered ones
        ("seen", np.float64),  # s for which it was seen
        ("unseen", np.float64),  # s since it was last seen
        ("still", np.float64),  # s for which it has not moved
        ("confidence", np.float64),  # share of its visible part that was seen in the last frame
        ("view", np.float64),  # nats, log ratio of being a ghost and being real, as it is seen now
        ("past_views", np.float64),  # the same by how it was before
        ("fragment_time", np.float64),  # s for which it has been much smaller than a person where it stands
        ("whole", np.int64),  # identity of the object that it is a part of; its own if it is one itself
        ("origin", np.float64, (4,)),  # x, y, width, height px of where it appeared
        ("parting", np.float64),  # s for which it has seemed to be two beside each other
        ("size", np.float64, (2,)),  # px, its usual height and width
        ("existence", np.float64),  # log odds that it is one of those that the detector is made to find
        # of a candidate, if it is no such object: log odds of an error that stays or moves, over nothing
        ("errors", np.float64, (2,)),
        ("noticed", np.float64),  # log odds that the detector finds it at present, if it is in sight
        ("detected", np.int64),  # 1 if the detector has found it; else the next five mean nothing
        ("box_mean", np.float64, (4,)),  # px: foot x and y from the patch's corner, width, height
        ("box_variance", np.float64, (4,)),  # px^2
        ("growth", np.float64),  # 1/s, at which the sides of its box grow, as it comes nearer
        # of the growth: its variance, and covariances with width and height, as shares of these
        ("growth_covariance", np.float64, (3,)),
        ("unfound", np.float64),  # s since a box was last found that may be its
        ("coloured", np.int64),  # 1 if an image has shown its colours
        ("start", np.int64),  # of its pixels
        ("rows", np.int64),  # px, of its patch
        ("columns", np.int64),
        # from here on measured of the mask; rows and columns count within the patch, ends are exclusive
        ("mass", np.float64),  # its sum
        # likely covered; ends are 0 if none is
        *((name, np.int64) for name in ("top", "left", "bottom", "right")),
        *((f"faint_{name}", np.int64) for name in ("top", "left", "bottom", "right")),  # may be covered
        ("waist", np.int64),  # the column where it is narrowest between two upright parts
        ("waist_depth", np.float64),  # its height there as a share of theirs (1: there is none)
    ]
)
"""All that is known of a blob but its pixels, in words of 8 bytes."""

FRESH = 0.5  # s for which a blob was seen, below which it may still be a part of another
MARGIN = 6  # px of empty border in a blob's patch, into which its mask can grow

_f4 = np.float32

LIKELY = 0.45  # probability of cover from which on a pixel counts as part of an object's box
FAINT = 0.25  # probability of cover from which on a mask's patch must leave room around a pixel
THINNEST = 0.08
"""Area over squared length below which a spot is a line (a rope, an edge that shakes) and no object."""

UNKNOWN_COLOUR = -1e4  # in an appearance: no colour is known of this pixel


class Picture(NamedTuple):
    """Frame as loops read it: image, log odds of background with and without shade, and P(B=1)."""

    image: NDArray[np.uint8]
    log_odds: NDArray[np.int8]
    unshaded: NDArray[np.int8]
    prior: np.float32


@compiled
def corner_of(blob):
    """Return top and left px of a blob's patch, as it is rendered."""
    return int(np.floor(blob.position[0] + 0.5)), int(np.floor(blob.position[1] + 0.5))


@compiled
def mask_of(blob, pools):
    """Return the mask `(rows, columns)` of a blob."""
    return pools.masks[blob.start : blob.start + blob.rows * blob.columns].reshape(blob.rows, blob.columns)


@compiled
def colours_of(blob, pools, channels):
    """Return the colours `(channels, rows, columns)` of a blob; no channels where no image has shown them."""
    known = channels if blob.coloured else 0
    start, size = channels * blob.start, blob.rows * blob.columns
    return pools.colours[start : start + known * size].reshape(known, blob.rows, blob.columns)


@compiled
def box_of(blob):
    """Return x, y, width, height px of what the mask likely covers, or else of its patch."""
    y, x = blob.position[0], blob.position[1]
    if blob.bottom == 0 or blob.right == 0:
        return x, y, float(blob.columns), float(blob.rows)
    return x + blob.left, y + blob.top, float(blob.right - blob.left), float(blob.bottom - blob.top)


@compiled
def reported_box_of(blob):
    """Return x, y, width, height px: the detected box, or else that of the mask."""
    if not blob.detected:
        return box_of(blob)
    x, y, width, height = blob.box_mean
    return blob.position[1] + x - 0.5 * width, blob.position[0] + y - height, width, height


@compiled
def length_of(blob):
    """Return the longer side of the box, px."""
    _, _, width, height = reported_box_of(blob)
    return max(width, height)


@compiled
def fill_boxes(blobs, boxes, reported):
    """Write the boxes of all blobs, `(n, 4)` each: of their masks, and as they are reported."""
    for k in range(blobs.size):
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = box_of(blobs[k])
        reported[k, 0], reported[k, 1], reported[k, 2], reported[k, 3] = reported_box_of(blobs[k])


@compiled
def overlap(box, other):
    """Return whether two boxes x, y, width, height overlap."""
    x, y, width, height = box
    left, top, columns, rows = other
    return x < left + columns and left < x + width and y < top + rows and top < y + height


@compiled
def measure(blob, mask, scratch):
    """Write a mask's shape into a blob's record; `scratch` has room for five rows of it."""
    rows, columns = mask.shape
    sums = scratch[: 5 * columns].reshape(5, columns)
    sums[:] = _f4(0)
    per_column, likely, faint, smooth, highest = sums[0], sums[1], sums[2], sums[3], sums[4]
    top, bottom, faint_top, faint_bottom = rows, 0, rows, 0
    for y in range(rows):
        row = mask[y]
        in_row = faint_in_row = _f4(0)
        for x in range(columns):
            value = row[x]
            per_column[x] += value
            is_likely = _f4(1) if value > _f4(LIKELY) else _f4(0)
            is_faint = _f4(1) if value > _f4(FAINT) else _f4(0)
            likely[x] += is_likely
            faint[x] += is_faint
            in_row += is_likely
            faint_in_row += is_faint
        if in_row > 1:
            top, bottom = min(top, y), y + 1
        if faint_in_row > 0:
            faint_top, faint_bottom = min(faint_top, y), y + 1
    left, right, faint_left, faint_right = columns, 0, columns, 0
    for x in range(columns):
        if likely[x] > 1:
            left, right = min(left, x), x + 1
        if faint[x] > 0:
            faint_left, faint_right = min(faint_left, x), x + 1
    for x in range(columns):
        before, after = per_column[max(x - 1, 0)], per_column[min(x + 1, columns - 1)]
        smooth[x] = (before + per_column[x] + after) * _f4(1 / 3)
    most = _f4(0)
    for x in range(columns - 1, -1, -1):
        most = max(most, smooth[x])
        highest[x] = most
    waist, depth, most = 0, _f4(1), _f4(0)
    for x in range(columns):
        most = max(most, smooth[x])
        beside = min(most, highest[x])
        if beside > _f4(0.25) * rows and smooth[x] < depth * beside:
            waist, depth = x, smooth[x] / beside
    mass = 0.0
    for x in range(columns):
        mass += per_column[x]
    blob.mass, blob.waist, blob.waist_depth = mass, waist, depth
    blob.top, blob.left, blob.bottom, blob.right = top, left, bottom, right
    blob.faint_top, blob.faint_left = faint_top, faint_left
    blob.faint_bottom, blob.faint_right = faint_bottom, faint_right


@compiled
def measure_all(blobs, pools, scratch):
    """Measure the masks of blobs (see `measure`)."""
    for k in range(blobs.size):
        measure(blobs[k], mask_of(blobs[k], pools), scratch)


def measured(mask: NDArray[np.float32], record: np.void | None = None) -> np.void:
    """Return a new record, or a copy of one, with the shape of a mask `(height, width)` float32."""
    table, nothing = np.zeros(1, RECORD) if record is None else np.array([record]), np.zeros(0, np.float32)
    table["start"], table["rows"], table["columns"] = 0, *mask.shape
    flat = np.ascontiguousarray(mask).reshape(-1)
    measure_all(table, Pools(flat, nothing), np.empty(5 * mask.shape[1], np.float32))
    found: np.void = table[0]
    return found


@compiled
def fade_beyond(mask, height, width, kept, scratch):
    """Scale a mask by `kept`, in place, further from its median than half of `height`, `width` px and 2."""
    rows, columns = mask.shape
    per_row, per_column = scratch[:rows], scratch[rows : rows + columns]
    scratch[: rows + columns] = _f4(0)
    for y in range(rows):
        row = mask[y]
        in_row = _f4(0)
        for x in range(columns):
            in_row += row[x]
            per_column[x] += row[x]
        per_row[y] = in_row
    middle_y, middle_x = _median(per_row), _median(per_column)
    for y in range(rows):
        far_row = abs(y - middle_y) > 0.5 * height + 2
        for x in range(columns):
            if far_row or abs(x - middle_x) > 0.5 * width + 2:
                mask[y, x] *= kept


@compiled
def _median(masses):
    half = 0.5 * masses.sum()
    total = 0.0
    for k in range(masses.size):
        total += masses[k]
        if total >= half:
            return k
    return masses.size - 1


class Patch(NamedTuple):
    """Part of the picture in a box, all float32.

    Planes, log odds of background in nats, and what nothing else covers (0 outside the picture).
    """

    planes: NDArray[np.float32]
    log_odds: NDArray[np.float32]
    free: NDArray[np.float32]


@compiled
def patch_in(scratch, channels, rows, columns):
    """Return a patch whose memory is the beginning of `scratch` `(n,)`, and the rest of it."""
    size = rows * columns
    planes = scratch[: channels * size].reshape(channels, rows, columns)
    odds = scratch[channels * size : (channels + 1) * size].reshape(rows, columns)
    free = scratch[(channels + 1) * size : (channels + 2) * size].reshape(rows, columns)
    return Patch(planes, odds, free), scratch[(channels + 2) * size :]


@compiled
def gather(image, log_odds, top, left, patch):
    """Cut a box out of a picture `(height, width, channels)` and int8 log odds `(height, width)`."""
    planes, odds, free = patch
    height, width, channels = image.shape
    rows, columns = free.shape
    first, end = min(max(0, -left), columns), max(min(columns, width - left), 0)
    first_row, end_row = min(max(0, -top), rows), max(min(rows, height - top), 0)
    if first >= end:
        end_row = first_row
    for row in range(rows):
        if row < first_row or row >= end_row or end - first < columns:
            free[row] = _f4(0)
            odds[row] = _f4(0)
            planes[:, row] = _f4(0)
    pixels, steps = image.reshape(-1), log_odds.reshape(-1)
    # Rows inside the picture only. Compiled code looks first whether all that the loop reads is apart from
    # what it writes, and goes another way, with other last digits, if it is not. With rows beyond the picture
    # that would depend on what lies behind it in memory.
    for row in range(first_row, end_row):
        free[row, first:end] = _f4(1)
        start, count = np.uint64((top + row) * width + left + first), np.uint64(end - first)
        out = odds[row, first:end]
        for x in range(count):
            out[x] = _f4(steps[start + x]) * _f4(1 / ODDS_STEPS)
        luma = planes[0, row, first:end]
        if channels == 3:
            red, blue = planes[1, row, first:end], planes[2, row, first:end]
            for x in range(count):
                k = np.uint64(3) * (start + x)
                one, two = np.uint64(1), np.uint64(2)
                luma[x], red[x], blue[x] = planes_of(pixels[k], pixels[k + one], pixels[k + two])
        else:
            for x in range(count):
                luma[x] = _f4(pixels[start + x])


@compiled
def cover(free, top, left, mask):
    """Take away from `free` what a mask placed at `(top, left)` in it covers."""
    rows, columns = free.shape
    first, end = max(0, -left), min(mask.shape[1], columns - left)
    for row in range(max(0, -top), min(mask.shape[0], rows - top)):
        for x in range(first, end):
            free[top + row, left + x] *= _f4(1) - mask[row, x]


@compiled
def cover_by(free, top, left, blobs, pools):
    """Take away from `free`, placed at `(top, left)` in the picture, what blobs cover."""
    rows, columns = free.shape
    for k in range(blobs.size):
        y, x = corner_of(blobs[k])
        down, right = y - top, x - left
        if -blobs[k].rows < down < rows and -blobs[k].columns < right < columns:
            cover(free, down, right, mask_of(blobs[k], pools))


@compiled
def colour_newborn(blob, pools, image):
    """Give a blob the colours that the picture shows where it likely is."""
    height, width, channels = image.shape
    top, left = corner_of(blob)
    blob.coloured = 1
    mask, colours = mask_of(blob, pools), colours_of(blob, pools, channels)
    pixels = image.reshape(-1)
    for row in range(blob.rows):
        for x in range(blob.columns):
            inside = 0 <= top + row < height and 0 <= left + x < width
            likely = mask[row, x] > _f4(0.2)
            k = channels * ((top + row) * width + left + x)
            if inside and likely and channels == 3:
                luma, red, blue = planes_of(pixels[k], pixels[k + 1], pixels[k + 2])
                colours[0, row, x], colours[1, row, x], colours[2, row, x] = luma, red, blue
            else:
                shown = _f4(pixels[k]) if inside else _f4(0)
                colours[:, row, x] = shown if likely else _f4(UNKNOWN_COLOUR)


@compiled
def move(blobs, dt, noise, acceleration, detected_acceleration):
    """Predict places and velocities `dt` seconds ahead, in place.

    `noise` `(2, 2)` is the covariance of the step for a density of 1 (see `kalman.kinematic`).
    """
    for k in range(blobs.size):
        blob = blobs[k]
        force = (detected_acceleration if blob.detected else acceleration) * length_of(blob)
        density = 0.5 * force * force  # px^2/s^3
        blob.position[0] += dt * blob.velocity[0]
        blob.position[1] += dt * blob.velocity[1]
        place, both, speed = blob.covariance[0, 0], blob.covariance[0, 1], blob.covariance[1, 1]
        blob.covariance[0, 0] = place + 2 * dt * both + dt * dt * speed + density * noise[0, 0]
        blob.covariance[0, 1] = blob.covariance[1, 0] = both + dt * speed + density * noise[0, 1]
        blob.covariance[1, 1] = speed + density * noise[1, 1]


@compiled
def _are_pieces(one, other):
    """Whether two blobs, the second seen for no longer, are parts of one object.

    What touches a blob right after it was born belongs to it if it is above, below or small, and the two
    together are not much larger than the larger (or the first is as new); so do blobs that have stood still
    above each other for a while, or that move alike above each other and make one upright body together. What
    a detector has found is whole.
    """
    if one.detected and other.detected:
        return False
    x, y, width, height = box_of(one)
    other_x, other_y, other_width, other_height = box_of(other)
    gap_y = max(y, other_y) - min(y + height, other_y + other_height)
    gap_x = max(x, other_x) - min(x + width, other_x + other_width)
    if max(gap_x, gap_y) > 3:
        return False
    wide = max(x + width, other_x + other_width) - min(x, other_x)
    tall = max(y + height, other_y + other_height) - min(y, other_y)
    stacked = -gap_x > 0.7 * min(width, other_width)
    if other.seen >= FRESH:
        apart = np.hypot(one.velocity[0] - other.velocity[0], one.velocity[1] - other.velocity[1])
        one_body = -gap_y < 0.2 * min(height, other_height) and tall < 3.2 * wide and apart < 0.2 * tall
        return stacked and (one_body or min(one.still, other.still) > 1.5)
    modest = tall < 1.6 * max(height, other_height) and wide < 1.6 * max(width, other_width)
    larger = max(width * height, other_width * other_height)
    small = min(width * height, other_width * other_height) < 0.35 * larger
    return (stacked or small) and (one.seen < FRESH or modest)


@compiled
def _hold(one, other):
    """Let a blob's record hold a piece: its patch and box reach around both, but not its mask's sums."""
    top, left = corner_of(one)
    other_top, other_left = corner_of(other)
    down, right = other_top - top, other_left - left
    above, beside = max(-down, 0), max(-right, 0)
    one_likely, other_likely = one.bottom > 0 and one.right > 0, other.bottom > 0 and other.right > 0
    first, begin, last, end = other.top + down, other.left + right, other.bottom + down, other.right + right
    if one_likely and other_likely:
        first, begin = min(one.top, first), min(one.left, begin)
        last, end = max(one.bottom, last), max(one.right, end)
    elif one_likely:
        first, begin, last, end = one.top, one.left, one.bottom, one.right
    if one_likely or other_likely:
        one.top, one.left, one.bottom, one.right = first + above, begin + beside, last + above, end + beside
    one.rows = max(one.rows, down + other.rows) + above
    one.columns = max(one.columns, right + other.columns) + beside
    one.position[0] -= above
    one.position[1] -= beside
    if one.detected:
        one.box_mean[0] += beside
        one.box_mean[1] += above
    if one.seen < FRESH:
        x, y, width, height = one.origin
        other_x, other_y, other_width, other_height = other.origin
        one.origin[0], one.origin[1] = min(x, other_x), min(y, other_y)
        one.origin[2] = max(x + width, other_x + other_width) - one.origin[0]
        one.origin[3] = max(y + height, other_y + other_height) - one.origin[1]
    one.seen = max(one.seen, other.seen)


@compiled
def gather_pieces(blobs, wholes):
    """Write into `wholes` `(n,)` the index of the first blob that each is a piece of, or its own.

    The records of the wholes hold their pieces (see `_hold`), which grow with each.
    """
    for k in range(blobs.size):
        wholes[k] = k
        for j in range(k):
            if wholes[j] == j and _are_pieces(blobs[j], blobs[k]):
                wholes[k] = j
                _hold(blobs[j], blobs[k])
                break

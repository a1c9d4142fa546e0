"""What a frame teaches of blobs: shape, colours, size, which are ghosts, which live on, and which are new.

A ghost is a blob in whose place nothing stands, but the background's picture shows something that has gone.
Of a blob two things may be true: something real stands there, or it is a ghost. With colours a right inside
of its outline and b right outside, in the image I and in the background's picture B,

    p(I, B | real)  = prod_k  u_I  f_B(a_B - b_B)
    p(I, B | ghost) = prod_k  f_I(a_I - b_I)  u_B

f: a contrast within the scene, log-logistic about its median, which is measured a little further outside, in
the image (with its noise) and in the picture; u: any contrast, as likely as the scene's own on average, so
that scenes without an edge speak for neither. Neighbours along an outline are not independent, so the log
ratio of both is tempered; nor are looks at the same outline: a blob that stays as it is has one such view.
As it travels, each of its own lengths brings another one, and speaks for itself: a ghost does not travel.
Only lengths count by which it has left the place where it appeared, since there it may have been taken for
one thing with its ghost. What was found on the way stays for the blob's life.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.identities import find
from ...models.numerics.compiled import compiled, exponential, logarithm, put
from ...models.numerics.threads import side_by_side, thread_count
from ...models.objects.box_message import HEIGHT, WIDTH, BoxMessage
from ...models.pixels.background import ODDS_STEPS, SPAN, StoredPlanes, blocks_along, foreground_spans
from ...models.pixels.layers import LayerStack
from ...models.pixels.pixel_labels import PixelMessage
from .blob_records import (
    FRESH,
    MARGIN,
    THINNEST,
    UNKNOWN_COLOUR,
    Patch,
    box_of,
    colour_newborn,
    colours_of,
    corner_of,
    cover_by,
    fade_beyond,
    gather,
    length_of,
    mask_of,
    measure,
    overlap,
    patch_in,
)
from .blobs import MOST_EVIDENCE, Blob, Blobs, Map, Numbers
from .registration import make_picture, sprite_of

_f4 = np.float32

REACH = 2  # px to either side of an outline, which is as exact as that
LEAST_OUTLINE = 8  # px of an outline, from which on it tells something

_TOGETHER = 8  # ratios of contrasts that are multiplied before their logarithm is taken

_BLOCK = 256  # px, of which a sum is one of float32

HIGHEST_COVER = 0.97  # masks stay below certainty, so that evidence can always win them back
GROWTH = 1.3  # how far beyond its usual size a mask may reach

BENEFIT_OF_DOUBT = 0.6
"""What the mask of a still blob keeps of pixels that fit its colours as well as the background's."""

LEAST_MASK = 0.1  # of a mask's mass, which must be in the picture
TRAVELLED = -5.0  # nats, log ratio of ghost and real for each own length that something travels


@compiled
def _mark_outline(mask, row, first, end, flags):
    """Mark the pixels of a row that are likelier than not the object's, beside one that is not."""
    here, above, below = mask[row, first:end], mask[row - 1, first:end], mask[row + 1, first:end]
    before, after, marked = mask[row, first - 1 : end - 1], mask[row, first + 1 : end + 1], flags[first:end]
    for x in range(here.size):
        least = min(min(above[x], below[x]), min(before[x], after[x]))
        marked[x] = np.uint8((here[x] > _f4(0.5)) & (least <= _f4(0.5)))


@compiled
def outline_contrasts(planes, top, left, other, free, mask, within, reach, out):
    """Measure contrasts across a mask's outline, and right outside of it, in two pictures, grey levels.

    They compare colours `reach` px inside of every step of the outline (right inside, where the mask is
    thinner) and as far outside, and the latter with one twice as far again. Steps whose three places are not
    all free are left out. The first picture `(channels, height, width)` is cut out where the mask is, which
    lies at `(top, left)` of the `other` one; `within` are the top, left, bottom and right of the mask's part
    that may be likely. Gives how many columns of `out` `(4, n)` were filled: across and outside in either
    picture.
    """
    channels, rows, columns = planes.shape
    count = 0
    first, end = max(within[1], reach), min(within[3], columns - reach)
    flags = np.zeros(columns, np.uint8)
    for y in range(max(within[0], reach), min(within[2], rows - reach)):
        _mark_outline(mask, y, first, end, flags)
        for x in range(first, end):
            if not flags[x]:
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
                if count == out.shape[1]:
                    return count
                across = outside = other_across = other_outside = _f4(0)
                for channel in range(channels):
                    middle = planes[channel, y2, x2]
                    across += (planes[channel, y1, x1] - middle) ** 2
                    outside += (planes[channel, y3, x3] - middle) ** 2
                    middle = _f4(other.values[channel, top + y2, left + x2])
                    other_across += (_f4(other.values[channel, top + y1, left + x1]) - middle) ** 2
                    other_outside += (_f4(other.values[channel, top + y3, left + x3]) - middle) ** 2
                out[0, count], out[1, count] = np.sqrt(across), np.sqrt(outside)
                out[2, count] = other.step * np.sqrt(other_across)
                out[3, count] = other.step * np.sqrt(other_outside)
                count += 1
    return count


@compiled
def _median(values, order):
    put(values, order)
    low, high, middle = 0, values.size - 1, values.size // 2
    while low < high:
        pivot = order[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while order[i] < pivot:
                i += 1
            while order[j] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if values.size % 2:
        return float(order[middle])
    below = order[0]
    for i in range(middle):
        below = max(below, order[i])
    return 0.5 * (float(order[middle]) + float(below))


@compiled
def _surprise(across, beside, order):
    """How much less likely contrasts across an outline are than those beside it, by the density of these."""
    scale = _median(beside, order) + 1
    total, ratio = 0.0, 1.0
    for k in range(across.size):
        ratio *= (scale + across[k]) / (scale + beside[k])
        if k % _TOGETHER == _TOGETHER - 1:
            total += np.log(ratio)
            ratio = 1.0
    return 2 * (total + np.log(ratio))


@compiled
def outline_evidence(planes, top, left, picture, free, mask, within, scratch):
    """Return the log ratio of ghost and real, nats, summed over an outline as if pixels were independent."""
    most = scratch.size // 5
    out, order = scratch[: 4 * most].reshape(4, most), scratch[4 * most : 5 * most]
    count = outline_contrasts(planes, top, left, picture, free, mask, within, REACH, out)
    if count < LEAST_OUTLINE:
        return 0.0
    seen = _surprise(out[0, :count], out[1, :count], order[:count])
    return _surprise(out[2, :count], out[3, :count], order[:count]) - seen


class Scene(NamedTuple):
    """A frame beside its picture: background, composed layers, and expected sizes."""

    background: StoredPlanes  # picture of the empty scene
    regions: NDArray[np.int64]  # (n, 4); see `Composition`
    starts: NDArray[np.int64]  # (n,)
    explained: NDArray[np.float32]  # of their pixels
    # (n, 2) px, heights and widths as they are usual for blobs, and expected by others
    sizes: NDArray[np.float64]


class Learning(NamedTuple):
    """Parameters by which blobs learn; those without a comment are of `Matching` and `BlobTracker`."""

    log_uniform: float
    elapsed: float
    mask_share: float  # by which a mask, or the size of a fresh blob, follows the last frame
    colour_share: float
    view_share: float
    size_share: float
    kept: float  # what a mask keeps where it reaches too far
    least_area: float  # px
    outliers: float
    strength: float
    colour_variance: float
    likelihood_power: float
    ghost_threshold: float
    confirmation_time: float
    max_coast_time: float
    max_hidden_time: float


@compiled
def is_ghost(blob, limit):
    """Return whether the outlines of a blob say that no object is there; a detected one never is a ghost."""
    real = max(blob.existence, 0.0) if blob.detected else 0.0
    return min(blob["view"], MOST_EVIDENCE) + blob.past_views - real >= limit


@compiled
def fit(blobs, limit):
    """Give blobs patches with room for their masks to grow; ghosts do not grow."""
    total = 0
    for k in range(blobs.size):
        blob = blobs[k]
        rows, columns = blob.rows, blob.columns
        above, left = blob.faint_top, blob.faint_left
        room_below, room_right = rows - blob.faint_bottom, columns - blob.faint_right
        least = min(min(above, left), min(room_below, room_right))
        most = max(max(above, left), max(room_below, room_right))
        empty = blob.faint_bottom == 0 or blob.faint_right == 0
        if not (empty or is_ghost(blob, limit) or (least >= MARGIN // 2 and most <= 3 * MARGIN)):
            down, right = above - MARGIN, left - MARGIN
            blob.rows = blob.faint_bottom - above + 2 * MARGIN
            blob.columns = blob.faint_right - left + 2 * MARGIN
            blob.position[0] += down
            blob.position[1] += right
            if blob.detected:
                blob.box_mean[0] -= right
                blob.box_mean[1] -= down
            if blob.bottom > 0 and blob.right > 0:
                blob.top, blob.bottom = blob.top - down, blob.bottom - down
                blob.left, blob.right = blob.left - right, blob.right - right
        blob.start = total
        total += blob.rows * blob.columns
    return total


@compiled
def learn(
    patch, explained, sprite, strength, mask_share, colour_share, least_kept, new_mask, new_appearance, rates
):
    """Update shape and colours of a blob after a frame.

    The mask follows what the background's chain says alone (log odds), but keeps `least_kept` of likely
    pixels that fit the blob's own colours as well; of pixels that it loses, the colours are forgotten. A
    pixel that another blob explains better (`explained` is by all layers together) is not learned, nor is one
    that something in front covers. `rates` is memory for a number a pixel. Gives the mass of the mask, of its
    part that nothing covers, of that part that is foreground and its own, and the mean squared difference of
    its pixels from the remembered colours, per channel.
    """
    channels, size = sprite.appearance.shape[0], sprite.mask.size
    shown, own_odds, free = patch.planes.reshape(-1), patch.log_odds.reshape(-1), patch.free.reshape(-1)
    mask, own, all_layers = sprite.mask.reshape(-1), sprite.appearance.reshape(-1), explained.reshape(-1)
    out, new = new_mask.reshape(-1), new_appearance.reshape(-1)
    # no branch within a loop, which would be no vector code then
    chroma = _f4(1) if channels == 3 else _f4(0)
    red = np.uint64(size * (channels // 3))
    blue = np.uint64(2) * red
    half_precision, log_ratio, outliers = sprite.half_precision, sprite.log_ratio, sprite.outliers
    inlying = _f4(1) - outliers
    total = visible = seen = 0.0
    squares = inside = 1e-6
    for start in range(0, size, _BLOCK):
        sum_covers = sum_open = sum_seen = sum_squares = sum_inner = _f4(0)
        for i in range(np.uint64(start), np.uint64(min(start + _BLOCK, size))):
            d0 = shown[i] - own[i]
            d1, d2 = shown[i + red] - own[i + red], shown[i + blue] - own[i + blue]
            distance = d0 * d0 + chroma * (d1 * d1 + d2 * d2)
            density = inlying * exponential(log_ratio - half_precision * distance) + outliers
            covers, open_ = mask[i], free[i]
            clear = open_ * covers
            share = min((strength * clear * density + _f4(1)) / all_layers[i], _f4(1))
            target = share / (_f4(1) + exponential(own_odds[i]))
            sum_covers += covers
            sum_open += clear
            sum_seen += clear * target
            # a likely pixel that fits the blob's colours as well as the background's tells nothing
            doubt = (covers > _f4(0.35)) & (density > _f4(1))
            least = least_kept if doubt else _f4(0)
            after = covers + mask_share * open_ * (max(target, least) - covers)
            out[i] = min(max(after, _f4(0)), _f4(HIGHEST_COVER))
            # a pixel that is new to the blob takes the colour that it shows
            rate = _f4(1) if (covers < _f4(0.2)) & (colour_share > _f4(0)) else colour_share
            taken = open_ * target > _f4(0.5)
            rates[i] = rate if taken else _f4(0)
            inner = _f4(1) if taken & (covers > _f4(0.5)) else _f4(0)
            sum_squares += inner * distance
            sum_inner += inner
        total += sum_covers
        visible += sum_open
        seen += sum_seen
        squares += sum_squares
        inside += sum_inner
    for channel in range(channels):
        plane = np.uint64(channel * size)
        for i in range(np.uint64(size)):
            colour = own[plane + i] + rates[i] * (shown[plane + i] - own[plane + i])
            new[plane + i] = _f4(UNKNOWN_COLOUR) if out[i] < _f4(0.1) else colour
    return total, visible, seen, squares / (inside * channels)


@compiled
def scratch_for_learning(blobs, channels):
    """Return how many numbers of scratch `learn_all` needs for the largest of some blobs."""
    most = columns = 0
    for k in range(blobs.size):
        most = max(most, blobs[k].rows * blobs[k].columns)
        columns = max(columns, blobs[k].rows + 5 * blobs[k].columns)
    return most * (2 * channels + 24) + columns


@compiled
def _refitted(blob, before, old, channels, scratch):
    """Mask and colours of a blob in its new patch, and what is left of scratch."""
    size = blob.rows * blob.columns
    (new_top, new_left), (top, left) = corner_of(blob), corner_of(before)
    mask, colours = mask_of(before, old), colours_of(before, old, channels)
    same = new_top == top and new_left == left and blob.rows == before.rows and blob.columns == before.columns
    if same and blob.coloured:
        return mask, colours, scratch
    maps = scratch[: (1 + channels) * size].reshape(1 + channels, blob.rows, blob.columns)
    first, end = max(new_left, left), min(new_left + blob.columns, left + before.columns)
    for row in range(blob.rows):
        y = new_top + row - top
        if not 0 <= y < before.rows:
            maps[0, row] = _f4(0)
            maps[1:, row] = _f4(UNKNOWN_COLOUR)
            continue
        if end - first < blob.columns:
            maps[0, row] = _f4(0)
            maps[1:, row] = _f4(UNKNOWN_COLOUR)
        put(mask[y, first - left : end - left], maps[0, row, first - new_left : end - new_left])
        for channel in range(colours.shape[0]):
            part = colours[channel, y, first - left : end - left]
            put(part, maps[1 + channel, row, first - new_left : end - new_left])
    return maps[0], maps[1:], scratch[(1 + channels) * size :]


@compiled
def _set_explained(scene, top, left, out):
    """What all layers together explain of the pixels in a box, 1 where there is none."""
    rows, columns = out.shape
    out[:] = _f4(1)
    for k in range(scene.starts.size):
        its_top, its_left, its_rows, its_columns = scene.regions[k]
        first, end = max(left, its_left), min(left + columns, its_left + its_columns)
        if first >= end:
            continue
        for y in range(max(top, its_top), min(top + rows, its_top + its_rows)):
            start = scene.starts[k] + (y - its_top) * its_columns - its_left
            part = out[y - top, first - left : end - left]
            values = scene.explained[start + first : start + end]
            for x in range(part.size):
                part[x] = values[x]


@compiled
def _contest_shade(unshaded, top, left, explained, log_odds):
    """Take from the log odds of a box what shade adds where objects explain as well what is seen.

    Each pixel shows the scene, the scene in shade, or an object with its mask and colours as they are known.
    """
    rows, columns = log_odds.shape
    for y in range(max(top, 0), min(top + rows, unshaded.shape[0])):
        for x in range(max(left, 0), min(left + columns, unshaded.shape[1])):
            plain, odds = _f4(unshaded[y, x]) * _f4(1 / ODDS_STEPS), log_odds[y - top, x - left]
            if odds > plain:
                contested = odds - logarithm(max(explained[y - top, x - left], _f4(1)))
                log_odds[y - top, x - left] = max(plain, contested)


@compiled
def _inside(top, left, rows, columns, height, width):
    """Rows and columns of a patch that lie in the picture: first and end of either."""
    return (
        min(max(0, -top), rows),
        max(0, min(rows, height - top)),
        min(max(0, -left), columns),
        max(0, min(columns, width - left)),
    )


@compiled
def _learn_entered(mask, colours, patch, explained, inside, before):
    """Where a blob has come into the picture it was never seen before: learned at once, as of a newborn."""
    for row in range(inside[0], inside[1]):
        for x in range(inside[2], inside[3]):
            if before[0] <= row < before[1] and before[2] <= x < before[3]:
                continue
            odds = _f4(1) + exponential(patch.log_odds[row, x])
            new = min(_f4(0.9), patch.free[row, x] / (explained[row, x] * odds))
            if new > _f4(0.2) and new > mask[row, x]:
                mask[row, x] = new
                for channel in range(colours.shape[0]):
                    colours[channel, row, x] = patch.planes[channel, row, x]


@compiled
def _mass_inside(mask, inside):
    total = 0.0
    for row in range(inside[0], inside[1]):
        in_row = _f4(0)
        for x in range(inside[2], inside[3]):
            in_row += mask[row, x]
        total += in_row
    return total


@compiled
def _is_hidden(blob, mask, in_front, pools, scratch):
    """Whether others cover most of a blob."""
    free = scratch[: mask.size].reshape(mask.shape)
    free[:] = _f4(1)
    top, left = corner_of(blob)
    cover_by(free, top, left, in_front, pools)
    covers, open_ = mask.reshape(-1), free.reshape(-1)
    total = clear = _f4(0)
    for i in range(covers.size):
        total += covers[i]
        clear += covers[i] * open_[i]
    return clear < _f4(0.5) * total


@compiled
def _lives(blob, mask, inside, in_front, pools, rule, scratch):
    """Whether a blob lives on: it is large and thick enough, in the picture, and was seen lately."""
    if blob.detected:
        return True
    thin = blob.mass < THINNEST * length_of(blob) ** 2 * (1.0 if blob.seen < FRESH else 0.5)
    whole = inside[1] - inside[0] == blob.rows and inside[3] - inside[2] == blob.columns
    outside = not whole and _mass_inside(mask, inside) < LEAST_MASK * blob.mass
    if thin or outside or blob.mass < rule.least_area:
        return False
    if blob.seen < rule.confirmation_time:
        return blob.unseen == 0.0
    hidden = blob.unseen > 0 and _is_hidden(blob, mask, in_front, pools, scratch)
    return blob.unseen < (rule.max_hidden_time if hidden else rule.max_coast_time)


@compiled
def weigh(blob, evidence, box, length, rule):
    """Add what the outline says of ghost and real (nats): as it is now, and over the way so far."""
    blob["view"] += (evidence - blob["view"]) * rule.view_share
    if overlap(box, (blob.origin[0], blob.origin[1], blob.origin[2], blob.origin[3])):
        return
    lengths = rule.elapsed * np.hypot(blob.velocity[0], blob.velocity[1]) / length
    past = blob.past_views + lengths * (blob["view"] + TRAVELLED)
    blob.past_views = min(max(past, -MOST_EVIDENCE), MOST_EVIDENCE)


@compiled
def _note_seen(blob, variance, box, length, rule):
    """Update colour variance, size, origin and times of a blob that was seen; `box` is the one before."""
    speed = np.hypot(blob.velocity[0], blob.velocity[1])
    after = blob.colour_variance + rule.colour_share * (2 * variance - blob.colour_variance)
    blob.colour_variance = min(max(after, 0.2 * rule.colour_variance), rule.colour_variance)
    grown = rule.mask_share if blob.seen < FRESH else rule.size_share
    blob.size[0] += grown * (box[3] - blob.size[0])
    blob.size[1] += grown * (box[2] - blob.size[1])
    if blob.seen < FRESH:
        x, y, width, height = blob.origin
        left, top = min(x, box[0]), min(y, box[1])
        right, bottom = max(x + width, box[0] + box[2]), max(y + height, box[1] + box[3])
        blob.origin[0], blob.origin[1], blob.origin[2], blob.origin[3] = left, top, right - left, bottom - top
    blob.still = blob.still + rule.elapsed if speed < max(2.0, 0.06 * length) else 0.0
    blob.seen += rule.elapsed
    blob.unseen = 0.0


@compiled
def learn_all(which, before, old, blobs, pools, picture, scene, rule, alive, scratch):
    """Update some blobs after a frame, each for itself.

    `which` `(m,)` are their numbers. `before` and `old` are records and pools of all blobs, front to back, as
    they are placed; `blobs` and `pools` the same records with fitted patches (see `fit`), which change, and
    pools to be filled. `alive` `(n,)` uint8 gets 1 where a blob lives on; `scratch` has
    `scratch_for_learning` numbers.
    """
    height, width, channels = picture.image.shape
    for k in which:
        blob, size = blobs[k], blobs[k].rows * blobs[k].columns
        mask = mask_of(blob, pools)
        covers, own, rest = _refitted(blob, before[k], old, channels, scratch)
        top, left = corner_of(blob)
        inside = _inside(top, left, blob.rows, blob.columns, height, width)
        if is_ghost(before[k], rule.ghost_threshold):
            put(covers.reshape(-1), mask.reshape(-1))
            colours = colours_of(blob, pools, channels).reshape(-1)
            put(own.reshape(-1)[: colours.size], colours)
            blob.unseen = np.inf
            alive[k] = blob.detected
            continue
        patch, rest = patch_in(rest, channels, blob.rows, blob.columns)
        gather(picture.image, picture.log_odds, top, left, patch)
        cover_by(patch.free, top, left, before[:k], old)
        explained, rest = rest[:size].reshape(blob.rows, blob.columns), rest[size:]
        _set_explained(scene, top, left, explained)
        _contest_shade(picture.unshaded, top, left, explained, patch.log_odds)
        if not blob.coloured:
            blob.coloured = 1
            for row in range(blob.rows):
                for x in range(blob.columns):
                    if covers[row, x] > _f4(0.2):
                        for channel in range(channels):
                            own[channel, row, x] = patch.planes[channel, row, x]
        colours = colours_of(blob, pools, channels)
        total, visible, seen, variance = learn(
            patch, explained, sprite_of(blob, covers, own, rule), _f4(rule.strength),
            _f4(rule.mask_share), _f4(rule.colour_share),
            _f4(BENEFIT_OF_DOUBT if blob.still > 0.2 else 0.0), mask, colours, rest,
        )  # fmt: skip
        box, length = box_of(blob), length_of(blob)
        y = int(np.floor(blob.position[0] - rule.elapsed * blob.velocity[0] + 0.5))
        x = int(np.floor(blob.position[1] - rule.elapsed * blob.velocity[1] + 0.5))
        inside_before = _inside(y, x, blob.rows, blob.columns, height, width)
        entered = inside != inside_before
        if entered:
            _learn_entered(mask, colours, patch, explained, inside, inside_before)
        elif blob.seen >= FRESH:
            high, wide = GROWTH * scene.sizes[k, 0], GROWTH * scene.sizes[k, 1]
            fade_beyond(mask, high, wide, _f4(rule.kept), rest)
        blob.confidence = seen / max(visible, 1e-6)
        measure(blob, mask, rest)
        was_seen = visible > 0.3 * total and blob.confidence > 0.35
        if was_seen:
            within = (blob.faint_top, blob.faint_left, blob.faint_bottom, blob.faint_right)
            found = outline_evidence(
                patch.planes, top, left, scene.background, patch.free, mask, within, rest
            )
            weigh(blob, rule.likelihood_power * found, box, length, rule)
            _note_seen(blob, variance, box, length, rule)
        else:
            blob.unseen += rule.elapsed
            blob.still = blob.confidence = 0.0
        if was_seen and entered:
            blob.size[0] = max(blob.size[0], float(max(blob.bottom - blob.top, 1)))
            blob.size[1] = max(blob.size[1], float(max(blob.right - blob.left, 1)))
        alive[k] = _lives(blob, mask, inside, before[:k], old, rule, rest)


Spot = list[int]
"""Top, left, bottom, right px."""

COVERED = 0.2  # probability from which on a pixel is a blob's
BLOCKS = 192  # along the longer side of a picture, in which spots are looked for
MOST_SPOTS = 256  # in one frame
VIEW_TIME = 0.4  # s over which a view is averaged: masks err for a while in the same way


class BlobScene:
    """Frame in which blobs are updated: pixels, layers of all blobs, and the other chains' boxes.

    `elapsed` s have passed since the last frame with an image.
    """

    def __init__(
        self, pixels: PixelMessage, layers: LayerStack, boxes: BoxMessage | None, elapsed: float
    ) -> None:
        self.pixels = pixels
        self.size = pixels.size
        self.elapsed = elapsed
        self.newcomers = None if boxes is None else boxes.newcomers
        self.picture = make_picture(pixels)
        self._layers = layers
        self._objects = None if boxes is None else boxes.objects

    def expected_sizes(self, blobs: Blobs) -> Numbers:
        """Return `(n, 2)` px, usual height and width, fused with other chains' predictions."""
        sizes: Numbers = np.ascontiguousarray(blobs.table["size"])
        if self._objects is None or not len(blobs):
            return sizes
        identities, means, covariances = self._objects.moments
        if not len(identities):
            return sizes
        place, known = find(identities, blobs.table["identity"])
        sides = [HEIGHT, WIDTH]
        expected, variance = means[place][:, sides], covariances[place][:, sides, sides]
        own, others = 1 / (0.15 * sizes) ** 2, 1 / np.maximum(variance, 1.0)
        both = (own * sizes + others * expected) / (own + others)
        return np.where(known[:, None], np.maximum(both, 0.5 * sizes), sizes)

    def learn_blobs(self, blobs: Blobs, rule: Learning) -> tuple[Blobs, NDArray[np.bool_]]:
        """Return blobs, given front to back, after the frame, and `(n,)` whether each is kept."""
        before, table, channels = blobs.table, blobs.table.copy(), blobs.channels
        total = fit(table, rule.ghost_threshold)
        masks, colours = np.empty(total, np.float32), np.empty(channels * total, np.float32)
        alive = np.empty(len(table), np.uint8)
        after = replace(blobs.with_table(table), masks=masks, colours=colours)
        composed = self._layers.composition(self.pixels.image, self.size)
        background = self.pixels.background
        assert background is not None
        scene = Scene(
            background.colours,
            composed.regions,
            composed.starts,
            composed.explained,
            self.expected_sizes(blobs),
        )
        room, count = scratch_for_learning(table, channels), min(thread_count(), len(table))

        def work(first: int) -> None:
            which, scratch = np.arange(first, len(table), count), np.empty(room, np.float32)
            learn_all(
                which, before, blobs.pools, table, after.pools, self.picture, scene, rule, alive, scratch
            )

        side_by_side([partial(work, first) for first in range(count)])
        return after, alive.astype(bool)

    def colour_newborns(self, blobs: Blobs, first: int) -> None:
        """Set the colours of new blobs, those from `first` on, from the image."""
        for record in blobs.table[first:]:
            colour_newborn(record, blobs.pools, self.picture.image)

    def shows(self, mask: Map, top: int, left: int) -> bool:
        """Return whether most of what a mask at `(top, left)` covers is foreground by itself."""
        planes = np.empty((self.picture.image.shape[2], *mask.shape), np.float32)
        odds, free = np.empty((2, *mask.shape), np.float32)
        gather(self.picture.image, self.picture.log_odds, top, left, Patch(planes, odds, free))
        return float(mask[odds < 0].sum()) > 0.5 * float(mask.sum())

    def cut_out(self, spot: Spot, *tables: Blobs) -> tuple[Numbers, Map, Map]:
        """Return foreground in a spot and around it that no blob covers: top and left, mask, and planes."""
        top, left = spot[0] - MARGIN, spot[1] - MARGIN
        shape = (spot[2] + MARGIN - top, spot[3] + MARGIN - left)
        planes = np.empty((tables[0].channels, *shape), np.float32)
        odds, free = np.empty((2, *shape), np.float32)
        gather(self.picture.image, self.picture.log_odds, top, left, Patch(planes, odds, free))
        for blobs in tables:
            cover_by(free, top, left, blobs.table, blobs.pools)
        mask = np.minimum(0.9, free / (1 + np.exp(odds))).astype(np.float32)
        return np.array([float(top), float(left)]), mask, planes


@compiled
def count_in_blocks(log_odds, blobs, pools, scale, counts):
    """Count foreground in blocks of `scale` x `scale` px, but not in those of blobs and beside them.

    `counts` `(block_rows, block_columns)` int64 are 0 before.
    """
    (height, width), (block_rows, block_columns) = log_odds.shape, counts.shape
    spans, blocks = np.empty(width // SPAN + 1, np.int64), blocks_along(block_columns * scale, block_columns)
    for y in range(height):
        odds, row = log_odds[y], counts[y // scale]
        for span in range(foreground_spans(odds, spans)):
            for x in range(spans[span], min(spans[span] + SPAN, width)):
                row[blocks[x]] += odds[x] < 0
    covered = np.zeros(counts.shape, np.uint8)
    for k in range(blobs.size):
        mask, (top, left) = mask_of(blobs[k], pools), corner_of(blobs[k])
        first, end, start, stop = _inside(top, left, mask.shape[0], mask.shape[1], height, width)
        for y in range(first, end):
            row = covered[(top + y) // scale]
            for x in range(start, stop):
                if mask[y, x] > _f4(COVERED):
                    row[blocks[left + x]] = 1
    for row in range(block_rows):
        for column in range(block_columns):
            if counts[row, column] > 0:
                around = covered[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
                counts[row, column] *= not around.any()


def find_spots(log_odds: NDArray[np.int8], blobs: Blobs, min_area: float) -> list[Spot]:
    """Return spots of foreground (negative `log_odds` `(height, width)`) that are no blob nor beside one.

    They consist of blocks that are a quarter foreground or more, and have `min_area` px of it or more.
    """
    height, width = log_odds.shape
    scale = max(1, round(max(height, width) / BLOCKS))
    counts = np.zeros((-(-height // scale), -(-width // scale)), np.int64)
    count_in_blocks(log_odds, blobs.table, blobs.pools, scale, counts)
    blocks = counts >= -(-scale * scale // 4)
    if not blocks.any():
        return []
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(blocks.astype(np.uint8), connectivity=8)
    areas = np.bincount(labels.ravel(), counts.ravel(), count)
    lengths = scale * boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    large = np.flatnonzero(areas >= np.maximum(min_area, THINNEST * lengths**2))
    spots = []
    for label in large[large > 0].tolist():
        left, top, wide, high = (scale * int(number) for number in boxes[label, :4])
        first = int(np.argmax(labels[top // scale] == label))
        spots.append(((top, first), [top, left, top + high, left + wide]))
    return [spot for _, spot in sorted(spots)[:MOST_SPOTS]]


def inherited_evidence(blob: Blob, others: Blobs) -> float:
    """Return the ghost evidence (nats) of a new blob: half that of the blobs it touches."""
    x, y, width, height = blob.box
    left, top, columns, rows = others.boxes.T
    touched = (x - MARGIN < left + columns) & (left < x + width + MARGIN)
    touched &= (y - MARGIN < top + rows) & (top < y + height + MARGIN)
    return float(np.min(0.5 * others.table["past_views"][touched], initial=0.0)) if touched.any() else 0.0

"""Groups and halves: which blobs are parts of one object, and which blob is two."""

import math
from collections import Counter
from collections.abc import Sequence
from functools import reduce

import numpy as np

from ...models.objects.box_message import Newcomers
from ...models.objects.kernels.blobs import UNKNOWN_COLOUR
from ...models.objects.kernels.masks import shape_of
from .blob_geometry import FRESH, likely_size
from .blob_scene import BlobScene
from .blobs import Blob, Box, Map, around

UPRIGHT = 0.75
"""Width over height below which anybody is upright, and stands beside others."""

PAIR = 3.0
"""nats from which on a blob is taken for two people."""

HALF = 0.5
"""Of anybody's height, below which a blob is a fragment of somebody."""

SETTING_OFF = 2.0
"""s from its birth on, in which something may still come into view as parts that are apart."""

SAME_TIME = 0.4
"""s by which the births of parts of one thing may be apart."""

KNOWN = 0.25
"""Deviation over mean of anybody's height, below which it is known."""


def are_pieces(one: Blob, other: Blob) -> bool:
    """Whether two blobs, the second seen for no longer, are parts of one object.

    What touches a blob right after it was born belongs to it if it is above, below or small, and the two
    together are not much larger than the larger (or the first is as new); so do blobs that have stood still
    above each other for a while, or that move alike above each other and make one upright body together. What
    a detector has found is whole.
    """
    if one.detected is not None and other.detected is not None:
        return False
    x, y, width, height = one.box
    other_x, other_y, other_width, other_height = other.box
    gap_y = max(y, other_y) - min(y + height, other_y + other_height)
    gap_x = max(x, other_x) - min(x + width, other_x + other_width)
    _, _, wide, tall = around(one.box, other.box)
    if max(gap_x, gap_y) > 3:
        return False
    stacked = -gap_x > 0.7 * min(width, other_width)
    if other.seen >= FRESH:
        alike = math.hypot(*(one.velocity - other.velocity)) < 0.2 * tall
        one_body = -gap_y < 0.2 * min(height, other_height) and tall < 3.2 * wide and alike
        return stacked and (one_body or min(one.still, other.still) > 1.5)
    modest = tall < 1.6 * max(height, other_height) and wide < 1.6 * max(width, other_width)
    small = min(width * height, other_width * other_height) < 0.35 * max(
        width * height, other_width * other_height
    )
    return (stacked or small) and (one.seen < FRESH or modest)


def with_parts(blobs: Sequence[Blob], newcomers: Newcomers | None) -> list[Blob]:
    """Blobs that have just set off together, as parts of the one among them that was the first.

    Something that was a part of the scene, and looks alike in its middle wherever it is, comes into view as
    its edges do. They stay blobs of their own, since some may be what it leaves behind; and those that have
    not become one soon, or turn out to be no small parts, are on their own again.
    """
    result = list(blobs)
    for k, blob in enumerate(result):
        parts = [other for other in result if other.whole == blob.whole]
        grown = blob.seen >= SETTING_OFF or blob.detected is not None
        if len(parts) > 1 and (grown or not are_one(parts, newcomers)):
            result[k] = blob.changed(whole=blob.identity)
    young = [
        k for k, blob in enumerate(result) if blob.detected is None and FRESH / 2 < blob.seen < SETTING_OFF
    ]
    for first, k in enumerate(young):
        for other in young[first + 1 :]:
            kept, given = sorted((result[k].whole, result[other].whole))
            if kept != given and set_off_together(result[k], result[other], newcomers):
                # where any of them appeared, each may still be one with what they have left
                members = [blob for blob in result if blob.whole in (kept, given)]
                origin = reduce(around, (blob.origin for blob in members))
                result = [
                    blob.changed(whole=kept, origin=origin, past_views=0.0)
                    if blob.whole in (kept, given)
                    else blob
                    for blob in result
                ]
    return result


def alone(blobs: Sequence[Blob]) -> list[Blob]:
    """Blobs that are no parts of a thing, whose size is not theirs; two may be two side by side."""
    members = Counter(blob.whole for blob in blobs)
    return [blob for blob in blobs if members[blob.whole] <= 2]


def are_one(parts: Sequence[Blob], newcomers: Newcomers | None) -> bool:
    """Whether blobs can be parts of one thing: together not higher than anybody, nor as wide as two."""
    union = reduce(around, (part.box for part in parts))
    anybody = anybodys_height(union[1] + union[3], newcomers)
    too_high = anybody is not None and union[3] > anybody[0] + 2 * anybody[1]
    return not too_high and pair_evidence(union, newcomers) < 0


def set_off_together(one: Blob, other: Blob, newcomers: Newcomers | None) -> bool:
    """Whether two blobs set out at the same time, close to each other and in the same way."""
    _, _, wide, tall = around(one.box, other.box)
    length = max(wide, tall)
    gap = max(wide - one.box[2] - other.box[2], tall - one.box[3] - other.box[3])
    slower = min(math.hypot(*one.velocity), math.hypot(*other.velocity))
    apart = math.hypot(*(one.velocity - other.velocity))
    alike = slower > 0.1 * length and apart < 0.2 * length and abs(one.seen - other.seen) < SAME_TIME
    close = gap < max(one.length, other.length) and min(one.length, other.length) < 0.5 * length
    return close and alike and are_one((one, other), newcomers)


def anybodys_height(foot: float, newcomers: Newcomers | None) -> tuple[float, float] | None:
    """Mean and deviation px of the height of somebody with feet in a row; `None` if it is not known."""
    if newcomers is None:
        return None
    mean, deviation = (float(value) for value in newcomers.height(foot))
    return (mean, deviation) if deviation < KNOWN * mean else None


def fragment_time(blob: Blob, scene: BlobScene) -> float:
    """s for which a blob has been less than half as high as anybody there, inside of the picture."""
    x, y, width, height = blob.box
    inside = min(x, y) > 1 and x + width < scene.size[1] - 1 and y + height < scene.size[0] - 1
    anybody = anybodys_height(blob.foot, scene.newcomers) if inside else None
    if anybody is None or height > HALF * anybody[0]:
        return 0.0
    return blob.fragment_time + scene.elapsed


def pair_evidence(box: Box, newcomers: Newcomers | None) -> float:
    """Log ratio, nats, of two people beside each other and one, by how wide a box is where it stands.

    It is as high as anybody there, or else it is neither. One has anybody's width; two have that and how far
    they are apart, anything from a third of a width to a whole one and a bit.
    """
    if newcomers is None or newcomers.aspect > UPRIGHT:
        return -math.inf
    _, top, width, height = box
    anybody = anybodys_height(top + height, newcomers)
    if anybody is None or abs(height - anybody[0]) > 2 * anybody[1]:
        return -math.inf
    expected, _ = anybody
    usual = newcomers.aspect * expected
    spread = math.hypot(math.sqrt(newcomers.aspect_variance) * expected, 0.1 * usual)
    one = -0.5 * ((width - usual) / spread) ** 2 - math.log(spread * math.sqrt(2 * math.pi))
    apart = width / usual - 1
    two = -math.log(usual) if 0.3 < apart < 1.3 else -math.inf
    return two - one


def parting_column(blob: Blob, newcomers: Newcomers | None) -> int | None:
    """The column of the mask at which a blob seems to be two; `None` if it seems to be one."""
    if blob.shape.waist_depth < 0.5:
        return blob.shape.waist
    return thinnest_column(blob.mask) if pair_evidence(blob.box, newcomers) > PAIR else None


def thinnest_column(mask: Map) -> int:
    """The column in the middle half of a mask's likely part that holds least of it."""
    shape = shape_of(mask)
    quarter = (shape.right - shape.left) // 4
    columns = mask.sum(axis=0)[shape.left + quarter : shape.right - quarter]
    if not len(columns):
        return (shape.left + shape.right) // 2
    smooth = np.convolve(np.pad(columns, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    return int(np.argmin(smooth)) + shape.left + quarter


def halves(blob: Blob, column: int) -> tuple[Map, Map]:
    """The mask left and right of a column, the larger one first."""
    left, right = blob.mask.copy(), blob.mask.copy()
    left[:, column:] = 0
    right[:, :column] = 0
    return (left, right) if left.sum() >= right.sum() else (right, left)


def merged(blobs: Sequence[Blob]) -> list[Blob]:
    """Pieces of one object become one blob again (see `are_pieces`), the one seen for the longest."""
    result: list[Blob] = []
    for blob in sorted(blobs, key=lambda blob: (blob.detected is None, -blob.seen, blob.identity)):
        other = next((k for k, kept in enumerate(result) if are_pieces(kept, blob)), None)
        if other is None:
            result.append(blob)
        else:
            result[other] = joined(result[other], blob)
    return result


def joined(one: Blob, other: Blob) -> Blob:
    """One blob of two; it keeps the first one's identity and motion."""
    corners = np.array([one.corner, other.corner])
    ends = corners + np.array([one.mask.shape, other.mask.shape])
    first, shape = corners.min(axis=0), tuple(ends.max(axis=0) - corners.min(axis=0))
    mask = np.zeros(shape, np.float32)
    appearance = np.full((len(one.appearance), *shape), UNKNOWN_COLOUR, np.float32)
    for blob in (other, one):
        top, left = np.array(blob.corner) - first
        window = (slice(top, top + blob.mask.shape[0]), slice(left, left + blob.mask.shape[1]))
        better = blob.mask > mask[window]
        mask[window][better] = blob.mask[better]
        appearance[:, *window][:, better] = blob.appearance[:, better]
    return one.moved_patch(first - corners[0]).changed(
        mask=mask,
        appearance=appearance,
        size=likely_size(mask),
        seen=max(one.seen, other.seen),
        origin=around(one.origin, other.origin) if one.seen < FRESH else one.origin,
    )

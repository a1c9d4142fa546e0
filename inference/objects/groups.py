"""Groups and halves: which blobs are parts of one object, and which blob is two."""

import math
from collections.abc import Sequence

import numpy as np

from ...models.objects.kernels.blobs import UNKNOWN_COLOUR
from .blob_geometry import FRESH, around, likely_size
from .blobs import Blob, Map


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
    if max(gap_x, gap_y) > 3:
        return False
    stacked = -gap_x > 0.7 * min(width, other_width)
    tall = max(y + height, other_y + other_height) - min(y, other_y)
    wide = max(x + width, other_x + other_width) - min(x, other_x)
    if other.seen >= FRESH:
        alike = math.hypot(*(one.velocity - other.velocity)) < 0.2 * tall
        one_body = -gap_y < 0.2 * min(height, other_height) and tall < 3.2 * wide and alike
        return stacked and (one_body or min(one.still, other.still) > 1.5)
    modest = tall < 1.6 * max(height, other_height) and wide < 1.6 * max(width, other_width)
    small = min(width * height, other_width * other_height) < 0.35 * max(
        width * height, other_width * other_height
    )
    return (stacked or small) and (one.seen < FRESH or modest)


def halves(blob: Blob) -> tuple[Map, Map]:
    """The mask left and right of its waist, the larger one first."""
    shape = blob.shape
    masks = np.zeros((2, *blob.mask.shape), np.float32)
    masks[0, :, : shape.waist] = blob.mask[:, : shape.waist]
    masks[1, :, shape.waist :] = blob.mask[:, shape.waist :]
    return (masks[0], masks[1]) if 2 * shape.mass_left >= shape.mass else (masks[1], masks[0])


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

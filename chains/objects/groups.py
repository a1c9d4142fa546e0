"""Groups and halves: which blobs are parts of one object, and which blob is two."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.objects.box_message import Newcomers
from .blob_records import FRESH, UNKNOWN_COLOUR, measured, next_piece
from .blob_scene import BlobScene
from .blobs import Blob, Blobs, Map, Numbers, likely_size, union

UPRIGHT = 0.75  # width over height below which people are upright, and stand side by side
PAIR = 3.0  # nats from which on a blob is taken for two people
HALF = 0.5  # of a person's height, below which a blob is a fragment of one
SETTING_OFF = 2.0  # s from its birth on, in which something may still come into view as parts that are apart
SAME_TIME = 0.4  # s by which the births of parts of one thing may be apart
KNOWN = 0.25  # deviation over mean of the height prior, below which the height is known


def group_parts(blobs: Blobs, newcomers: Newcomers | None) -> Blobs:
    """Group blobs that have set off together, as parts of the oldest of them.

    Something that was a part of the scene, and looks alike in its middle wherever it is, comes into view as
    its edges do. They stay blobs of their own, since some may be what it leaves behind; and those that have
    not become one soon, or turn out to be no small parts, are on their own again.
    """
    table = blobs.table
    seen, found = table["seen"], table["detected"] != 0
    young = np.flatnonzero(~found & (seen > FRESH / 2) & (seen < SETTING_OFF)).tolist()
    if len(young) < 2 and (table["whole"] == table["identity"]).all():
        return blobs
    table = table.copy()
    for k in np.flatnonzero(_members(table) > 1).tolist():
        whole = table["whole"]
        parts = blobs.select(np.flatnonzero(whole == whole[k]))
        grown = seen[k] >= SETTING_OFF or found[k]
        if len(parts) > 1 and (grown or not can_be_one(parts.boxes, newcomers)):
            whole[k] = table["identity"][k]
    for first, k in enumerate(young):
        for other in young[first + 1 :]:
            kept, given = sorted((table["whole"][k], table["whole"][other]))
            if kept != given and set_off_together(blobs, k, other, newcomers):
                # where any of them appeared, each may still be one with what they have left
                members = np.isin(table["whole"], (kept, given))
                table["origin"][members] = union(table["origin"][members])
                table["whole"][members], table["past_views"][members] = kept, 0.0
    return blobs.with_table(table)


def _members(table: NDArray[np.void]) -> NDArray[np.int64]:
    """Count `(n,)` the blobs of the object that each blob is a part of."""
    _, place, counts = np.unique(table["whole"], return_inverse=True, return_counts=True)
    return np.asarray(counts[place], np.int64)


def select_whole(blobs: Blobs) -> Blobs:
    """Return the blobs that are whole objects, or one of two parts: the sizes of others mean nothing."""
    if (blobs.table["whole"] == blobs.table["identity"]).all():
        return blobs
    return blobs.select(_members(blobs.table) <= 2)


def can_be_one(boxes: Numbers, newcomers: Newcomers | None) -> bool:
    """Return whether blobs can be parts of one object: together neither too high nor as wide as two."""
    whole = union(boxes)
    mean, deviation = height_prior(whole[1] + whole[3], newcomers)
    too_high = whole[3] > mean + 2 * deviation
    return not too_high and bool(pair_evidence(whole, newcomers) < 0)


def set_off_together(blobs: Blobs, one: int, other: int, newcomers: Newcomers | None) -> bool:
    """Return whether two blobs set out at the same time, close to each other and in the same direction."""
    boxes, (here, there) = blobs.boxes[[one, other]], blobs.table[[one, other]]
    _, _, wide, tall = union(boxes).tolist()
    length = max(wide, tall)
    gap = max(wide - boxes[0, 2] - boxes[1, 2], tall - boxes[0, 3] - boxes[1, 3])
    slower = min(math.hypot(*here["velocity"]), math.hypot(*there["velocity"]))
    apart = math.hypot(*(here["velocity"] - there["velocity"]))
    alike = slower > 0.1 * length and apart < 0.2 * length and abs(here["seen"] - there["seen"]) < SAME_TIME
    shorter, longer = sorted(blobs.reported_boxes[[one, other], 2:].max(axis=1).tolist())
    return bool(gap < longer and shorter < 0.5 * length and alike and can_be_one(boxes, newcomers))


def height_prior(feet: ArrayLike, newcomers: Newcomers | None) -> tuple[Numbers, Numbers]:
    """Return mean and deviation px of a person's height with feet in these rows; NaN where it is unknown."""
    if newcomers is None:
        unknown = np.full(np.shape(feet), np.nan)
        return unknown, unknown
    mean, deviation = newcomers.height(feet)
    return np.where(deviation < KNOWN * mean, mean, np.nan), deviation


def fragment_times(blobs: Blobs, scene: BlobScene) -> Numbers:
    """Return `(n,)` s for which blobs inside of the picture have been less than half a person's height."""
    x, y, width, height = blobs.boxes.T
    mean, _ = height_prior(blobs.feet, scene.newcomers)
    small = (np.minimum(x, y) > 1) & (x + width < scene.size[1] - 1) & (y + height < scene.size[0] - 1)
    small &= height <= HALF * mean
    return np.where(small, blobs.table["fragment_time"] + scene.elapsed, 0.0)


def pair_evidence(boxes: ArrayLike, newcomers: Newcomers | None) -> Numbers:
    """Return the log ratio, nats, of two people side by side and one, given the width of `(..., 4)` boxes.

    Both cases have a person's height there. One person has the usual width; two have that and their distance,
    uniform from a third of a width to 1.3 widths.
    """
    _, top, width, height = np.moveaxis(np.asarray(boxes, np.float64), -1, 0)
    if newcomers is None or newcomers.aspect > UPRIGHT:
        return np.full(np.shape(top), -np.inf)
    expected, deviation = height_prior(top + height, newcomers)
    usual = newcomers.aspect * expected
    std = np.hypot(math.sqrt(newcomers.aspect_variance) * expected, 0.1 * usual)
    one = -0.5 * ((width - usual) / std) ** 2 - np.log(std * math.sqrt(2 * math.pi))
    apart = width / usual - 1
    as_high = np.abs(height - expected) <= 2 * deviation
    return np.where(as_high & (apart > 0.3) & (apart < 1.3), -np.log(usual) - one, -np.inf)


def split_columns(blobs: Blobs, newcomers: Newcomers | None) -> NDArray[np.int64]:
    """Return `(n,)` columns of masks at which blobs seem to be two; -1 where they seem to be one."""
    table = blobs.table
    columns = np.where(table["waist_depth"] < 0.5, table["waist"], -1)
    for k in np.flatnonzero((columns < 0) & (pair_evidence(blobs.boxes, newcomers) > PAIR)).tolist():
        columns[k] = thinnest_column(blobs[k].mask)
    return columns


def thinnest_column(mask: Map) -> int:
    """Return the column in the middle half of a mask's likely part that holds least of it."""
    shape = measured(mask)
    left, right = int(shape["left"]), int(shape["right"])
    quarter = (right - left) // 4
    columns = mask.sum(axis=0)[left + quarter : right - quarter]
    if not len(columns):
        return (left + right) // 2
    smooth = np.convolve(np.pad(columns, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    return int(np.argmin(smooth)) + left + quarter


def split_mask(blob: Blob, column: int) -> tuple[Map, Map]:
    """Return the mask left and right of a column, the larger one first."""
    left, right = blob.mask.copy(), blob.mask.copy()
    left[:, column:] = 0
    right[:, :column] = 0
    return (left, right) if left.sum() >= right.sum() else (right, left)


def merge_pieces(blobs: Blobs) -> Blobs:
    """Merge pieces of one object (see `next_piece`) into the blob that has been seen for longest."""
    table = blobs.table
    blobs = blobs.select(np.lexsort((table["identity"], -table["seen"], table["detected"] == 0)))
    piece, one = next_piece(blobs.table, 1)
    while piece < len(blobs):
        rows = list(blobs)
        rows[one] = merge_pair(rows[one], rows.pop(piece))
        blobs = Blobs.of(rows, blobs.channels)
        piece, one = next_piece(blobs.table, piece)
    return blobs


def merge_pair(one: Blob, other: Blob) -> Blob:
    """Return one blob of two, with the identity and motion of the first."""
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
        origin=union(np.array([one.origin, other.origin])) if one.seen < FRESH else one.origin,
    )

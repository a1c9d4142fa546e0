"""Groups and halves: which blobs are parts of one object, and which blob is two."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.objects.box_message import Newcomers, log_anywhere
from .blob_records import FRESH, UNKNOWN_COLOUR, gather_pieces, measured
from .blob_scene import BlobScene
from .blobs import Blob, Blobs, Map, Numbers, likely_size, union

UPRIGHT = 0.75  # width over height below which people are upright, and stand side by side
PAIR = 3.0  # nats from which on a blob is taken for two people
HALF = 0.5  # of a person's height, below which a blob is a fragment of one
OBJECTS = 3.0  # mean number of objects in a picture; a guess
IN_PARTS = 0.1  # probability that an object is seen as parts that are apart
ALIKE, ANY_WAY = 0.2, 1.4  # lengths/s by which velocities of one object's parts, and of two objects, differ
LARGEST_PART = 0.6  # lengths of an object, that the shorter of two parts has at most; pairs are longer
MOVES = 0.1  # lengths/s from which on something moves
WERE_ONE = 4.0  # nats: what has been one object stays one
SETTING_OFF = 2.0  # s from its birth on, in which a part may be what an object leaves behind
KNOWN = 0.25  # deviation over mean of the height prior, below which the height is known


def group_parts(blobs: Blobs, scene: BlobScene) -> Blobs:
    """Group blobs that move together into objects, where one is likelier than several (see `part_evidence`).

    They stay blobs of their own, since some may be what the object leaves behind. An object has the identity
    of its oldest part, and parts join and leave.
    """
    table = blobs.table
    is_free = (table["detected"] == 0) & (table["seen"] > FRESH / 2)
    if not is_free.any() and (table["whole"] == table["identity"]).all():
        return blobs
    free, alone = np.flatnonzero(is_free), np.flatnonzero(~is_free)
    table, own, before, taken = table.copy(), table["identity"], table["whole"], set[int]()
    table["whole"] = own
    groups, everyone = [*_joined(blobs, free, scene), *alone[:, None]], set(own.tolist())
    for members in sorted(groups, key=lambda members: -table["mass"][members].sum()):
        names = set(own[members].tolist())
        name = min(names.union(before[members].tolist()) - taken - (everyone - names))
        taken.add(name)
        table["whole"][members] = name
        if (
            len(members) > 1
            and (before[members] != before[members[0]]).any()
            and (table["seen"][members] < SETTING_OFF).all()
        ):
            # where any of them appeared, each may still be one with what they have left
            table["origin"][members], table["past_views"][members] = union(table["origin"][members]), 0.0
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


def _joined(blobs: Blobs, free: NDArray[np.intp], scene: BlobScene) -> list[NDArray[np.intp]]:
    """Groups of the blobs `free` `(n,)`: the two are joined that are most likely one, as long as any are."""
    table, boxes = blobs.table[free], blobs.boxes[free]
    members, names = np.eye(len(free), dtype=bool), table["whole"][:, None] == np.unique(table["whole"])
    young = names & (table["seen"] < SETTING_OFF)[:, None]
    velocities, variances, masses = (
        each.copy() for each in (table["velocity"], table["covariance"][:, 1, 1], table["mass"])
    )
    while True:
        were_one, set_off = names @ names.T, young @ young.T
        possible = np.triu(set_off | _may_be_parts(boxes, velocities), 1)
        if not possible.any():
            break
        evidence = part_evidence(boxes, velocities, variances, scene) + WERE_ONE * were_one
        evidence[~possible] = -np.inf
        one, other = divmod(int(np.argmax(evidence)), len(boxes))
        if evidence[one, other] <= 0:
            break
        share = masses[other] / (masses[one] + masses[other])
        velocities[one] += share * (velocities[other] - velocities[one])
        variances[one] = (1 - share) ** 2 * variances[one] + share**2 * variances[other]
        masses[one] += masses[other]
        boxes[one] = union(boxes[[one, other]])
        members[one] |= members[other]
        names[one] |= names[other]
        young[one] |= young[other]
        boxes, velocities, variances, masses, members, names, young = (
            np.delete(each, other, axis=0)
            for each in (boxes, velocities, variances, masses, members, names, young)
        )
    return [free[row] for row in members]


def part_evidence(boxes: Numbers, velocities: Numbers, variances: Numbers, scene: BlobScene) -> Numbers:
    """Return `(n, n)` nats, log ratio of any two blobs being parts of one object and two objects.

    Two objects have two boxes of newcomers, and any velocities. One has the box that holds both, of whose
    eight numbers four are left open: they are uniform within it; and one velocity. As people also walk side
    by side, velocities that are alike say little; others say much. `boxes` are `(n, 4)` px, `velocities` `(n,
    2)` px/s with `variances` `(n,)` px^2/s^2.
    """
    ends = boxes[:, :2] + boxes[:, 2:]
    corner = np.minimum(boxes[:, None, :2], boxes[:, :2])
    sides = np.maximum(ends[:, None], ends) - corner
    both = np.concatenate([corner, sides], axis=2).reshape(-1, 4)
    alone, one = _log_density(boxes, scene), _log_density(both, scene).reshape(len(boxes), -1)
    evidence = math.log(IN_PARTS / OBJECTS) + one - 2 * np.log(sides.prod(axis=2)) - alone[:, None] - alone

    lengths = boxes[:, 2:].max(axis=1)
    longer = np.maximum(lengths[:, None], lengths)
    apart = ((velocities[:, None] - velocities) ** 2).sum(axis=2)
    alike = variances[:, None] + variances + (ALIKE * longer) ** 2
    any_way = alike + (ANY_WAY * longer) ** 2
    ratio = 0.5 * apart * (1 / any_way - 1 / alike) + np.log(any_way / alike)
    return np.asarray(evidence + ratio - np.logaddexp(ratio, 0) + math.log(2))


def _may_be_parts(boxes: Numbers, velocities: Numbers) -> NDArray[np.bool_]:
    """`(n, n)`: whether any two blobs move, are close to each other, and one is much shorter than both."""
    lengths, speeds = boxes[:, 2:].max(axis=1), np.hypot(*velocities.T)
    ends = boxes[:, :2] + boxes[:, 2:]
    sides = np.maximum(ends[:, None], ends) - np.minimum(boxes[:, None, :2], boxes[:, :2])
    length, gap = sides.max(axis=2), (sides - boxes[:, None, 2:] - boxes[:, 2:]).max(axis=2)
    moves = np.minimum(speeds[:, None], speeds) > MOVES * length
    parts = np.minimum(lengths[:, None], lengths) < LARGEST_PART * length
    return np.asarray(moves & parts & (gap < np.maximum(lengths[:, None], lengths)))


def _log_density(boxes: Numbers, scene: BlobScene) -> Numbers:
    """`(n,)` nats, of 1/px^4, of objects with boxes `(n, 4)`, which are of any size if none is usual."""
    x, y, width, height = boxes.T
    feet = np.stack([x + 0.5 * width, y + height, width, height], axis=1)
    if scene.newcomers is None:
        return log_anywhere(feet, float(scene.size[0] * scene.size[1]))
    return scene.newcomers.log_density(feet)


def height_prior(feet: ArrayLike, newcomers: Newcomers | None) -> tuple[Numbers, Numbers]:
    """Return mean and deviation px of a person's height with feet in these rows; NaN where it is unknown."""
    if newcomers is None:
        unknown = np.full(np.shape(feet), np.nan)
        return unknown, unknown
    mean, deviation = newcomers.height(feet)
    return np.where(deviation < KNOWN * mean, mean, np.nan), deviation


def fragment_times(blobs: Blobs, scene: BlobScene) -> Numbers:
    """Return `(n,)` s for which objects inside of the picture have been less than half a person's height."""
    wholes, boxes, feet = blobs.table["whole"], blobs.boxes.copy(), blobs.feet.copy()
    for name in np.unique(wholes[wholes != blobs.table["identity"]]).tolist():
        parts = wholes == name
        boxes[parts], feet[parts] = union(blobs.boxes[parts]), feet[parts].max()
    x, y, width, height = boxes.T
    mean, _ = height_prior(feet, scene.newcomers)
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
    """Merge pieces of one object (see `gather_pieces`) into the blob that has been seen for longest."""
    table = blobs.table
    blobs = blobs.select(np.lexsort((table["identity"], -table["seen"], table["detected"] == 0)))
    grown, wholes = blobs.table.copy(), np.empty(len(blobs), np.int64)
    gather_pieces(grown, wholes)
    members = [np.flatnonzero(wholes == k).tolist() for k in np.unique(wholes).tolist()]
    if len(members) == len(blobs):
        return blobs
    return Blobs.of(
        [blobs[k] if not pieces else _painted(grown[k], blobs, [k, *pieces]) for k, *pieces in members],
        blobs.channels,
    )


def _painted(record: np.void, blobs: Blobs, members: list[int]) -> Blob:
    """Return the blob of a record that holds all `members`, with what is likeliest of their masks."""
    shape = int(record["rows"]), int(record["columns"])
    mask, appearance = np.zeros(shape, np.float32), np.empty((blobs.channels, *shape), np.float32)
    appearance[:] = UNKNOWN_COLOUR
    whole = Blob(record, mask, appearance)
    for blob in (blobs[k] for k in reversed(members)):
        top, left = np.subtract(blob.corner, whole.corner)
        window = (slice(top, top + blob.mask.shape[0]), slice(left, left + blob.mask.shape[1]))
        better = blob.mask > mask[window]
        mask[window][better] = blob.mask[better]
        appearance[:, *window][:, better] = blob.appearance[:, better]
    return whole.changed(mask, size=likely_size(mask))

"""Identities that turn out to be one point: what the shape takes for one, and what sits on one spot."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...models.points.patches import ncc
from ...models.points.point_tracks import PointMessage
from .trajectory import PointTrajectory

Identities = NDArray[np.int64]
Duplicates = Mapping[int, int]
"""Identity, and the smaller one of the point that it is."""

LEAST_NCC = 0.7
"""Normalised correlation of two points that are said to be one, where their patches are most alike."""

LEAST_FRAMES = 5
"""Frames in which two points are found on one spot before they are taken for one."""


def duplicates(trajectory: PointTrajectory, others: Sequence[PointMessage]) -> dict[int, int]:
    """Identities that were one point before, and those that other chains take for one and that look alike."""
    same = {int(one): int(other) for one, other in trajectory.absorbed}
    said = {
        (int(one), int(other))
        for message in others
        if message.same_as is not None
        for one, other in zip(message.positions.identities, message.same_as, strict=True)
        if one != other
    }
    seen = trajectory.appearances
    if seen is None or not said:
        return same
    pairs = np.array(sorted(said), np.int64)
    pairs = pairs[np.isin(pairs, seen.identities).all(axis=1)]
    one, other = np.searchsorted(seen.identities, pairs.T)
    alike = np.max(
        [ncc(a[one], b[other]) for a in (seen.first, seen.last) for b in (seen.first, seen.last)],
        axis=0,
    )
    return merged_groups(same, pairs[alike >= LEAST_NCC])


def merged_groups(same: Duplicates, pairs: Iterable[Sequence[int]]) -> dict[int, int]:
    """Groups with some more pairs in one: each identity that is not the smallest of its group, with that."""
    group = dict(same)

    def smallest(identity: int) -> int:
        while identity in group:
            identity = group[identity]
        return identity

    for one, other in pairs:
        low, high = sorted((smallest(int(one)), smallest(int(other))))
        if low != high:
            group[high] = low
    return {identity: smallest(identity) for identity in group}


def without_duplicates(message: PointMessage, same: Duplicates) -> PointMessage:
    """What is said of each point once, under its smallest identity."""
    if not same:
        return message
    identities = canonical(message.positions.identities, same)
    names, first = np.unique(identities, return_index=True)
    positions = replace(message.positions.only(first), identities=names)
    return PointMessage(positions, message.patches, message.view)


def canonical(identities: Identities, same: Duplicates) -> Identities:
    """`(n,)`: the smallest identity of each one's point."""
    names: Identities = np.array(
        [same.get(int(identity), int(identity)) for identity in identities], np.int64
    )
    return names


def coincident_tracks(messages: Sequence[PointMessage], spot: float) -> list[tuple[int, int]]:
    """Pairs of identities that were found nearer to each other than `spot` px in several frames."""
    times: Counter[tuple[int, int]] = Counter()
    for message in messages:
        identities, mean, _ = message.positions.moments
        if len(identities) > 1:
            pairs = cKDTree(mean).query_pairs(spot, output_type="ndarray")
            times.update((int(one), int(other)) for one, other in identities[np.sort(pairs, axis=1)])
    return sorted(pair for pair, count in times.items() if count >= LEAST_FRAMES)

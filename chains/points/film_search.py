"""A whole film searched for points, from its first frame to its last, perhaps with what was found before."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.mahalanobis import squared_distances
from ...models.points.patches import Patches
from ...models.points.point_tracks import PointMessage, PointTracks
from .duplicate_tracks import (
    Duplicates,
    canonical,
    coincident_tracks,
    duplicates,
    merged_groups,
    without_duplicates,
)
from .known_points import KnownPoints
from .tracker import (
    NEW_DEVIATION,
    SAME_PLACE,
    TrackerState,
    initial_states,
    message_of,
    predicted,
    updated,
    with_given,
)
from .trajectory import PointTrajectory

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]

GATE = 3.0
"""Standard deviations from where others say that a point is, within which it may begin."""

NOBODY = np.zeros(0, np.int64)


class FilmSearch:
    """Points of all frames, searched for one frame after the other as in filtering.

    After the first round there are no new points: those of the round before are searched for wherever others
    say that they are, and from where they were found first.

    Parameters
    ----------
    empty
        state of a tracker without points.
    replenished
        a state with new points in place of those that are missing.
    learns
        whether the acceleration is learned on the way.
    incoming_over_time, others
        of all frames: what reaches the tracker, and the messages of other chains alone.
    current
        the trajectory of the round before.

    Attributes
    ----------
    same
        identities that are one point.
    others
        the messages of others, once for each point.
    """

    def __init__(
        self,
        empty: TrackerState,
        replenished: Callable[[TrackerState], TrackerState],
        learns: bool,
        incoming_over_time: Sequence[BatchIncoming],
        others: Sequence[PointMessage],
        current: PointTrajectory | None,
    ) -> None:
        self._empty, self._replenished, self._learns = empty, replenished, learns
        self._incoming, self._current = incoming_over_time, current
        self._all_others = others
        self._unite({} if current is None else duplicates(current, others))

    def run(self) -> tuple[list[PointMessage], KnownPoints]:
        """What frames show of points, and those points.

        A point that no other frame shows than the one where it began is no track, and says nothing.
        """
        found = self._followed()
        if self._current is not None:
            pairs = coincident_tracks(found[0], SAME_PLACE)
            if pairs:
                self._unite(merged_groups(self.same, pairs))
                found = self._followed()
        evidence, known = found
        names, counts = np.unique(
            np.concatenate([message.positions.identities for message in evidence]), return_counts=True
        )
        alone = names[counts == 1]
        return [_without(message, alone) for message in evidence], known

    def _unite(self, same: Duplicates) -> None:
        self.same = same
        self.others = [without_duplicates(message, same) for message in self._all_others]

    def _followed(self) -> tuple[list[PointMessage], KnownPoints]:
        state, last = None, 0.0
        evidence = []
        for number, (incoming, others) in enumerate(zip(self._incoming, self.others, strict=True)):
            frame = incoming.frame
            if state is not None:
                state = predicted(state, frame.time - last)
            elif not frame.missing:
                state = self._beginning()
            last = frame.time
            if state is None:
                evidence.append(incoming.search(PointTracks, others))
            else:
                state, seen = self._step(state, incoming, others, number)
                evidence.append(seen)
        return evidence, KnownPoints.none() if state is None else state.known

    def _step(
        self, state: TrackerState, incoming: BatchIncoming, others: PointMessage, number: int
    ) -> tuple[TrackerState, PointMessage]:
        """The state after a frame, and what was seen there.

        A point that begins in the frame is searched for there at once: what cannot be told from its
        surroundings in the very picture that it was cut from is no point.
        """
        prior = message_of(state) * others
        seen = incoming.search(PointTracks, prior)
        before = updated(state, others * seen, learns=self._learns)
        if seen.view is None:
            return before, seen
        if seen.view.grey is None:
            return with_given(before, others * seen), seen
        after = (
            self._replenished(before) if self._current is None else self._begun_again(before, others, number)
        )
        known = after.known
        new = known.alive & ~np.isin(known.identities, before.known.identities[before.known.alive])
        if not new.any():
            return after, seen
        begun = message_of(replace(after, known=known.only(new)))
        patches = Patches(known.identities, known.patches)
        prior = PointMessage(prior.positions * begun.positions, patches, prior.view)
        seen = incoming.search(PointTracks, prior)
        found = NOBODY if seen.view is None else seen.view.found.identities
        alive = known.alive & ~(new & ~np.isin(known.identities, found))
        return replace(after, known=replace(known, alive=alive), view=seen.view), seen

    def _beginning(self) -> TrackerState:
        """In later rounds the patches of all points are known, and no position."""
        current = self._current
        if current is None or current.appearances is None:
            return self._empty
        seen = current.appearances
        kept = np.isin(seen.identities, current.identities) & ~np.isin(seen.identities, list(self.same))
        lost = KnownPoints.lost(seen.identities[kept], seen.first[kept], seen.first[kept])
        return replace(self._empty, known=lost)

    def _begun_again(self, state: TrackerState, others: PointMessage, number: int) -> TrackerState:
        """With points that were found first in this frame in the round before, unless others know better."""
        known, view, current = state.known, state.view, self._current
        if current is None or current.appearances is None or view is None:
            return state
        first = np.flatnonzero(current.observed[number] & ~current.observed[:number].any(axis=0))
        names, once = np.unique(canonical(current.identities[first], self.same), return_index=True)
        points = first[once]
        position = current.position[number, points]
        begins = ~known.alive[known.places_of(names)] & _plausible(others.positions, names, position)
        points, places, position = points[begins], known.places_of(names[begins]), position[begins]
        patches = known.patches.copy()
        patches[places] = current.appearances.first[current.appearances.places_of(current.identities[points])]
        states = initial_states(state, view, position, NEW_DEVIATION**2 * np.eye(2))
        return replace(state, known=replace(known, patches=patches).with_states(places, states))


def _without(message: PointMessage, alone: Identities) -> PointMessage:
    """What a picture shows, without some points; points that are given stay."""
    if message.view is None or message.view.grey is None:
        return message
    stay = ~np.isin(message.positions.identities, alone)
    return replace(message, positions=message.positions.only(stay))


def _plausible(others: GaussianMessage, identities: Identities, positions: Numbers) -> Mask:
    """`(n,)`: whether points may be at `positions`, `(n, 2)` px, as far as anything is said of them."""
    known, mean, covariance = others.only(np.isin(others.identities, identities)).moments
    place = np.searchsorted(identities, known)
    off = positions[place] - mean
    spread = covariance + NEW_DEVIATION**2 * np.eye(2)
    plausible = np.ones(len(identities), np.bool_)
    plausible[place] = squared_distances(off, spread) <= GATE**2
    return plausible

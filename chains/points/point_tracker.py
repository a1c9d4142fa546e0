"""Tracker of single points: a first-order Kalman filter each, and what each one looks like (RSMCM §4.3).

p(x(t + dt) | x(t)) = prod_i N(x_i(t + dt); A(dt) x_i(t), q Q(dt)),    p(F | x) = prod_i delta(u_i - H x_i)

x_i are position H x_i (px) and velocity (px/s) of point i, which white acceleration of density q (px^2/s^3)
moves out of its straight way; A and Q are those of `kinematic(2, dt)`. F holds positions u_i and patches a_i
by identity. The message to F is prod_i N(u_i; H m_i, H P_i H^T), the predicted positions, and with it what
points look like; the evidence is where the picture shows these patches (`PointTracks`).

It follows every point by itself and knows nothing of how points move together. Alone it loses a point that is
not seen for a while, and takes it for another one when it comes back. With a second chain over the same
points, that chain's prediction is a virtual observation: it keeps a point alive, and says where to look for
one that was lost.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.numerics.densities import squared_distances
from ...models.points.patches import Patches, ncc
from ...models.points.point_tracks import PointMessage, PointTracks
from .tracker import (
    GIVEN_LIMIT,
    NEW_DEVIATION,
    SAME_PLACE,
    KnownPoints,
    TrackerState,
    initial_states,
    message_of,
    predicted,
    replenished,
    updated,
    with_given,
)
from .trajectory import Appearances, PointTrajectory, StackedMessages, estimate_motion, smoothed_trajectory

Identities = NDArray[np.int64]
Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

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


GATE = 3.0
"""Standard deviations from where others say that a point is, within which it may begin."""

NOBODY = np.zeros(0, np.int64)


class FilmSearch:
    """Points of all frames, searched for one frame after the other as in filtering.

    After the first round there are no new points: those of the round before are searched for wherever others
    say that they are, and from where they were found first.

    Parameters
    ----------
    tracker
        that searches.
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
        tracker: "PointTracker",
        incoming_over_time: Sequence[BatchIncoming],
        others: Sequence[PointMessage],
        current: PointTrajectory | None,
    ) -> None:
        self._tracker, self._incoming, self._current = tracker, incoming_over_time, current
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
        before = updated(state, others * seen, learns=self._tracker.learns)
        if seen.view is None:
            return before, seen
        if seen.view.grey is None:
            return with_given(before, others * seen), seen
        after = (
            self._tracker.replenished(before)
            if self._current is None
            else self._begun_again(before, others, number)
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
            return self._tracker.empty()
        seen = current.appearances
        kept = np.isin(seen.identities, current.identities) & ~np.isin(seen.identities, list(self.same))
        lost = KnownPoints.lost(seen.identities[kept], seen.first[kept], seen.first[kept])
        return replace(self._tracker.empty(), known=lost)

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


ACCELERATION_TIME = 0.5
"""s, correlation time of what pushes a point out of its straight way."""

FIRST_ACCELERATION = 300.0
"""px/s^2, standard deviation with which learning begins, where there is a picture."""

REMEMBERED = 4
"""Lost points that are remembered in filtering, in units of the points that are followed."""


@short_repr
@dataclass(frozen=True)
class PointTracker:
    """Low-level chain over points: each one moves on at its velocity, but for random pushes.

    In pictures new points begin at corners where nobody is followed. A point ends when it leaves the picture,
    when its position is not known any more, or when it slides onto another one that is older. Points that are
    given with the frames keep their numbers; scales then follow from the noise of the feature node, whatever
    their unit.

    Parameters
    ----------
    n_points
        how many points to follow in pictures.
    spacing
        px, least distance of a new point to those that there are.
    acceleration
        px/s^2, standard deviation of what moves a point out of its straight way; it lasts half a second.
        Where it is left out it is learned: so that half of the points are found inside the ellipses that
        should hold half.
    limit
        px in pictures, standard deviation of a position from which a point is lost.
    """

    n_points: int = 300
    spacing: float = 10.0
    acceleration: float | None = None
    limit: float = 8.0
    name: str = "tracker"

    ports = (Port(PointTracks, sole="appearance"),)

    def __post_init__(self) -> None:
        for name in ("n_points", "spacing", "limit"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")
        if self.acceleration is not None and not self.acceleration > 0:
            raise ValueError(f"acceleration: got {self.acceleration}, expected more than 0 px/s^2 or None")

    # --- filtering ---

    def initial(self, frame: Frame) -> TrackerState:
        """No points yet: they are found in the first frame."""
        return self.empty()

    def predict(self, state: TrackerState, dt: float) -> TrackerState:
        """Points move on at their velocities."""
        return predicted(state, dt)

    def message(self, state: TrackerState, feature: PointTracks, incoming: Incoming) -> PointMessage:
        """Where points should be (mu_{X -> F}), what they look like, also those that were lost, and the view
        before."""
        return message_of(state)

    def update(self, state: TrackerState, incoming: Incoming) -> TrackerState:
        """Points given a frame: those that are found again, without those that are lost, and new ones."""
        others = incoming[PointTracks]
        state = updated(state, others, learns=self.learns)
        if others.view is not None:
            state = self.replenished(state) if others.view.grey is not None else with_given(state, others)
        return replace(state, known=state.known.without_oldest(REMEMBERED * self.n_points))

    @property
    def learns(self) -> bool:
        """Whether the acceleration is learned on the way."""
        return self.acceleration is None

    def empty(self) -> TrackerState:
        """The state without points."""
        density = ACCELERATION_TIME * (self.acceleration or FIRST_ACCELERATION) ** 2
        return TrackerState(KnownPoints.none(), 0, density, self.limit, np.inf, None)

    def replenished(self, state: TrackerState) -> TrackerState:
        """The state with new points in place of those that are missing."""
        return replenished(state, self.n_points, self.spacing)

    # --- batch ---

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: PointTrajectory | None = None
    ) -> Smoothed[PointTrajectory]:
        """Points in all frames, given what all frames show and what other chains say.

        In pictures points are followed from frame to frame as in filtering. In later rounds the points of the
        round before are searched for again, in all frames: wherever other chains say that they are, and from
        where they were found first; there are no others. Identities that others take for one point, and that
        look alike, are one, and so are those that are found on one spot again and again.
        """
        others = [incoming.others(PointTracks) for incoming in incoming_over_time]
        if any(incoming.frame.image is not None for incoming in incoming_over_time):
            search = FilmSearch(self, incoming_over_time, others, current)
            evidence, known = search.run()
            trajectory = replace(
                self._smoothed(evidence, search.others, incoming_over_time),
                appearances=Appearances(known.identities, known.first, known.patches),
                absorbed=np.array(sorted(search.same.items()), np.int64).reshape(-1, 2),
            )
        else:
            pairs = zip(incoming_over_time, others, strict=True)
            evidence = [incoming.search(PointTracks, message) for incoming, message in pairs]
            trajectory = self._smoothed(evidence, others, incoming_over_time)
        return Smoothed(trajectory, {incoming_over_time[0].node(PointTracks): evidence})

    def messages(
        self,
        trajectory: PointTrajectory,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Where the evidence of all other frames says that points are (mu_{X -> F}): nobody hears
        themselves."""
        return [PointMessage(positions) for positions in trajectory.messages()]

    def _smoothed(
        self,
        evidence: Sequence[PointMessage],
        others: Sequence[PointMessage],
        incoming_over_time: Sequence[BatchIncoming],
    ) -> PointTrajectory:
        """Smooth tracks of all points that were found in any frame."""
        times = np.array([incoming.frame.time for incoming in incoming_over_time])
        seen = StackedMessages.of([message.positions for message in evidence], times)
        expected = StackedMessages.of([message.positions for message in others], times, seen.identities)
        motion = estimate_motion(
            seen.measured, None if self.acceleration is None else ACCELERATION_TIME * self.acceleration**2
        )
        views = [message.view for message in evidence if message.view is not None]
        greys = [view.grey for view in views if view.grey is not None]
        limit = self.limit if greys or not views else GIVEN_LIMIT * views[0].noise
        return smoothed_trajectory(seen, expected, motion, limit, greys[0].shape if greys else None)

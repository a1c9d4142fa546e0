"""Tracker of single points: a first-order Kalman filter each, and what each one looks like (RSMCM §4.3).

It follows every point by itself and knows nothing of how points move together. Alone it loses a point that is
not seen for a while, and takes it for another one when it comes back. With a second chain over the same
points, that chain's prediction is a virtual observation: it keeps a point alive, and says where to look for
one that was lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..inference.core.protocols import BatchIncoming, Incoming, Port, Smoothed
from ..inference.points.duplicate_tracks import Same, on_one_spot, rename, renamed, same_points, united
from ..inference.points.known_points import KnownPoints
from ..inference.points.motion_noise import learned_motion
from ..inference.points.tracker import (
    BORN,
    GIVEN_LIMIT,
    SPOT,
    TrackerState,
    followed,
    message_of,
    predicted,
    refilled,
    starting,
    with_given,
)
from ..inference.points.trajectory import Gathered, Looks, PointTrajectory, smoothed_trajectory
from ..models.core.frame import Frame
from ..models.core.gaussian_message import GaussianMessage
from ..models.core.mahalanobis import squared_distances
from ..models.core.short_repr import short_repr
from ..models.points.patches import Patches
from ..models.points.point_tracks import PointMessage, PointTracks

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]

LASTS = 0.5
"""s that a push lasts which changes a point's velocity."""

FIRST_ACCELERATION = 300.0
"""px/s^2, standard deviation with which learning begins, where there is a picture."""

REFILL = 0.05
"""Share of the points that are missing before new ones are looked for."""

REST = 0.1
"""s between two looks for corners, where there may be no others."""

MEMORY = 4
"""Lost points whose looks are remembered in filtering, in units of the points that are followed."""

FAR = 3.0
"""Standard deviations from where others say that a point is, within which it may begin."""


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
        density = LASTS * (self.acceleration or FIRST_ACCELERATION) ** 2
        return TrackerState(KnownPoints.none(), 0, density, self.limit, np.inf, None)

    def predict(self, state: TrackerState, dt: float) -> TrackerState:
        """Points move on at their velocities."""
        return predicted(state, dt)

    def message(self, state: TrackerState, feature: PointTracks, incoming: Incoming) -> PointMessage:
        """Where points should be (mu_{R -> F}), what they look like, also those that were lost, and the view
        before."""
        return message_of(state)

    def update(self, state: TrackerState, incoming: Incoming) -> TrackerState:
        """Points after a look: those that are found again, those that are lost, and new ones."""
        others = incoming[PointTracks]
        state = followed(state, others, learns=self.acceleration is None)
        if others.view is not None:
            state = self._with_new(state) if others.view.grey is not None else with_given(state, others)
        return replace(state, known=state.known.without_oldest(MEMORY * self.n_points))

    def _with_new(self, state: TrackerState) -> TrackerState:
        missing = self.n_points - int(state.known.alive.sum())
        looks = missing >= REFILL * self.n_points and state.rested >= REST
        return refilled(state, missing, self.spacing) if looks else state

    # --- batch ---

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: PointTrajectory | None = None
    ) -> Smoothed[PointTrajectory]:
        """Points in all frames, given what all frames show and what other chains say.

        In pictures points are followed from frame to frame as in filtering. In later rounds the points of the
        round before are looked for again, in all frames: wherever other chains say that they are, and from
        where they were found first; there are no others. Identities that others take for one point, and that
        look alike, are one, and so are those that are found on one spot again and again.
        """
        others = [incoming.others(PointTracks) for incoming in incoming_over_time]
        if any(incoming.frame.image is not None for incoming in incoming_over_time):
            search = _Search(self, incoming_over_time, others, current)
            evidence, known = search.run()
            trajectory = replace(
                self._smoothed(evidence, search.others, incoming_over_time),
                looks=Looks(known.identities, known.first, known.patches),
                absorbed=np.array(sorted(search.same.items()), np.int64).reshape(-1, 2),
            )
        else:
            pairs = zip(incoming_over_time, others, strict=True)
            evidence = [incoming.search(PointTracks, message) for incoming, message in pairs]
            trajectory = self._smoothed(evidence, others, incoming_over_time)
        return Smoothed(trajectory, {incoming_over_time[0].node(PointTracks): evidence})

    def messages(self, trajectory: PointTrajectory, feature: PointTracks) -> list[PointMessage]:
        """Where the evidence of all other frames says that points are (mu_{R -> F}): nobody hears
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
        seen = Gathered.of([message.positions for message in evidence], times)
        expected = Gathered.of([message.positions for message in others], times, seen.identities)
        motion = learned_motion(
            seen.measured, None if self.acceleration is None else LASTS * self.acceleration**2
        )
        views = [message.view for message in evidence if message.view is not None]
        greys = [view.grey for view in views if view.grey is not None]
        limit = self.limit if greys or not views else GIVEN_LIMIT * views[0].noise
        return smoothed_trajectory(seen, expected, motion, limit, greys[0].shape if greys else None)


class _Search:
    """A look at all frames of a sequence, from the first to the last, as filtering does it.

    Attributes
    ----------
    same
        identities that are one point.
    others
        what others say of points, once for each.
    """

    def __init__(
        self,
        tracker: PointTracker,
        incoming_over_time: Sequence[BatchIncoming],
        others: Sequence[PointMessage],
        current: PointTrajectory | None,
    ) -> None:
        self._tracker, self._incoming, self._current = tracker, incoming_over_time, current
        self._all_others = others
        self._unite({} if current is None else same_points(current, others))

    def run(self) -> tuple[list[PointMessage], KnownPoints]:
        """What frames show of points, and those points."""
        found = self._followed()
        if self._current is not None:
            pairs = on_one_spot(found[0], SPOT)
            if pairs:
                self._unite(united(self.same, pairs))
                found = self._followed()
        return found

    def _unite(self, same: Same) -> None:
        self.same = same
        self.others = [renamed(message, same) for message in self._all_others]

    def _followed(self) -> tuple[list[PointMessage], KnownPoints]:
        state, last = None, 0.0
        evidence = []
        for time, (incoming, others) in enumerate(zip(self._incoming, self.others, strict=True)):
            frame = incoming.frame
            if state is not None:
                state = predicted(state, frame.time - last)
            elif not frame.missing:
                state = self._beginning(frame)
            last = frame.time
            if state is None:
                evidence.append(incoming.search(PointTracks, others))
            else:
                state, seen = self._looked(state, incoming, others, time)
                evidence.append(seen)
        return evidence, KnownPoints.none() if state is None else state.known

    def _looked(
        self, state: TrackerState, incoming: BatchIncoming, others: PointMessage, time: int
    ) -> tuple[TrackerState, PointMessage]:
        """The state after a look at a frame, and what was seen.

        A point that begins in the frame is looked for there at once: what cannot be told from its
        surroundings in the very picture that it was cut from is no point.
        """
        prior = message_of(state) * others
        seen: PointMessage = incoming.search(PointTracks, prior)
        before = followed(state, others * seen, learns=self._tracker.acceleration is None)
        if seen.view is None:
            return before, seen
        if seen.view.grey is None:
            return with_given(before, others * seen), seen
        after = (
            self._tracker._with_new(before)
            if self._current is None
            else self._begun_again(before, others, time)
        )
        known = after.known
        new = known.alive & ~np.isin(known.identities, before.known.identities[before.known.alive])
        if not new.any():
            return after, seen
        begun = message_of(replace(after, known=known.only(new)))
        patches = Patches(known.identities, known.patches)
        seen = incoming.search(
            PointTracks, PointMessage(prior.positions * begun.positions, patches, prior.view)
        )
        found = NOBODY if seen.view is None else seen.view.found.identities
        alive = known.alive & ~(new & ~np.isin(known.identities, found))
        return replace(after, known=replace(known, alive=alive), view=seen.view), seen

    def _beginning(self, frame: Frame) -> TrackerState:
        """In later rounds the looks of all points are known, and no position."""
        state, current = self._tracker.initial(frame), self._current
        if current is None or current.looks is None:
            return state
        looks = current.looks
        kept = np.isin(looks.identities, current.identities) & ~np.isin(looks.identities, list(self.same))
        return replace(
            state, known=KnownPoints.lost(looks.identities[kept], looks.first[kept], looks.first[kept])
        )

    def _begun_again(self, state: TrackerState, others: PointMessage, time: int) -> TrackerState:
        """With points that were found first in this frame in the round before, unless others know better."""
        known, view, current = state.known, state.view, self._current
        if current is None or current.looks is None or view is None:
            return state
        first = np.flatnonzero(current.observed[time] & ~current.observed[:time].any(axis=0))
        names, once = np.unique(rename(current.identities[first], self.same), return_index=True)
        points = first[once]
        position = current.position[time, points]
        begins = ~known.alive[known.places_of(names)] & _plausible(others.positions, names, position)
        points, places, position = points[begins], known.places_of(names[begins]), position[begins]
        patches = known.patches.copy()
        patches[places] = current.looks.first[current.looks.places_of(current.identities[points])]
        states = starting(state, view, position, BORN**2 * np.eye(2))
        return replace(state, known=replace(known, patches=patches).with_states(places, states))


NOBODY = np.zeros(0, np.int64)


def _plausible(others: GaussianMessage, identities: Identities, positions: Numbers) -> Mask:
    """`(n,)`: whether points may be at `positions`, `(n, 2)` px, as far as anything is said of them."""
    known, mean, covariance = others.only(np.isin(others.identities, identities)).moments
    place = np.searchsorted(identities, known)
    off = positions[place] - mean
    spread = covariance + BORN**2 * np.eye(2)
    plausible = np.ones(len(identities), np.bool_)
    plausible[place] = squared_distances(off, spread) <= FAR**2
    return plausible

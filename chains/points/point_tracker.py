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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import PointMessage, PointTracks
from .film_search import FilmSearch
from .known_points import KnownPoints
from .motion_noise import estimate_motion
from .tracker import GIVEN_LIMIT, TrackerState, message_of, predicted, replenished, updated, with_given
from .trajectory import Appearances, PointTrajectory, StackedMessages, smoothed_trajectory

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
        return self._empty()

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
        state = updated(state, others, learns=self.acceleration is None)
        if others.view is not None:
            state = self._replenished(state) if others.view.grey is not None else with_given(state, others)
        return replace(state, known=state.known.without_oldest(REMEMBERED * self.n_points))

    def _empty(self) -> TrackerState:
        density = ACCELERATION_TIME * (self.acceleration or FIRST_ACCELERATION) ** 2
        return TrackerState(KnownPoints.none(), 0, density, self.limit, np.inf, None)

    def _replenished(self, state: TrackerState) -> TrackerState:
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
            search = FilmSearch(
                self._empty(),
                self._replenished,
                self.acceleration is None,
                incoming_over_time,
                others,
                current,
            )
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

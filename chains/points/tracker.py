"""Points that a tracker knows, from frame to frame: found again, lost, recognised, and new ones taken up.

Steps of the tracker of RSMCM §4.3, from one state to the next.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...inference import kalman
from ...inference.kalman import STATE, PointStates
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.numerics.densities import squared_distances
from ...models.points.patches import Patches, ncc, with_light_of
from ...models.points.point_tracks import PointMessage, View
from .trajectory import MEDIAN

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]
Pixels = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class KnownPoints:
    """Points by identity.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    states
        of `n` points; meaningless of those that are not alive.
    alive
        `(n,)`: which ones are followed.
    unseen
        `(n,)` s since a frame showed the point.
    first, patches
        `(n, side, side)` float32 grey values: what the point looked like at first, and what it is taken to
        look like now; 0 where points come without pictures.
    """

    identities: Identities
    states: PointStates
    alive: Mask
    unseen: Numbers
    first: Pixels
    patches: Pixels

    @classmethod
    def none(cls) -> "KnownPoints":
        """No points."""
        return cls.new(
            np.zeros(0, np.int64), PointStates.at_rest([], 1.0, 1.0), np.zeros((0, 0, 0), np.float32)
        )

    @classmethod
    def new(cls, identities: Identities, states: PointStates, patches: Pixels) -> "KnownPoints":
        """Points that have just been seen, `identities` in order."""
        count = len(identities)
        return cls(identities, states, np.ones(count, np.bool_), np.zeros(count), patches, patches)

    @classmethod
    def lost(cls, identities: Identities, first: Pixels, patches: Pixels) -> "KnownPoints":
        """Points of which only the patches are known."""
        count = len(identities)
        states = PointStates(np.zeros((count, STATE)), np.tile(np.eye(STATE), (count, 1, 1)))
        return cls(identities, states, np.zeros(count, np.bool_), np.full(count, np.inf), first, patches)

    def __len__(self) -> int:
        return len(self.identities)

    def only(self, kept: Mask | NDArray[np.intp]) -> "KnownPoints":
        """Those of whom `kept` is true, or at these places."""
        states = PointStates(self.states.mean[kept], self.states.covariance[kept])
        arrays = {name.name: getattr(self, name.name)[kept] for name in fields(self) if name.name != "states"}
        return KnownPoints(states=states, **arrays)

    def joined(self, others: "KnownPoints") -> "KnownPoints":
        """These and others, of other identities."""
        if not len(others):
            return self
        if not len(self):
            return others

        def both(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([one, other])

        states = PointStates(
            both(self.states.mean, others.states.mean), both(self.states.covariance, others.states.covariance)
        )
        arrays = {
            name.name: both(getattr(self, name.name), getattr(others, name.name))
            for name in fields(self)
            if name.name != "states"
        }
        together = KnownPoints(states=states, **arrays)
        return together.only(np.argsort(together.identities))

    def places_of(self, identities: Identities) -> NDArray[np.intp]:
        """`(m,)`: where points of these identities are, which must be known."""
        return np.searchsorted(self.identities, identities)

    def without_oldest(self, most: int) -> "KnownPoints":
        """As they are, but of those that are not alive only the `most` that were seen last."""
        lost = np.flatnonzero(~self.alive)
        if len(lost) <= most:
            return self
        kept = self.alive.copy()
        # of two that were lost at the same time the later one stays
        kept[lost[np.lexsort((-self.identities[lost], self.unseen[lost]))[:most]]] = True
        return self.only(kept)

    def with_states(self, places: NDArray[np.intp], states: PointStates) -> "KnownPoints":
        """As they are, but with other states at some places, alive and just seen."""
        mean, covariance = self.states.mean.copy(), self.states.covariance.copy()
        alive, unseen = self.alive.copy(), self.unseen.copy()
        mean[places], covariance[places] = states.mean, states.covariance
        alive[places], unseen[places] = True, 0.0
        return replace(self, states=PointStates(mean, covariance), alive=alive, unseen=unseen)


LEAST_ACCELERATION = 450.0
"""px^2/s^3, to which learning goes down where there is a picture: any camera may be touched."""

FIRST_SPEED = 100.0
"""px/s, standard deviation of the velocity of a point that is new, where there is a picture."""

GIVEN_ACCELERATION, GIVEN_SPEED, GIVEN_LIMIT = 3.0, 10.0, 10.0
"""What is taken for given points, whose unit is not known. The first acceleration: noise by which a point
leaves its way in 40 ms. The first speed: extents of the whole that a point crosses in a second. The limit:
noise."""

REFILL = 0.05
"""Share of the points that are missing before new ones are sought."""

CORNER_INTERVAL = 0.1
"""s between two searches for corners, where there may be no others."""

LEAST_POINTS = 8
"""Points that show how all of them move."""

ADAPTATION_TIME, MOST_SURPRISE = 0.18, 3.0
"""s in which the log of the acceleration follows that of the finds, to 1/e; and the most that one picture's
finds say."""

SAME_PLACE = 1.5
"""px: points that are found nearer to each other are on one spot."""

NEW_DEVIATION = 0.3
"""px, standard deviation of a new point's position: it is its patch that says where it is."""

PATCH_TIME = 0.38
"""s in which a patch follows what finds of it look like, to 1/e."""

LIKE_FIRST, LIKE_EXPECTED = 0.7, 0.95
"""Normalised correlation with the first patch, down to which a find is trusted to teach, and with the last,
from which on there is nothing to learn."""


@short_repr
@dataclass(frozen=True, eq=False)
class TrackerState:
    """Points, and the picture that they were found in last.

    Parameters
    ----------
    known
        points that are followed, or were lost lately.
    next_identity
        number of the next new point: none is used twice.
    acceleration
        px^2/s^3, spectral density of the white acceleration along each coordinate.
    limit
        px, standard deviation of a position from which a point is lost.
    rested
        s since corners were sought.
    view
        the last picture, or points given for it, and what was found there; `None` before the first.
    """

    known: KnownPoints
    next_identity: int
    acceleration: float
    limit: float
    rested: float
    view: View | None


def message_of(state: TrackerState) -> PointMessage:
    """Where points should be, what they look like (also those that were lost), and the picture before."""
    known = state.known
    followed = known.only(known.alive)
    positions = GaussianMessage.from_moments(
        followed.identities, followed.states.position, followed.states.position_covariance
    )
    return PointMessage(positions, Patches(known.identities, known.patches), state.view)


def predicted(state: TrackerState, dt: float) -> TrackerState:
    """Points move on at their velocities for `dt` s."""
    known = state.known
    states = kalman.predict(known.states, dt, state.acceleration)
    known = replace(known, states=states, unseen=known.unseen + dt)
    return replace(state, known=known, rested=state.rested + dt)


def updated(state: TrackerState, message: PointMessage, *, learns: bool) -> TrackerState:
    """Points after all that is said of them: those that are found again, and without those that are lost.

    Parameters
    ----------
    message
        evidence, times the messages of others.
    learns
        whether the acceleration is learned.
    """
    view = message.view
    elapsed = 0.0 if view is None or state.view is None else view.time - state.view.time
    state = _measured(state, message, elapsed, learns=learns)
    state = _without_ended(replace(state, view=view or state.view))
    return state if view is None or view.grey is None else _with_patches(state, view, elapsed)


def with_given(state: TrackerState, message: PointMessage) -> TrackerState:
    """With points that are given for the first time, under their own identities."""
    view = message.view
    if view is None:
        return state
    new = np.isin(message.positions.identities, view.found.identities)
    new &= ~np.isin(message.positions.identities, state.known.identities)
    identities, mean, covariance = message.positions.only(new).moments
    states = initial_states(state, view, mean, covariance)
    patches = np.zeros((len(identities), view.patch, view.patch), np.float32)
    largest = int(identities.max(initial=state.next_identity - 1))
    known = state.known.joined(KnownPoints.new(identities, states, patches))
    return replace(state, known=known, next_identity=largest + 1)


def replenished(state: TrackerState, n_points: int, spacing: float) -> TrackerState:
    """With new points where the picture has corners, `spacing` px from all that are followed.

    As many as are missing of `n_points`; but only if many are, and if none were sought lately.
    """
    known, view = state.known, state.view
    missing = n_points - int(known.alive.sum())
    if view is None or missing < max(1, REFILL * n_points) or state.rested < CORNER_INTERVAL:
        return state
    corners = view.corners(missing, known.states.position[known.alive], spacing)
    identities = state.next_identity + np.arange(len(corners))
    states = initial_states(state, view, corners, NEW_DEVIATION**2 * np.eye(2))
    return replace(
        state,
        known=known.joined(KnownPoints.new(identities, states, view.patches_at(corners))),
        next_identity=state.next_identity + len(corners),
        rested=0.0,
        view=view.with_found(identities, corners),
    )


def initial_states(state: TrackerState, view: View, mean: Numbers, covariance: Numbers) -> PointStates:
    """Points that begin in a frame, and are taken to move like the others.

    Parameters
    ----------
    view
        of the frame.
    mean, covariance
        `(n, 2)` px and `(n, 2, 2)` or `(2, 2)` px^2 of their positions.
    """
    known = state.known
    if view.grey is None:
        places = view.found.positions
        extent = (np.nanmax(places, axis=0) - np.nanmin(places, axis=0)).max()
        states = PointStates.at_rest(mean, 0.0, GIVEN_SPEED * max(extent, view.noise))
    else:
        states = PointStates.at_rest(mean, 0.0, FIRST_SPEED)
        moving = known.states.mean[known.alive & (known.unseen == 0)][:, 2:]
        if len(moving) >= LEAST_POINTS:
            velocity = np.median(moving, axis=0)
            spread = 1.4826 * np.median(np.abs(moving - velocity), axis=0)
            states.mean[:, 2:] = velocity
            states.covariance[:, [2, 3], [2, 3]] = (2 * spread + 0.1 * FIRST_SPEED) ** 2
    states.covariance[:, :2, :2] = covariance
    return states


def _measured(state: TrackerState, message: PointMessage, elapsed: float, *, learns: bool) -> TrackerState:
    """With all that is said of points that are followed, and with those back that are found again.

    `elapsed`: s since the picture before.
    """
    known, view = state.known, message.view
    if view is not None and view.grey is None and not len(known):
        state = _in_unit_of(state, view, learns=learns)
    mentioned = np.isin(message.positions.identities, known.identities)
    positions = message.positions.only(mentioned).among(known.identities)
    states = kalman.update(
        known.states,
        positions.information * known.alive[:, None, None],
        positions.vector * known.alive[:, None],
    )
    seen = np.zeros(len(known), np.bool_)
    if view is not None:
        seen = np.isin(known.identities, view.found.identities)
        if learns:
            least = 0.0 if view.grey is None else LEAST_ACCELERATION
            acceleration = _adapted_acceleration(
                state, positions, seen & known.alive & positions.proper, elapsed
            )
            state = replace(state, acceleration=max(acceleration, least))
    known = replace(known, states=states, unseen=np.where(seen, 0.0, known.unseen))
    again = np.flatnonzero(seen & ~known.alive & positions.proper)
    if len(again) and view is not None:
        _, mean, covariance = positions.only(again).moments
        known = known.with_states(again, initial_states(state, view, mean, covariance))
    return replace(state, known=known)


def _in_unit_of(state: TrackerState, view: View, *, learns: bool) -> TrackerState:
    """With scales that suit points whose unit is not known."""
    acceleration = 3 * (GIVEN_ACCELERATION * view.noise) ** 2 / 0.04**3 if learns else state.acceleration
    return replace(state, acceleration=acceleration, limit=GIVEN_LIMIT * view.noise)


def _adapted_acceleration(
    state: TrackerState, positions: GaussianMessage, seen: Mask, elapsed: float
) -> float:
    """Acceleration, px^2/s^3, after points were found so far from where they were expected.

    The median of the squared distances, in units of their covariances, is moved towards what it should be.
    """
    if seen.sum() < LEAST_POINTS:
        return state.acceleration
    noise = np.linalg.inv(positions.information[seen])
    off = (noise @ positions.vector[seen][:, :, None])[:, :, 0] - state.known.states.position[seen]
    spread = noise + state.known.states.position_covariance[seen]
    surprise = np.log(np.median(squared_distances(off, spread)) / MEDIAN + 1e-9)
    share = -np.expm1(-elapsed / ADAPTATION_TIME)
    return float(state.acceleration * np.exp(share * np.clip(surprise, -MOST_SURPRISE, MOST_SURPRISE)))


def _without_ended(state: TrackerState) -> TrackerState:
    """Without points that nobody knows well enough any more, that left the picture, or sit on an older
    one."""
    known, view = state.known, state.view
    states = known.states
    alive = known.alive & (0.5 * np.trace(states.position_covariance, axis1=1, axis2=2) <= state.limit**2)
    if view is not None and view.grey is not None:
        far = np.array([view.grey.shape[1], view.grey.shape[0]]) - 0.5
        alive &= ((states.position >= -0.5) & (states.position <= far)).all(axis=1)
        seen = np.flatnonzero(alive & (known.unseen == 0))
        pairs = cKDTree(states.position[seen]).query_pairs(SAME_PLACE, output_type="ndarray")
        alive[seen[pairs.max(axis=1)]] = False
    return replace(state, known=replace(known, alive=alive))


def _with_patches(state: TrackerState, view: View, elapsed: float) -> TrackerState:
    """With what points look like now, where they were found.

    Brightness and contrast are the find's. A patch that took over the rest as well would slide off its point
    with every find's error: so a find that looks as expected teaches nothing, one that is not like the
    first patch teaches nothing either, and others a little.
    """
    known = state.known
    seen = np.flatnonzero(known.alive & (known.unseen == 0))
    if not len(seen):
        return state
    place = np.searchsorted(view.found.identities, known.identities[seen])
    now = view.patches_at(view.found.positions[place])
    expected = with_light_of(known.patches[seen], now)
    teaches = (ncc(now, expected) < LIKE_EXPECTED) & (ncc(now, known.first[seen]) > LIKE_FIRST)
    patches = known.patches.copy()
    share = np.where(teaches, -np.expm1(-elapsed / PATCH_TIME), 0.0).astype(np.float32)
    patches[seen] = expected + share[:, None, None] * (now - expected)
    return replace(state, known=replace(known, patches=patches))

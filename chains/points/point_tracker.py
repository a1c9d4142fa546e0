"""Tracker of single points: a first-order Kalman filter each, and what each one looks like (RSMCM §4.3).

p(x(t + dt) | x(t)) = prod_i N(x_i(t + dt); A(dt) x_i(t), q Q(dt)),    p(F | x) = prod_i delta(u_i - H x_i)

x_i are position H x_i (px) and velocity (px/s) of point i, with white acceleration of density q (px^2/s^3);
A and Q are those of `kinematic(2, dt)`. F holds positions u_i and patches a_i by identity. The message to F
is prod_i N(u_i; H m_i, H P_i H^T), the predicted positions, with the patches; the evidence is where the
picture shows these patches (`PointTracks`).

Points are tracked independently. Alone, the chain loses a point that is hidden for a while, and gives it a
new identity when it is seen again. With a second chain over the same points, that chain's prediction is a
virtual observation: it keeps a point alive, and gives the position at which a lost one is searched for.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...inference import kalman
from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...inference.kalman import STATE, PointStates
from ...models.core.checks import NO_NAN, Count, CountFrom0, NotNegativeOrInfinite, Positive, Shape, checked
from ...models.core.frame import Frame, GivenPoints
from ...models.core.gaussian_message import GaussianMessage, squared_distances
from ...models.core.identities import places_of
from ...models.core.short_repr import Rows, short_repr
from ...models.points.patches import NOISE, Patches, find_corners, match_light, ncc
from ...models.points.point_tracks import PointMessage, PointTracks, View
from ...models.points.search import MIN_STD
from .trajectory import (
    MEDIAN,
    Appearances,
    PointTrajectory,
    StackedMessages,
    estimate_motion,
    smoothed_trajectory,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]
Pixels = NDArray[np.float32]
OfSides = Annotated[Pixels, Shape("n", "side", "side")]


@short_repr
@dataclass(frozen=True, eq=False)
class PointTable(Rows):
    """Points by identity, tracked and lately lost ones."""

    identities: Annotated[Identities, Shape("n")]  # increasing
    mean: Annotated[Array, Shape("n", STATE)]  # of their states; undefined unless alive
    covariance: Annotated[Array, Shape("n", STATE, STATE)]
    alive: Annotated[Mask, Shape("n")]  # tracked
    unseen: Annotated[Array, Shape("n", finite=False), NO_NAN]  # s since a frame showed the point
    first: OfSides  # first patch; 0 where points come without pictures
    patches: OfSides  # current patch
    cut: Annotated[Array, Shape("n")]  # s: time of the picture from which it was first cut

    @classmethod
    def none(cls) -> "PointTable":
        """Return an empty table."""
        nothing = np.zeros((0, 0, 0), np.float32)
        return cls.new(np.zeros(0, np.int64), PointStates.at_rest([], 1.0, 1.0), nothing, 0.0)

    @classmethod
    def new(cls, identities: Identities, states: PointStates, patches: Pixels, time: float) -> "PointTable":
        """Return points that have just been seen, `identities` in order, in the picture of a time, s."""
        alive, unseen = np.ones(len(identities), np.bool_), np.zeros(len(identities))
        cut = np.full(len(identities), time)
        return cls(identities, states.mean, states.covariance, alive, unseen, patches, patches, cut)

    @classmethod
    def lost(cls, identities: Identities, patches: Pixels, cut: Array) -> "PointTable":
        """Return lost points with patches, which were `cut` at these times, and without positions."""
        mean, covariance = np.zeros((len(identities), STATE)), np.tile(np.eye(STATE), (len(identities), 1, 1))
        alive, unseen = np.zeros(len(identities), np.bool_), np.full(len(identities), np.inf)
        return cls(identities, mean, covariance, alive, unseen, patches, patches, cut)

    @property
    def states(self) -> PointStates:
        """States of all points."""
        return PointStates(self.mean, self.covariance)

    def __len__(self) -> int:
        return len(self.identities)

    def merged(self, others: "PointTable") -> "PointTable":
        """Return these points and others with other identities, in order."""
        if not len(others) or not len(self):
            return self if len(self) else others
        together = self.joined([others])
        return together.only(np.argsort(together.identities))

    def without_oldest(self, most: int) -> "PointTable":
        """Return the points that are alive and, of the others, the `most` that were seen last."""
        lost = np.flatnonzero(~self.alive)
        if len(lost) <= most:
            return self
        kept = self.alive.copy()
        # of two that were lost at the same time keep the younger one
        kept[lost[np.lexsort((-self.identities[lost], self.unseen[lost]))[:most]]] = True
        return self.only(kept)

    def with_states(self, places: NDArray[np.intp], states: PointStates) -> "PointTable":
        """Return the table with new states in some rows, which are alive and just seen."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        alive, unseen = self.alive.copy(), self.unseen.copy()
        mean[places], covariance[places] = states.mean, states.covariance
        alive[places], unseen[places] = True, 0.0
        return replace(self, mean=mean, covariance=covariance, alive=alive, unseen=unseen)


LEAST_ACCELERATION = 450.0
"""px^2/s^3: least learned acceleration in pictures, since any camera may be touched."""

INITIAL_VELOCITY_STD = 100.0  # px/s: standard deviation of the velocity of a new point in a picture

GIVEN_ACCELERATION, GIVEN_VELOCITY_STD, GIVEN_LIMIT = 3.0, 10.0, 10.0
"""For given points, whose unit is unknown: initial acceleration, in noise of a position after 40 ms; standard
deviation of the initial velocity, in extents of all points a second; that of a lost position, in noise."""

REFILL = 0.05  # share of missing points from which on corners are searched for
CORNER_INTERVAL = 0.1  # s: least time between two searches for corners
LEAST_POINTS = 8  # fewest points from which a common motion is estimated

ADAPTATION_TIME, MOST_SURPRISE = 0.18, 3.0
"""s: time constant of the log acceleration; and the largest change of it that one picture asks for."""

SAME_PLACE = 1.5  # px: of two points found nearer to each other the younger one ends
NEW_POINT_STD = 0.3  # px: standard deviation of a new point's position, which its patch defines
PATCH_TIME = 0.38  # s: time constant of patches

LIKE_FIRST, LIKE_EXPECTED = 0.7, 0.95
"""A patch is updated with a correlation above the first of these with the first patch, and below the second
with the current one."""


@short_repr
@dataclass(frozen=True, eq=False)
class TrackerState:
    """Points, and the last picture."""

    known: PointTable  # tracked and lately lost points
    next_identity: CountFrom0  # of the next new point: none is used twice
    acceleration: Positive  # px^2/s^3, spectral density of the white acceleration of each coordinate
    max_position_std: Positive  # px, standard deviation of a position from which a point is lost
    since_corner_search: NotNegativeOrInfinite  # s since corners were sought
    view: View | None  # the last picture, or points given for it, and what was found there

    def require_fit(self) -> None:
        """Raise a `ValueError` if an identity would be used again, or patches are of another size."""
        identities, side = self.known.identities, self.known.patches.shape[1]
        if (np.diff(identities) <= 0).any() or self.next_identity <= identities.max(initial=-1):
            raise ValueError(
                f"identities: got {len(identities)}, expected them below {self.next_identity}, in order"
            )
        if self.view is not None and len(identities) and self.view.patch_size != side:
            raise ValueError(f"view: got patches of {self.view.patch_size} px, expected {side} px")


def predict_message(state: TrackerState) -> PointMessage:
    """Return predicted positions, patches (also of lost points), and the last picture."""
    known = state.known
    followed = known.only(known.alive)
    positions = GaussianMessage.from_moments(
        followed.identities, followed.states.position, followed.states.position_covariance
    )
    return PointMessage(positions, Patches(known.identities, known.patches), state.view)


def predict_state(state: TrackerState, dt: float) -> TrackerState:
    """Predict the state `dt` seconds ahead."""
    known = state.known
    states = kalman.predict(known.states, dt, state.acceleration)
    known = replace(known, mean=states.mean, covariance=states.covariance, unseen=known.unseen + dt)
    return replace(state, known=known, since_corner_search=state.since_corner_search + dt)


def update_state(state: TrackerState, message: PointMessage, *, learns: bool) -> TrackerState:
    """Update points with the evidence and the messages of others, and end those that are lost.

    `learns`: whether the acceleration is learned.
    """
    view = message.view
    elapsed = 0.0 if view is None or state.view is None else view.time - state.view.time
    state = _with_measurements(state, message, elapsed, learns=learns)
    state = _end_points(replace(state, view=view or state.view))
    return state if view is None or view.grey is None else _update_patches(state, view, elapsed)


def add_given_points(state: TrackerState, message: PointMessage) -> TrackerState:
    """Add points that are given for the first time, under their own identities."""
    view = message.view
    if view is None:
        return state
    new = np.isin(message.positions.identities, view.points.identities)
    new &= ~np.isin(message.positions.identities, state.known.identities)
    identities, mean, covariance = message.positions.only(new).moments
    states = initial_states(state, view, mean, covariance)
    patches = np.zeros((len(identities), view.patch_size, view.patch_size), np.float32)
    largest = int(identities.max(initial=state.next_identity - 1))
    known = state.known.merged(PointTable.new(identities, states, patches, view.time))
    return replace(state, known=known, next_identity=largest + 1)


def replenish(state: TrackerState, n_points: int, spacing: float) -> TrackerState:
    """Add new points at corners of the picture, `spacing` px from all tracked ones."""
    known, view = state.known, state.view
    missing = n_points - int(known.alive.sum())
    if missing < max(1, REFILL * n_points) or state.since_corner_search < CORNER_INTERVAL:
        return state
    if view is None or view.grey is None:
        return state
    corners = find_corners(view.grey, missing, known.states.position[known.alive], spacing, view.patch_size)
    identities = state.next_identity + np.arange(len(corners))
    states = initial_states(state, view, corners, NEW_POINT_STD**2 * np.eye(2))
    return replace(
        state,
        known=known.merged(PointTable.new(identities, states, view.patches_at(corners), view.time)),
        next_identity=state.next_identity + len(corners),
        since_corner_search=0.0,
        view=replace(view, points=view.points.joined([GivenPoints(corners, identities)])),
    )


def initial_states(state: TrackerState, view: View, mean: Array, covariance: Array) -> PointStates:
    """Return states of new points, with the median velocity of the others."""
    known = state.known
    if view.grey is None:
        places = view.points.positions
        extent = (np.nanmax(places, axis=0) - np.nanmin(places, axis=0)).max()
        states = PointStates.at_rest(mean, 0.0, GIVEN_VELOCITY_STD * max(extent, view.noise))
    else:
        states = PointStates.at_rest(mean, 0.0, INITIAL_VELOCITY_STD)
        moving = known.states.mean[known.alive & (known.unseen == 0)][:, 2:]
        if len(moving) >= LEAST_POINTS:
            velocity = np.median(moving, axis=0)
            spread = 1.4826 * np.median(np.abs(moving - velocity), axis=0)
            states.mean[:, 2:] = velocity
            states.covariance[:, [2, 3], [2, 3]] = (2 * spread + 0.1 * INITIAL_VELOCITY_STD) ** 2
    states.covariance[:, :2, :2] = covariance
    return states


def _with_measurements(
    state: TrackerState, message: PointMessage, elapsed: float, *, learns: bool
) -> TrackerState:
    """Update tracked points with the product of all messages, and revive lost ones that are found."""
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
        seen = np.isin(known.identities, view.points.identities)
        if learns:
            least = 0.0 if view.grey is None else LEAST_ACCELERATION
            acceleration = _adapted_acceleration(
                state, positions, seen & known.alive & positions.proper, elapsed
            )
            state = replace(state, acceleration=max(acceleration, least))
    unseen = np.where(seen, 0.0, known.unseen)
    known = replace(known, mean=states.mean, covariance=states.covariance, unseen=unseen)
    again = np.flatnonzero(seen & ~known.alive & positions.proper)
    if len(again) and view is not None:
        _, mean, covariance = positions.only(again).moments
        known = known.with_states(again, initial_states(state, view, mean, covariance))
    return replace(state, known=known)


def _in_unit_of(state: TrackerState, view: View, *, learns: bool) -> TrackerState:
    """Set acceleration and largest standard deviation for points whose unit is unknown."""
    acceleration = 3 * (GIVEN_ACCELERATION * view.noise) ** 2 / 0.04**3 if learns else state.acceleration
    return replace(state, acceleration=acceleration, max_position_std=GIVEN_LIMIT * view.noise)


def _adapted_acceleration(
    state: TrackerState, positions: GaussianMessage, seen: Mask, elapsed: float
) -> float:
    """Return the acceleration, px^2/s^3, adapted to the innovations of the points."""
    if seen.sum() < LEAST_POINTS:
        return state.acceleration
    noise = np.linalg.inv(positions.information[seen])
    off = (noise @ positions.vector[seen][:, :, None])[:, :, 0] - state.known.states.position[seen]
    spread = noise + state.known.states.position_covariance[seen]
    surprise = np.log(np.median(squared_distances(off, spread)) / MEDIAN + 1e-9)
    share = -np.expm1(-elapsed / ADAPTATION_TIME)
    return float(state.acceleration * np.exp(share * np.clip(surprise, -MOST_SURPRISE, MOST_SURPRISE)))


def _end_points(state: TrackerState) -> TrackerState:
    """End points that are too uncertain, outside the picture, or on an older point."""
    known, view = state.known, state.view
    states = known.states
    alive = known.alive & (
        0.5 * np.trace(states.position_covariance, axis1=1, axis2=2) <= state.max_position_std**2
    )
    if view is not None and view.grey is not None:
        far = np.array([view.grey.shape[1], view.grey.shape[0]]) - 0.5
        alive &= ((states.position >= -0.5) & (states.position <= far)).all(axis=1)
        seen = np.flatnonzero(alive & (known.unseen == 0))
        pairs = cKDTree(states.position[seen]).query_pairs(SAME_PLACE, output_type="ndarray")
        alive[seen[pairs.max(axis=1)]] = False
    return replace(state, known=replace(known, alive=alive))


def _update_patches(state: TrackerState, view: View, elapsed: float) -> TrackerState:
    """Update the patches of points that were found.

    Brightness and contrast are those of the picture. The rest changes slowly, and only if the picture differs
    from the current patch and is still like the first one: else the error of every position would shift the
    patch off its point.
    """
    known = state.known
    seen = np.flatnonzero(known.alive & (known.unseen == 0))
    if not len(seen):
        return state
    place = places_of(view.points.identities, known.identities[seen])
    now = view.patches_at(view.points.positions[place])
    expected = match_light(known.patches[seen], now)
    teaches = (ncc(now, expected) < LIKE_EXPECTED) & (ncc(now, known.first[seen]) > LIKE_FIRST)
    patches = known.patches.copy()
    share = np.where(teaches, -np.expm1(-elapsed / PATCH_TIME), 0.0).astype(np.float32)
    patches[seen] = expected + share[:, None, None] * (now - expected)
    return replace(state, known=replace(known, patches=patches))


Duplicates = Mapping[int, int]
"""Identity of a duplicate, and the smallest identity of its point."""

LEAST_NCC = 0.7
"""Least correlation of two points, at their most similar patches, that other chains take for one."""

LEAST_FRAMES = 5  # frames in which two points are found at one place before they are joined


def find_duplicates(trajectory: PointTrajectory, others: Sequence[PointMessage]) -> dict[int, int]:
    """Return earlier duplicates, and those that other chains take for one point and that look alike."""
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
    one, other = places_of(seen.identities, pairs.T)
    alike = np.max(
        [ncc(a[one], b[other]) for a in (seen.first, seen.last) for b in (seen.first, seen.last)],
        axis=0,
    )
    return merge_groups(same, pairs[alike >= LEAST_NCC])


def merge_groups(same: Duplicates, pairs: Iterable[Sequence[int]]) -> dict[int, int]:
    """Return the groups with further pairs joined: the smallest identity of each that is not itself."""
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


def merge_duplicates(message: PointMessage, same: Duplicates) -> PointMessage:
    """Return the message with each point once, under its smallest identity."""
    if not same:
        return message
    identities = smallest_identities(message.positions.identities, same)
    names, first = np.unique(identities, return_index=True)
    positions = replace(message.positions.only(first), identities=names)
    return PointMessage(positions, message.patches, message.view)


def smallest_identities(identities: Identities, same: Duplicates) -> Identities:
    """Return the smallest identity of each one's point, `(n,)`."""
    names: Identities = np.array(
        [same.get(int(identity), int(identity)) for identity in identities], np.int64
    )
    return names


def find_coincident_tracks(messages: Sequence[PointMessage], spot: float) -> list[tuple[int, int]]:
    """Return pairs of identities that were found within `spot` px in at least `LEAST_FRAMES` frames."""
    times: Counter[tuple[int, int]] = Counter()
    for message in messages:
        identities, mean, _ = message.positions.moments
        if len(identities) > 1:
            pairs = cKDTree(mean).query_pairs(spot, output_type="ndarray")
            times.update((int(one), int(other)) for one, other in identities[np.sort(pairs, axis=1)])
    return sorted(pair for pair, count in times.items() if count >= LEAST_FRAMES)


GATE = 3.0  # standard deviations from others' predictions within which a point may begin

NO_IDENTITIES = np.zeros(0, np.int64)


class FilmSearch:
    """Search for the points of all frames, one frame after the other as in filtering.

    After the first round there are no new points: those of the last round (`current`) are searched for at the
    positions that other chains predict, and from where they were found first. `same` are the duplicates, and
    `others` the messages of other chains with each point once.
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
        self._merge_identities({} if current is None else find_duplicates(current, others))

    def run(self) -> tuple[list[PointMessage], PointTable]:
        """Return the evidence of all frames, and the points."""
        found = self._track_all()
        if self._current is not None:
            pairs = find_coincident_tracks(found[0], SAME_PLACE)
            if pairs:
                self._merge_identities(merge_groups(self.same, pairs))
                found = self._track_all()
        evidence, known = found
        names, counts = np.unique(
            np.concatenate([message.positions.identities for message in evidence]), return_counts=True
        )
        alone = names[counts == 1]
        return [_without(message, alone) for message in evidence], known

    def _merge_identities(self, same: Duplicates) -> None:
        self.same = same
        self.others = [merge_duplicates(message, same) for message in self._all_others]

    def _track_all(self) -> tuple[list[PointMessage], PointTable]:
        state, last = None, 0.0
        evidence = []
        for number, (incoming, others) in enumerate(zip(self._incoming, self.others, strict=True)):
            frame = incoming.frame
            if state is not None:
                state = predict_state(state, frame.time - last)
            elif not frame.missing:
                state = self._initial_state()
            last = frame.time
            if state is None:
                evidence.append(incoming.search(PointTracks, others))
            else:
                state, seen = self._step(state, incoming, others, number)
                evidence.append(_with_usual_noise(seen, state.known))
        return evidence, PointTable.none() if state is None else state.known

    def _step(
        self, state: TrackerState, incoming: BatchIncoming, others: PointMessage, number: int
    ) -> tuple[TrackerState, PointMessage]:
        """Return the state after a frame, and its evidence."""
        prior = predict_message(state) * others
        seen = incoming.search(PointTracks, prior)
        before = update_state(state, others * seen, learns=self._tracker.learns)
        if seen.view is None:
            return before, seen
        if seen.view.grey is None:
            return add_given_points(before, others * seen), seen
        after = (
            self._tracker.replenish(before)
            if self._current is None
            else self._restart_points(before, others, number)
        )
        known = after.known
        new = known.alive & ~np.isin(known.identities, before.known.identities[before.known.alive])
        if not new.any():
            return after, seen
        begun = predict_message(replace(after, known=known.only(new)))
        patches = Patches(known.identities, known.patches)
        prior = PointMessage(prior.positions * begun.positions, patches, prior.view)
        seen = incoming.search(PointTracks, prior)
        found = NO_IDENTITIES if seen.view is None else seen.view.points.identities
        alive = known.alive & ~(new & ~np.isin(known.identities, found))
        return replace(after, known=replace(known, alive=alive), view=seen.view), seen

    def _initial_state(self) -> TrackerState:
        """Return the first state: without points, or with the patches of the last round."""
        current = self._current
        if current is None or current.appearances is None:
            return self._tracker.empty()
        seen = current.appearances
        kept = np.isin(seen.identities, current.identities) & ~np.isin(seen.identities, list(self.same))
        lost = PointTable.lost(seen.identities[kept], seen.first[kept], seen.cut[kept])
        return replace(self._tracker.empty(), known=lost)

    def _restart_points(self, state: TrackerState, others: PointMessage, number: int) -> TrackerState:
        """Restart the points that the last round found first in this frame, unless others contradict."""
        known, view, current = state.known, state.view, self._current
        if current is None or current.appearances is None or view is None:
            return state
        first = np.flatnonzero(current.observed[number] & ~current.observed[:number].any(axis=0))
        names, once = np.unique(smallest_identities(current.identities[first], self.same), return_index=True)
        points = first[once]
        position = current.position[number, points]
        places, seen = places_of(known.identities, names), current.appearances
        begins = ~known.alive[places] & _is_plausible(others.positions, names, position)
        points, places, position = points[begins], places[begins], position[begins]
        patches, cut, which = known.patches.copy(), known.cut.copy(), current.identities[points]
        which = places_of(seen.identities, which)
        patches[places], cut[places] = seen.first[which], seen.cut[which]
        states = initial_states(state, view, position, NEW_POINT_STD**2 * np.eye(2))
        return replace(state, known=replace(known, patches=patches, cut=cut).with_states(places, states))


def _without(message: PointMessage, alone: Identities) -> PointMessage:
    """Return the evidence without some points; given points stay."""
    if message.view is None or message.view.grey is None:
        return message
    stay = ~np.isin(message.positions.identities, alone)
    return replace(message, positions=message.positions.only(stay))


def _with_usual_noise(message: PointMessage, known: PointTable) -> PointMessage:
    """Return the evidence with the usual noise where a patch was compared with itself.

    There is no residual then, by which the noise is estimated otherwise.
    """
    view, positions = message.view, message.positions
    if view is None or view.grey is None:
        return message
    itself = np.isin(positions.identities, known.identities[known.cut == view.time])
    identities, mean, covariance = positions.moments
    least = MIN_STD**2 * np.eye(2)
    covariance = np.where(itself[:, None, None], NOISE**2 * (covariance - least) + least, covariance)
    usual = GaussianMessage.from_moments(identities, mean, covariance)
    return replace(message, positions=replace(usual, log_scale=usual.log_scale + np.log(view.grey.size)))


def _is_plausible(others: GaussianMessage, identities: Identities, positions: Array) -> Mask:
    """Return whether points may be at `positions` `(n, 2)` px by the others' messages, `(n,)`."""
    known, mean, covariance = others.only(np.isin(others.identities, identities)).moments
    place = places_of(identities, known)
    off = positions[place] - mean
    spread = covariance + NEW_POINT_STD**2 * np.eye(2)
    plausible = np.ones(len(identities), np.bool_)
    plausible[place] = squared_distances(off, spread) <= GATE**2
    return plausible


ACCELERATION_TIME = 0.5  # s: correlation time of the acceleration
FIRST_ACCELERATION = 300.0  # px/s^2: initial standard deviation, where it is learned in pictures
REMEMBERED = 4  # lost points that are kept in filtering, for each tracked one


@checked
@short_repr
@dataclass(frozen=True)
class PointTracker:
    """Tracker of independent points with constant velocity and random acceleration.

    In images, new points begin at corners without a tracked point. A point ends when it leaves the image,
    when its position is too uncertain, or when it coincides with an older one. Points given with the frames
    keep their identities; scales then follow from the noise of the feature node, in any unit.

    Parameters
    ----------
    n_points
        number of points to track in images.
    spacing
        px, minimum distance of a new point from the others.
    acceleration
        px/s^2, standard deviation of the acceleration, with a correlation time of half a second. By default
        it is learned such that half of the points are found inside their 50 % regions.
    max_position_std
        px (in images), standard deviation of a position above which a point is lost.
    """

    n_points: Count = 300
    spacing: Positive = 10.0
    acceleration: Positive | None = None
    max_position_std: Positive = 8.0
    name: str = "tracker"

    ports = (Port(PointTracks, sole="appearance"),)

    # --- filtering ---

    def initial(self, frame: Frame) -> TrackerState:
        """Return the state without points: they are found in the first frame."""
        return self.empty()

    def predict(self, state: TrackerState, dt: float) -> TrackerState:
        """Predict the state `dt` seconds ahead."""
        return predict_state(state, dt)

    def message(self, state: TrackerState, feature: PointTracks, incoming: Incoming) -> PointMessage:
        """Return predicted positions (mu_{X -> F}), patches, also of lost points, and the last image."""
        return predict_message(state)

    def update(self, state: TrackerState, incoming: Incoming) -> TrackerState:
        """Update points with a frame, end those that are lost and begin new ones."""
        others = incoming[PointTracks]
        state = update_state(state, others, learns=self.learns)
        if others.view is not None:
            state = self.replenish(state) if others.view.grey is not None else add_given_points(state, others)
        return replace(state, known=state.known.without_oldest(REMEMBERED * self.n_points))

    @property
    def learns(self) -> bool:
        """Whether the acceleration is learned."""
        return self.acceleration is None

    def empty(self) -> TrackerState:
        """Return the state without points."""
        density = ACCELERATION_TIME * (self.acceleration or FIRST_ACCELERATION) ** 2
        return TrackerState(PointTable.none(), 1, density, self.max_position_std, np.inf, None)

    def replenish(self, state: TrackerState) -> TrackerState:
        """Add new points for those that are missing."""
        return replenish(state, self.n_points, self.spacing)

    # --- batch ---

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: PointTrajectory | None = None
    ) -> Smoothed[PointTrajectory]:
        """Smooth the points of all frames, given all evidence and the messages of other chains.

        In images, points are tracked from frame to frame as in filtering. In later rounds the points of the
        last round are searched for again in all frames, at the positions that other chains predict; there are
        no new ones. Identities are joined if other chains consider them one point and their patches are
        similar, or if they coincide in several frames.
        """
        others = [incoming.others(PointTracks) for incoming in incoming_over_time]
        if any(incoming.frame.image is not None for incoming in incoming_over_time):
            search = FilmSearch(self, incoming_over_time, others, current)
            evidence, known = search.run()
            trajectory = replace(
                self._smooth_tracks(evidence, search.others, incoming_over_time),
                appearances=Appearances(known.identities, known.first, known.patches, known.cut),
                absorbed=np.array(sorted(search.same.items()), np.int64).reshape(-1, 2),
            )
        else:
            pairs = zip(incoming_over_time, others, strict=True)
            evidence = [incoming.search(PointTracks, message) for incoming, message in pairs]
            trajectory = self._smooth_tracks(evidence, others, incoming_over_time)
        return Smoothed(trajectory, {incoming_over_time[0].node(PointTracks): evidence})

    def messages(
        self,
        trajectory: PointTrajectory,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Return the positions by the evidence of all other frames (mu_{X -> F})."""
        return [PointMessage(positions) for positions in trajectory.messages()]

    def _smooth_tracks(
        self,
        evidence: Sequence[PointMessage],
        others: Sequence[PointMessage],
        incoming_over_time: Sequence[BatchIncoming],
    ) -> PointTrajectory:
        """Smooth the tracks of all points that were found in any frame."""
        times = np.array([incoming.frame.time for incoming in incoming_over_time])
        seen = StackedMessages.of([message.positions for message in evidence], times)
        expected = StackedMessages.of([message.positions for message in others], times, seen.identities)
        motion = estimate_motion(
            seen.measured, None if self.acceleration is None else ACCELERATION_TIME * self.acceleration**2
        )
        views = [message.view for message in evidence if message.view is not None]
        greys = [view.grey for view in views if view.grey is not None]
        max_position_std = self.max_position_std if greys or not views else GIVEN_LIMIT * views[0].noise
        return smoothed_trajectory(
            seen, expected, motion, max_position_std, greys[0].shape if greys else None
        )

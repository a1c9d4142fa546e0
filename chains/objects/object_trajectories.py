"""Trajectories of objects as a batch chain: who was where in every frame of a film, given all of it.

Of objects j with feet x_j and sizes w_j, in units of their own height:

    p(x_t | x_t-1), p(w_t | w_t-1): constant velocity but for white acceleration
    p(b_t | x_t, w_t) = N(b_t; (x_t, w_t), what the tracker says of its errors)
    mu_{trajectories -> boxes}(b_j) = N(b_j; smoothed box, its variance)

A tracker reports its blobs as frames come. This chain has all frames: it smooths every track
both ways, joins tracks over gaps into one identity (all at once, as an assignment), begins each one with the
first frame in which it was seen, and leaves out what was not seen for long enough to be believed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Port, Smoothed
from ...inference.kalman import PointStates, filter_tracks, kinematic, smooth
from ...models.core.checks import NotNegative, Positive, Shape, checked
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import Rows, short_repr
from ...models.objects.box_message import BOX, FOOT_X, FOOT_Y, HEIGHT, WIDTH, BoxMessage
from ...models.objects.object_boxes import ObjectBoxes
from .blobs import Track, centre_covariance

Numbers = NDArray[np.float64]

KNOWN = 0.25  # widths: standard deviation of a place up to which an object out of sight is reported there
EDGE = 0.25  # heights within which the picture's edge is near
FROM_EDGE = 0.9  # share of those who come that come from the picture's edge, not out of a door or a crowd

GOES_ON, GOES_ON_AT_EDGE = 0.5, 0.05
"""Probability that a track's end is not the object's, inside the picture and at its edge."""


@short_repr
@dataclass(frozen=True, eq=False)
class Boxes(Rows):
    """Table of the boxes of objects in all frames of a film, ordered by object and then by time."""

    frames: Annotated[NDArray[np.int64], Shape("n")]  # index of the frame
    identities: Annotated[NDArray[np.int64], Shape("n")]
    means: Annotated[Numbers, Shape("n", BOX)]  # px, in the order of `ObjectBoxes`
    variances: Annotated[Numbers, Shape("n", BOX)]  # px^2

    @classmethod
    def of(cls, messages: Iterable[GaussianMessage]) -> "Boxes":
        """Return the boxes of messages, one a frame."""
        parts = []
        for index, message in enumerate(messages):
            names, mean, covariance = message.moments
            frames = np.full(len(names), index, np.int64)
            identities, variances = np.asarray(names, np.int64), covariance.diagonal(axis1=1, axis2=2)
            parts.append(Boxes(frames, identities, mean.reshape(-1, BOX), variances.reshape(-1, BOX)))
        return cls.together(parts)

    def __len__(self) -> int:
        return len(self.frames)

    def sorted(self) -> Self:
        """Return the boxes ordered by object and time."""
        return self.only(np.lexsort((self.frames, self.identities)))

    def mask(self, size: tuple[int, int], room: float) -> NDArray[np.bool_]:
        """Return `(height, width)` whether a box, with a share of its size around it, covers a pixel."""
        inside = np.zeros(size, bool)
        for x, y, width, height in self.means.tolist():
            top, bottom = y - (1 + room) * height, y + room * height
            left, right = x - (0.5 + room) * width, x + (0.5 + room) * width
            spans = [(top, bottom), (left, right)]
            rows, columns = (slice(max(round(first), 0), max(round(end), 0)) for first, end in spans)
            inside[rows, columns] = True
        return inside

    def tracks(self) -> list[Self]:
        """Return the boxes of each object."""
        edges = np.flatnonzero(np.diff(self.identities)) + 1
        starts = [0, *edges.tolist(), len(self)]
        return [self.only(slice(start, end)) for start, end in pairwise(starts) if end > start]

    @classmethod
    def together(cls, tracks: Sequence["Boxes"]) -> "Boxes":
        """Return several tables as one."""
        empty = Boxes(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, BOX)), np.zeros((0, BOX)))
        return empty.joined(tracks).sorted()


def messages_of(boxes: Boxes, n_frames: int) -> list[BoxMessage]:
    """Return the message of the boxes in each frame."""
    order = np.argsort(boxes.frames, kind="stable")
    edges = np.searchsorted(boxes.frames[order], np.arange(n_frames + 1))
    rows = [order[start:end] for start, end in pairwise(edges)]
    return [
        BoxMessage(
            GaussianMessage.from_moments(
                boxes.identities[some], boxes.means[some], boxes.variances[some][:, :, None] * np.eye(BOX)
            )
        )
        if len(some)
        else BoxMessage()
        for some in rows
    ]


class Motion(NamedTuple):
    """Parameters of motion and growth, in units of an object's own height."""

    acceleration: float  # heights^2/s^3, spectral density of what moves feet out of their straight way
    growth: float  # heights^2/s^3, of what changes the growth of their width and height
    initial_velocity_std: float  # heights/s, standard deviation of a velocity


@dataclass(frozen=True, eq=False)
class SmoothedTrack:
    """Smoothed trajectory of one object in all frames from first to last."""

    first: int  # index of the first frame
    identity: int
    height: float  # px, its usual one
    seen: NDArray[np.bool_]  # (n_frames,), whether it was seen there
    feet: PointStates  # in every frame, of one point
    sizes: PointStates  # width and height in every frame

    @property
    def last(self) -> int:
        """Index of the last frame."""
        return self.first + len(self.seen) - 1

    def boxes(self) -> Boxes:
        """Return the boxes in every frame."""
        means = np.concatenate([self.feet.mean[:, :2], self.sizes.mean[:, :2]], axis=1)
        parts = (self.feet.covariance, self.sizes.covariance)
        variances = np.concatenate([part.diagonal(axis1=1, axis2=2)[:, :2] for part in parts], axis=1)
        frames = np.arange(self.first, self.last + 1)
        return Boxes(frames, np.full(len(frames), self.identity), means, variances)

    def reported(self) -> NDArray[np.bool_]:
        """Return `(n_frames,)` whether the object was seen or its place is known well enough.

        Sizes that change at a constant rate may fall below 0 where an object is tiny: it has no box there.
        """
        boxes = self.boxes()
        unsure = np.sqrt(boxes.variances[:, [FOOT_X, FOOT_Y]].max(axis=1))
        known = self.seen | (unsure < KNOWN * boxes.means[:, WIDTH])
        return np.asarray(known & (boxes.means[:, [WIDTH, HEIGHT]] > 0).all(axis=1))


MOST_ROWS = 100_000
"""Boxes that are smoothed at a time, with those that fill up shorter tracks: 800 bytes each."""


def smooth_tracks(tracks: Sequence[Boxes], times: Numbers, motion: Motion) -> list[SmoothedTrack]:
    """Smooth the track of each object (Rauch, Tung, Striebel), those of similar length together."""
    lengths = [int(track.frames[-1] - track.frames[0]) + 1 for track in tracks]
    order = sorted(range(len(tracks)), key=lambda row: lengths[row])
    batches: list[list[Boxes]] = []
    for row in order:
        if not batches or (len(batches[-1]) + 1) * lengths[row] > MOST_ROWS:
            batches.append([])
        batches[-1].append(tracks[row])
    smoothed = [track for batch in batches for track in _smoothed(batch, times, motion)]
    return [smoothed[place] for place in np.argsort(order)]


def _smoothed(tracks: Sequence[Boxes], times: Numbers, motion: Motion) -> list[SmoothedTrack]:
    """Smooth tracks, filled up to the longest one by frames that show nothing, 0 s after the last."""
    first, last = (np.array([track.frames[end] for track in tracks]) for end in (0, -1))
    frames = np.minimum(first + np.arange((last - first).max() + 1)[:, None], last)
    heights = np.array([np.median(track.means[:, HEIGHT]) for track in tracks])
    column = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    place = np.concatenate([track.frames for track in tracks]) - first[column]
    precision = 1 / np.concatenate([track.variances for track in tracks])
    weighted = precision * np.concatenate([track.means for track in tracks])

    shape = (len(frames), 2, len(tracks))  # feet and sizes
    information, vector, seen = np.zeros((*shape, 2, 2)), np.zeros((*shape, 2)), np.zeros(frames.shape, bool)
    seen[place, column] = True
    vector[place, :, column] = weighted.reshape(-1, 2, 2)
    for axis in range(2):
        information[place, :, column, axis, axis] = precision.reshape(-1, 2, 2)[:, :, axis]
    start = np.stack([track.means[0] for track in tracks]).reshape(-1, 2, 2).swapaxes(0, 1)
    speeds = np.outer([1.0, 0.2], motion.initial_velocity_std * heights).reshape(-1)
    prior = PointStates.at_rest(start, (10 * np.tile(heights, 2)) ** 2, speeds)
    density = np.outer([motion.acceleration, motion.growth], heights**2).reshape(-1)
    seconds = np.tile(times[frames], 2)
    measured = information.reshape(len(frames), -1, 2, 2), vector.reshape(len(frames), -1, 2)
    both = smooth(filter_tracks(prior, seconds, *measured, density), seconds, density)

    result = []
    for k, (track, end) in enumerate(zip(tracks, last - first + 1, strict=True)):
        feet, sizes = (
            PointStates(both.mean[:end, point], both.covariance[:end, point])
            for point in (k, len(tracks) + k)
        )
        identity, height = int(track.identities[0]), float(heights[k])
        result.append(SmoothedTrack(int(first[k]), identity, height, seen[:end, k], feet, sizes))
    return result


@dataclass(frozen=True)
class ArrivalModel:
    """How objects enter and leave."""

    size: tuple[int, int]  # (height, width) px of the picture
    rate: float  # 1/s, at which new ones come
    max_gap_time: float  # s, the longest gap over which tracks are joined

    def at_edge(self, track: SmoothedTrack, place: int) -> bool:
        """Return whether the picture's edge cuts off a track's box, or nearly so, in its frame `place`."""
        x, y = track.feet.mean[place, :2]
        width, height = track.sizes.mean[place, :2]
        near = EDGE * track.height
        rows, columns = self.size
        inside = near < x - 0.5 * width and x + 0.5 * width < columns - near
        return not (inside and near < y - height and y < rows - near)

    def log_new(self, track: SmoothedTrack) -> float:
        """Return the log density (1/s/px^2) of a new object where a track begins."""
        area = float(self.size[0] * self.size[1])
        strip = min(2 * EDGE * track.height * sum(self.size), area)
        place = FROM_EDGE / strip if self.at_edge(track, 0) else (1 - FROM_EDGE) / area
        return float(np.log(self.rate * place))

    def log_back(self, track: SmoothedTrack) -> float:
        """Return the log density (1/s) of a track going on after a gap."""
        back = GOES_ON_AT_EDGE if self.at_edge(track, -1) else GOES_ON
        return float(np.log(back / self.max_gap_time))


def find_joins(
    tracks: Sequence[SmoothedTrack], times: Numbers, motion: Motion, arrivals: ArrivalModel
) -> dict[int, int]:
    """Return which track goes on with which other one, by index of the one that ends, all decided at once.

    A track that ends and one that begins soon after are one object if that is likelier than that one is
    gone and another is new: the end, predicted to where the other begins, is a Gaussian over place,
    velocity and size; a newcomer comes at some rate, mostly at the picture's edge.
    """
    if len(tracks) < 2:
        return {}
    scores = np.zeros((len(tracks), len(tracks)))
    for row, one in enumerate(tracks):
        for column, other in enumerate(tracks):
            gap = times[other.first] - times[one.last]
            if row != column and 0 < gap <= arrivals.max_gap_time:
                one_object = arrivals.log_back(one) + _log_same(one, other, gap, motion)
                scores[row, column] = max(one_object - arrivals.log_new(other), 0.0)
    from scipy.optimize import linear_sum_assignment  # slow to import, and only whole films need it

    rows, columns = linear_sum_assignment(-scores)
    return {int(row): int(column) for row, column in zip(rows, columns, strict=True) if scores[row, column]}


def _log_same(one: SmoothedTrack, other: SmoothedTrack, gap: float, motion: Motion) -> float:
    """Log density of the place where a track begins if it is what another one was, `gap` s before."""
    height = 0.5 * (one.height + other.height)
    mean, covariance = one.feet.mean[-1], one.feet.covariance[-1]
    start, start_covariance = other.feet.mean[0], other.feet.covariance[0]
    moved, covariance = kinematic(2, gap).along(2).moved(mean, covariance, motion.acceleration * height**2)
    speed = (motion.initial_velocity_std * height) ** 2
    any_velocity = _log_gaussian(start[2:], np.eye(2) * speed + start_covariance[2:, 2:])
    sizes = np.log(other.sizes.mean[0, :2].clip(1) / one.sizes.mean[-1, :2].clip(1))
    same, any_size = np.diag([0.3**2, 0.15**2]), np.diag([0.6**2, 0.5**2])
    alike = _log_gaussian(sizes, same) - _log_gaussian(sizes, any_size)
    return _log_gaussian(start - moved, covariance + start_covariance) - any_velocity + alike


def _log_gaussian(off: Numbers, covariance: Numbers) -> float:
    _, log_volume = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (off @ np.linalg.solve(covariance, off) + log_volume))


def join(boxes: Boxes, tracks: Sequence[SmoothedTrack], next_of: dict[int, int]) -> Boxes:
    """Return the boxes of these tracks, each chain of `find_joins` under the identity of its first track."""
    names: dict[int, int] = {}
    for row in sorted(range(len(tracks)), key=lambda row: tracks[row].first):
        name = names.setdefault(row, tracks[row].identity)
        if row in next_of:
            names[next_of[row]] = name
    renamed = {tracks[row].identity: name for row, name in names.items()}
    kept = boxes.only(np.isin(boxes.identities, list(renamed)))
    identities = np.array([renamed[identity] for identity in kept.identities.tolist()], np.int64)
    return replace(kept, identities=identities).sorted()


@short_repr
@dataclass(frozen=True, eq=False)
class ObjectsOverTime:
    """Boxes, velocities and visibility of all objects in every frame."""

    boxes: Boxes  # n in all, with one identity for each object
    # px/s of their feet, to the right and down
    velocities: Annotated[NDArray[np.float64], Shape("n", 2)]
    # whether the frame shows them; in gaps they are interpolated
    seen: Annotated[NDArray[np.bool_], Shape("n")]

    @classmethod
    def of(cls, tracks: Sequence[SmoothedTrack]) -> Self:
        """Return those of tracks ordered by identity, where they are reported."""
        reported = [(track, track.reported()) for track in tracks]
        return cls(
            Boxes.together([track.boxes().only(rows) for track, rows in reported]),
            np.concatenate([np.zeros((0, 2)), *(track.feet.mean[rows, 2:] for track, rows in reported)]),
            np.concatenate([np.zeros(0, bool), *(track.seen[rows] for track, rows in reported)]),
        )

    def at(self, index: int) -> list[Track]:
        """Return every object in a frame, by index from 0, with confidence 1."""
        rows = np.flatnonzero(self.boxes.frames == index)
        boxes = self.boxes.only(rows)
        corners = boxes.means - np.outer(boxes.means[:, WIDTH], [0.5, 0, 0, 0])
        corners[:, FOOT_Y] -= boxes.means[:, HEIGHT]
        return [
            Track(identity, (x, y, width, height), 1.0, (vx, vy), seen, centre_covariance(variance))
            for identity, (x, y, width, height), (vx, vy), seen, variance in zip(
                boxes.identities.tolist(),
                corners.tolist(),
                self.velocities[rows].tolist(),
                self.seen[rows].tolist(),
                boxes.variances,
                strict=True,
            )
        ]

    @property
    def log_prior(self) -> float:
        """0: what the dynamics cost is part of the smoothing."""
        return 0.0


@short_repr
@checked
@dataclass(frozen=True)
class ObjectTrajectories:
    """Batch chain over the boxes of objects.

    Parameters
    ----------
    acceleration
        heights/s^2, standard deviation of the acceleration of a foot, with a correlation time of half a
        second.
    growth
        heights/s^2, the same of width and height.
    initial_velocity_std
        heights/s, standard deviation of a velocity.
    max_gap_time
        s, longest gap over which two tracks are joined into one object.
    min_seen_time
        s for which an object must have been seen in all.
    """

    acceleration: Positive = 0.9
    growth: Positive = 0.5
    initial_velocity_std: Positive = 1.0
    max_gap_time: Positive = 3.0
    min_seen_time: NotNegative = 0.35
    name: str = "trajectories"

    ports = (Port(ObjectBoxes),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: ObjectsOverTime | None = None
    ) -> Smoothed[ObjectsOverTime]:
        """Smooth the boxes that other chains send in all frames into trajectories, joined over gaps."""
        size = next(
            (each.frame.image.shape[:2] for each in incoming_over_time if each.frame.image is not None),
            (1, 1),
        )
        times = np.array([each.time for each in incoming_over_time])
        boxes = Boxes.of(each.others(ObjectBoxes).objects for each in incoming_over_time)
        motion = Motion(0.5 * self.acceleration**2, 0.5 * self.growth**2, self.initial_velocity_std)
        interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        tracks = smooth_tracks(boxes.tracks(), times, motion)
        seen = [track for track in tracks if track.seen.sum() * interval >= self.min_seen_time]
        arrivals = ArrivalModel(size, len(seen) / max(times[-1] - times[0], 1.0), self.max_gap_time)
        next_of = find_joins(seen, times, motion, arrivals)
        together = join(boxes, seen, next_of).tracks()
        return Smoothed(ObjectsOverTime.of(smooth_tracks(together, times, motion)))

    def messages(
        self,
        trajectory: ObjectsOverTime,
        feature: ObjectBoxes,
        incoming_over_time: Sequence[BatchIncoming],
    ) -> list[BoxMessage]:
        """Return the box of every object in each frame (mu_{trajectories -> boxes})."""
        return messages_of(trajectory.boxes, len(incoming_over_time))

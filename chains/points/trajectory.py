"""Smoothed tracks of points over a sequence, with a learned motion model and each frame's cavity message.

The acceleration of RSMCM §4.3 is unknown and has the unit of the tracks: pixels of a film, or any in a track
file. It is learned from the innovations of the Kalman filter.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ...inference.kalman import PointStates, cavity, filter_tracks, smooth
from ...models.core.checks import Shape
from ...models.core.gaussian_message import GaussianMessage, squared_distances
from ...models.core.identities import find
from ...models.core.short_repr import short_repr

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]

MEDIAN = 2 * np.log(2)  # of chi squared with two degrees of freedom
MOST_TRACKS = 300  # longest tracks by which motion is learned
HALVINGS = 24  # bisections of the range of the log acceleration, to far below a percent

LEAST_GROWTH, MOST_GROWTH = 1e-4, 1e2
"""Range of the standard deviation that acceleration adds to a position between two frames: its least value in
units of the measurements' noise, its largest in typical steps."""

SPEED_FACTOR = 3.0  # standard deviation of initial velocities over a typical velocity: a wide prior


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measured positions of points in all frames, in information form."""

    times: Array  # (n_frames,) s, increasing
    information: Array  # (n_frames, n_points, 2, 2) 1/px^2, zeros where a point was not seen
    vector: Array  # (n_frames, n_points, 2) 1/px, information times position

    @property
    def seen(self) -> Mask:
        """Where a position is measured, `(n_frames, n_points)`."""
        present: Mask = np.linalg.det(self.information) > 0
        return present

    def only(self, points: NDArray[np.intp] | slice) -> "Measurements":
        """Return the measurements of some points."""
        return Measurements(self.times, self.information[:, points], self.vector[:, points])

    def moments(self) -> tuple[Array, Array]:
        """Return positions `(n_frames, n_points, 2)` px, covariances `(..., 2, 2)` px^2; 0 where not seen."""
        seen = self.seen
        position, covariance = np.zeros_like(self.vector), np.zeros_like(self.information)
        covariance[seen] = np.linalg.inv(self.information[seen])
        position[seen] = (covariance[seen] @ self.vector[seen][:, :, None])[:, :, 0]
        return position, covariance


@dataclass(frozen=True)
class MotionModel:
    """Acceleration, px^2/s^3, and standard deviations of initial velocity, px/s, and position, px."""

    acceleration: float
    speed: float
    extent: float

    def prior(self, n_points: int) -> PointStates:
        """Return the prior of points at the first frame."""
        return PointStates.at_rest(np.zeros((n_points, 2)), self.extent**2, self.speed)


def estimate_motion(measured: Measurements, acceleration: float | None = None) -> MotionModel:
    """Estimate the motion model of measurements; `acceleration` px^2/s^3 if it is given.

    With the estimate half of the measurements are inside the filter's 50 % regions, one frame ahead: the
    median of the squared Mahalanobis distances is that of a Gaussian. Maximum likelihood agrees for Gaussian
    errors, but is not robust to tracks that jump or slip. If measurements scatter less than their noise, it
    is the least of the range.
    """
    seen = measured.seen
    position, covariance = measured.moments()
    noise = covariance[seen]
    speed, length, dt = _steps(measured.times, position, seen)
    error = float(np.sqrt(np.median(noise[:, 0, 0] + noise[:, 1, 1]) / 2)) if len(noise) else 1.0
    extent = 1e3 * max(float(np.abs(position[seen]).max(initial=0.0)), error)
    speed = SPEED_FACTOR * max(speed, error / dt)
    if acceleration is not None:
        return MotionModel(acceleration, speed, extent)
    longest = np.argsort(-seen.sum(axis=0), kind="stable")[:MOST_TRACKS]
    sample = measured.only(np.sort(longest))
    # a position's variance grows by acceleration * dt^3 / 3 in a frame
    low = np.log(3 * (LEAST_GROWTH * error) ** 2 / dt**3)
    high = np.log(3 * (MOST_GROWTH * max(length, error)) ** 2 / dt**3)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        distances = _distances(sample, MotionModel(float(np.exp(middle)), speed, extent))
        if not len(distances):
            break
        low, high = (middle, high) if np.median(distances) > MEDIAN else (low, middle)
    return MotionModel(float(np.exp(0.5 * (low + high))), speed, extent)


def one_frame_ahead(filtered: PointStates, times: Array, acceleration: float) -> tuple[Array, Array]:
    """Return the positions and covariances predicted for all frames but the first, one frame ahead."""
    dt = np.diff(times)[:, None, None]
    mean, covariance = filtered.mean[:-1], filtered.covariance[:-1]
    expected = mean[:, :, :2] + dt * mean[:, :, 2:]
    dt = dt[:, :, :, None]
    across = covariance[:, :, :2, 2:]
    grown = covariance[:, :, :2, :2] + dt * (across + across.swapaxes(2, 3) + dt * covariance[:, :, 2:, 2:])
    return expected, grown + acceleration * dt**3 / 3 * np.eye(2)


def _steps(times: Array, position: Array, seen: Mask) -> tuple[float, float, float]:
    """Return typical velocity, px/s, and step between frames, px, of a coordinate, and s between frames."""
    apart = np.diff(times)
    dt = float(np.median(apart)) if len(apart) else 1.0
    both = seen[1:] & seen[:-1]
    velocities = (np.diff(position, axis=0) / apart[:, None, None])[both]
    speed = float(np.median(np.abs(velocities))) if len(velocities) else 0.0
    return 1.4826 * speed, 1.4826 * speed * dt, dt


def _distances(measured: Measurements, motion: MotionModel) -> Array:
    """Return squared Mahalanobis distances of measurements of points that were seen twice before."""
    seen = measured.seen
    filtered = filter_tracks(
        motion.prior(seen.shape[1]),
        measured.times,
        measured.information,
        measured.vector,
        motion.acceleration,
    )
    expected, covariance = one_frame_ahead(filtered, measured.times, motion.acceleration)
    position, noise = measured.moments()
    known = seen[1:] & (np.cumsum(seen, axis=0)[:-1] >= 2)
    off = (position[1:] - expected)[known]
    spread = (covariance + noise[1:])[known]
    return squared_distances(off, spread)


BATCH = 128
"""Points smoothed at a time, which bounds the memory."""


@short_repr
@dataclass(frozen=True, eq=False)
class Appearances:
    """`first` and `last` patches of points, `(n, side, side)` float32; `identities` increase.

    First ones were `cut` from the pictures of these times, s.
    """

    identities: Annotated[Identities, Shape("n")]
    first: Annotated[NDArray[np.float32], Shape("n", "side", "side")]
    last: Annotated[NDArray[np.float32], Shape("n", "side", "side")]
    cut: Annotated[Array, Shape("n")]


@short_repr
@dataclass(frozen=True, eq=False)
class PointTrajectory:
    """Smoothed positions of points in all frames, and the messages of each frame.

    `log_prior` is the log probability of the measurements under the motion model, one after the other, less
    the terms that beliefs over the features contain already: together they are the tracks' log evidence.
    """

    identities: Annotated[Identities, Shape("n")]  # increasing
    # px, given all evidence; undefined where a point is not alive
    position: Annotated[Array, Shape("n_frames", "n", 2, finite=False)]
    covariance: Annotated[Array, Shape("n_frames", "n", 2, 2, finite=False)]  # px^2
    observed: Annotated[Mask, Shape("n_frames", "n")]  # the frame itself shows the point
    alive: Annotated[Mask, Shape("n_frames", "n")]  # its position is certain enough, and inside the picture
    # 1/px^2 and 1/px: of the other frames' evidence alone; 0 if too little
    information: Annotated[Array, Shape("n_frames", "n", 2, 2)]
    vector: Annotated[Array, Shape("n_frames", "n", 2)]
    appearances: Appearances | None  # also of points that no frame shows; None without pictures
    absorbed: Annotated[NDArray[np.int64], Shape(None, 2)]  # identities of duplicates, and of their points
    log_prior: float

    def messages(self) -> Iterator[GaussianMessage]:
        """Yield for each frame the densities of positions that the other frames predict."""
        for information, vector in zip(self.information, self.vector, strict=True):
            cavity_information = np.flatnonzero(information[:, 0, 0] > 0)
            covariance = np.linalg.inv(information[cavity_information])
            mean = (covariance @ vector[cavity_information][:, :, None])[:, :, 0]
            yield GaussianMessage.from_moments(self.identities[cavity_information], mean, covariance)


@dataclass(frozen=True, eq=False)
class StackedMessages:
    """Gaussian messages of all frames side by side; `log_scale` is `(n_frames, n)`."""

    identities: Identities
    measured: Measurements
    log_scale: Array

    @classmethod
    def of(
        cls, messages: Sequence[GaussianMessage], times: Array, identities: Identities | None = None
    ) -> "StackedMessages":
        """Stack messages, of some points or of all."""
        if identities is None:
            identities = np.unique(np.concatenate([message.identities for message in messages]))
        shape = (len(messages), len(identities))
        information, vector, log_scale = np.zeros((*shape, 2, 2)), np.zeros((*shape, 2)), np.zeros(shape)
        for t, message in enumerate(messages):
            place, among = find(identities, message.identities)
            place = place[among]
            information[t, place] = message.information[among]
            vector[t, place] = message.vector[among]
            log_scale[t, place] = message.log_scale[among]
        return cls(identities, Measurements(times, information, vector), log_scale)


def smoothed_trajectory(
    evidence: StackedMessages,
    others: StackedMessages,
    motion: MotionModel,
    max_position_std: float,
    size: tuple[int, int] | None,
) -> PointTrajectory:
    """Smooth tracks with all messages, and with the frames' evidence alone for the messages to others."""
    n_frames, n_points = evidence.log_scale.shape
    times = evidence.measured.times
    position, covariance = np.zeros((n_frames, n_points, 2)), np.zeros((n_frames, n_points, 2, 2))
    information, vector = np.zeros((n_frames, n_points, 2, 2)), np.zeros((n_frames, n_points, 2))
    log_prior = 0.0
    for start in range(0, n_points, BATCH):
        some = slice(start, start + BATCH)
        seen, expected = evidence.measured.only(some), others.measured.only(some)
        prior = motion.prior(seen.vector.shape[1])
        filtered = filter_tracks(prior, times, seen.information, seen.vector, motion.acceleration)
        alone = smooth(filtered, times, motion.acceleration)
        cavity_information, cavity_vector = cavity(alone, seen.information, seen.vector)
        uncertain = ~_is_certain(cavity_information, max_position_std)
        cavity_information[uncertain], cavity_vector[uncertain] = 0.0, 0.0
        information[:, some], vector[:, some] = cavity_information, cavity_vector
        log_prior += _log_prior(
            seen,
            evidence.log_scale[:, some],
            filtered,
            cavity_information,
            cavity_vector,
            motion,
            max_position_std,
        )
        if expected.information.any():
            together = filter_tracks(
                prior,
                times,
                seen.information + expected.information,
                seen.vector + expected.vector,
                motion.acceleration,
            )
            alone = smooth(together, times, motion.acceleration)
        position[:, some], covariance[:, some] = alone.position, alone.position_covariance
    alive = 0.5 * np.trace(covariance, axis1=2, axis2=3) <= max_position_std**2
    if size is not None:
        far = np.array([size[1], size[0]]) - 0.5
        alive &= ((position >= -0.5) & (position <= far)).all(axis=2)
    return PointTrajectory(
        identities=evidence.identities,
        position=position,
        covariance=covariance,
        observed=evidence.measured.seen,
        alive=alive,
        information=information,
        vector=vector,
        appearances=None,
        absorbed=np.zeros((0, 2), np.int64),
        log_prior=log_prior,
    )


def _is_certain(information: Array, max_position_std: float) -> Mask:
    """Return which positions have a standard deviation of at most `max_position_std` px."""
    trace = np.trace(information, axis1=-2, axis2=-1)
    # mean of the two variances, without an inverse of what may be singular
    known: Mask = (trace > 0) & (0.5 * trace <= max_position_std**2 * np.linalg.det(information))
    return known


def _log_prior(
    seen: Measurements,
    log_scale: Array,
    filtered: PointStates,
    cavity_information: Array,
    cavity_vector: Array,
    motion: MotionModel,
    max_position_std: float,
) -> float:
    """Return the log evidence of measurements given those before, less that of each given all others."""
    expected, spread = one_frame_ahead(filtered, seen.times, motion.acceleration)
    position, noise = seen.moments()
    found = seen.seen
    sizes = np.where(found, np.linalg.det(noise), 1.0)
    peak = log_scale + np.log(2 * np.pi) + 0.5 * np.log(sizes) + 0.5 * (seen.vector * position).sum(axis=2)
    after = found[1:] & (0.5 * np.trace(spread, axis1=2, axis2=3) <= max_position_std**2)
    total = (
        peak[1:][after] + _log_density((position[1:] - expected)[after], (spread + noise[1:])[after])
    ).sum()
    total -= peak[found].sum()
    both = found & (cavity_information[..., 0, 0] > 0)
    others = np.linalg.inv(cavity_information[both])
    off = position[both] - (others @ cavity_vector[both][:, :, None])[:, :, 0]
    return float(total - _log_density(off, others + noise[both]).sum())


def _log_density(off: Array, covariance: Array) -> Array:
    sizes = np.log(np.linalg.det(covariance))
    density: Array = -0.5 * (squared_distances(off, covariance) + sizes) - np.log(2 * np.pi)
    return density

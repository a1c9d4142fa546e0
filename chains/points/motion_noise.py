"""How restlessly points move, learned from how far they are from where the Kalman filter expects them.

The motion model of RSMCM §4.3 has one number that nobody knows beforehand, and it has the unit of the tracks:
pixels of a film, or anything in a track file.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.kalman import PointStates, filter_tracks
from ...models.core.mahalanobis import squared_distances

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

MEDIAN = 2 * np.log(2)
"""Of the squared Mahalanobis distance of two numbers from where they are expected."""

MOST_TRACKS = 300
"""Tracks that count: the longest."""

HALVINGS = 24
"""Of the range in which the acceleration's logarithm is sought; the last ones are far below a percent."""

LEAST_GROWTH, MOST_GROWTH = 1e-4, 1e2
"""Least and most that is believed. By how much a point leaves its way from one frame to the next: in units of
the measurements' noise, and of a typical step."""

EVERY_SPEED = 3.0
"""Standard deviation of velocities at the beginning, in units of a typical velocity: nobody is surprised."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measured positions of points in all frames, in information form.

    Parameters
    ----------
    times
        `(n_frames,)` s, increasing.
    information
        `(n_frames, n_points, 2, 2)` 1/px^2, zeros where a point was not seen.
    vector
        `(n_frames, n_points, 2)` 1/px, information times position.
    """

    times: Numbers
    information: Numbers
    vector: Numbers

    @property
    def seen(self) -> Mask:
        """`(n_frames, n_points)`: where a position is measured."""
        present: Mask = np.linalg.det(self.information) > 0
        return present

    def only(self, points: NDArray[np.intp] | slice) -> "Measurements":
        """Those of some points."""
        return Measurements(self.times, self.information[:, points], self.vector[:, points])

    def moments(self) -> tuple[Numbers, Numbers]:
        """Positions `(n_frames, n_points, 2)` px and covariances `(..., 2, 2)` px^2; 0 where not seen."""
        seen = self.seen
        position, covariance = np.zeros_like(self.vector), np.zeros_like(self.information)
        covariance[seen] = np.linalg.inv(self.information[seen])
        position[seen] = (covariance[seen] @ self.vector[seen][:, :, None])[:, :, 0]
        return position, covariance


@dataclass(frozen=True)
class MotionModel:
    """What points move like.

    Parameters
    ----------
    acceleration
        px^2/s^3, spectral density of the white acceleration along each coordinate.
    speed
        px/s, standard deviation of each coordinate's velocity, of a point that nobody has seen move.
    extent
        px, standard deviation of a position that nobody knows.
    """

    acceleration: float
    speed: float
    extent: float

    def prior(self, n_points: int) -> PointStates:
        """Points that may be anywhere."""
        return PointStates.at_rest(np.zeros((n_points, 2)), self.extent**2, self.speed)


def estimate_motion(measured: Measurements, acceleration: float | None = None) -> MotionModel:
    """Motion that fits the measurements.

    The acceleration is the one with which half of all measurements are inside the ellipses in which the
    filter, one frame ahead, expects half of them: the median of the squared distances is a Gaussian's.
    Maximum likelihood agrees where errors are Gaussian, but would be swayed by tracks that jump or slip.
    Where measurements scatter less than they claim, the acceleration is the least that is believed.

    Parameters
    ----------
    acceleration
        px^2/s^3 where it is known.
    """
    seen = measured.seen
    position, covariance = measured.moments()
    noise = covariance[seen]
    speed, length, dt = _steps(measured.times, position, seen)
    error = float(np.sqrt(np.median(noise[:, 0, 0] + noise[:, 1, 1]) / 2)) if len(noise) else 1.0
    extent = 1e3 * max(float(np.abs(position[seen]).max(initial=0.0)), error)
    speed = EVERY_SPEED * max(speed, error / dt)
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


def one_frame_ahead(filtered: PointStates, times: Numbers, acceleration: float) -> tuple[Numbers, Numbers]:
    """Positions that are expected in all frames but the first, each from the frames before.

    Parameters
    ----------
    filtered
        `n_frames` times `n_points`.
    times
        `(n_frames,)` s.
    acceleration
        px^2/s^3.

    Returns
    -------
    mean, covariance
        `(n_frames - 1, n_points, 2)` px and `(n_frames - 1, n_points, 2, 2)` px^2.
    """
    dt = np.diff(times)[:, None, None]
    mean, covariance = filtered.mean[:-1], filtered.covariance[:-1]
    expected = mean[:, :, :2] + dt * mean[:, :, 2:]
    dt = dt[:, :, :, None]
    across = covariance[:, :, :2, 2:]
    grown = covariance[:, :, :2, :2] + dt * (across + across.swapaxes(2, 3) + dt * covariance[:, :, 2:, 2:])
    return expected, grown + acceleration * dt**3 / 3 * np.eye(2)


def _steps(times: Numbers, position: Numbers, seen: Mask) -> tuple[float, float, float]:
    """Typical velocity, px/s, and step from frame to frame, px, of a coordinate; s between frames."""
    apart = np.diff(times)
    dt = float(np.median(apart)) if len(apart) else 1.0
    both = seen[1:] & seen[:-1]
    velocities = (np.diff(position, axis=0) / apart[:, None, None])[both]
    speed = float(np.median(np.abs(velocities))) if len(velocities) else 0.0
    return 1.4826 * speed, 1.4826 * speed * dt, dt


def _distances(measured: Measurements, motion: MotionModel) -> Numbers:
    """Squared distances of measurements from where they are expected, once a point was seen twice."""
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

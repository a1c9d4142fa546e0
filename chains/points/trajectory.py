"""Tracks of points over a whole sequence, smoothed, with what each frame says of them kept apart."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.kalman import PointStates, cavity, filter_tracks, smooth
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.mahalanobis import squared_distances
from ...models.core.short_repr import short_repr
from .motion_noise import Measurements, MotionModel, one_frame_ahead

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]

AT_ONCE = 128
"""Points that are smoothed in one go: states of all points in all frames need not fit into memory."""


@short_repr
@dataclass(frozen=True, eq=False)
class Appearances:
    """What points look like.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    first, last
        `(n, side, side)` float32: as they were found first, and as they were followed at the end.
    """

    identities: Identities
    first: NDArray[np.float32]
    last: NDArray[np.float32]

    def places_of(self, identities: Identities) -> NDArray[np.intp]:
        """`(m,)`: where these are, which must be there."""
        return np.searchsorted(self.identities, identities)


@short_repr
@dataclass(frozen=True, eq=False)
class PointTrajectory:
    """Where points are in all frames, and what a tracker says of that.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    position, covariance
        `(n_frames, n, 2)` px and `(n_frames, n, 2, 2)` px^2, given all that is known; meaningless where a
        point is not alive.
    observed
        `(n_frames, n)`: the frame itself shows the point.
    alive
        `(n_frames, n)`: its position is known well enough, and inside the picture.
    information, vector
        `(n_frames, n, 2, 2)` 1/px^2 and `(n_frames, n, 2)` 1/px: what the other frames' evidence says of the
        position, zeros where it is too little; never what other chains said.
    appearances
        what points look like, also some that no frame shows; `None` where there are no pictures.
    absorbed
        `(m, 2)` int64: identities that turned out to be another point, and of which one.
    log_prior
        log probability of what was found under the motion of points, one after the other, less what beliefs
        over the features say of it already: with them it makes the log evidence of all tracks.
    """

    identities: Identities
    position: Numbers
    covariance: Numbers
    observed: Mask
    alive: Mask
    information: Numbers
    vector: Numbers
    appearances: Appearances | None
    absorbed: NDArray[np.int64]
    log_prior: float

    def messages(self) -> Iterator[GaussianMessage]:
        """For each frame, densities of the positions that the other frames predict."""
        for information, vector in zip(self.information, self.vector, strict=True):
            said = np.flatnonzero(information[:, 0, 0] > 0)
            covariance = np.linalg.inv(information[said])
            mean = (covariance @ vector[said][:, :, None])[:, :, 0]
            yield GaussianMessage.from_moments(self.identities[said], mean, covariance)


@dataclass(frozen=True, eq=False)
class StackedMessages:
    """Gaussian messages of all frames side by side.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    measured
        of these points.
    log_scale
        `(n_frames, n)`.
    """

    identities: Identities
    measured: Measurements
    log_scale: Numbers

    @classmethod
    def of(
        cls, messages: Sequence[GaussianMessage], times: Numbers, identities: Identities | None = None
    ) -> "StackedMessages":
        """Gather messages, of some points or of all that are mentioned."""
        if identities is None:
            identities = np.unique(np.concatenate([message.identities for message in messages]))
        shape = (len(messages), len(identities))
        information, vector, log_scale = np.zeros((*shape, 2, 2)), np.zeros((*shape, 2)), np.zeros(shape)
        for t, message in enumerate(messages):
            among = np.isin(message.identities, identities)
            place = np.searchsorted(identities, message.identities[among])
            information[t, place] = message.information[among]
            vector[t, place] = message.vector[among]
            log_scale[t, place] = message.log_scale[among]
        return cls(identities, Measurements(times, information, vector), log_scale)


def smoothed_trajectory(
    evidence: StackedMessages,
    others: StackedMessages,
    motion: MotionModel,
    limit: float,
    size: tuple[int, int] | None,
) -> PointTrajectory:
    """Smooth tracks, once with everything and once with the frames' evidence alone.

    Parameters
    ----------
    evidence, others
        what frames and what other chains say of the same points.
    motion
        of the points.
    limit
        px, standard deviation from which a position counts as not known.
    size
        `(height, width)` px of the picture; `None` where there is none.
    """
    n_frames, n_points = evidence.log_scale.shape
    times = evidence.measured.times
    position, covariance = np.zeros((n_frames, n_points, 2)), np.zeros((n_frames, n_points, 2, 2))
    information, vector = np.zeros((n_frames, n_points, 2, 2)), np.zeros((n_frames, n_points, 2))
    log_prior = 0.0
    for start in range(0, n_points, AT_ONCE):
        some = slice(start, start + AT_ONCE)
        seen, expected = evidence.measured.only(some), others.measured.only(some)
        prior = motion.prior(seen.vector.shape[1])
        filtered = filter_tracks(prior, times, seen.information, seen.vector, motion.acceleration)
        alone = smooth(filtered, times, motion.acceleration)
        said, weighted = cavity(alone, seen.information, seen.vector)
        unknown = ~_known(said, limit)
        said[unknown], weighted[unknown] = 0.0, 0.0
        information[:, some], vector[:, some] = said, weighted
        log_prior += _log_prior(seen, evidence.log_scale[:, some], filtered, said, weighted, motion, limit)
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
    alive = 0.5 * np.trace(covariance, axis1=2, axis2=3) <= limit**2
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


def _known(information: Numbers, limit: float) -> Mask:
    """Which positions are known to within `limit` px, as a standard deviation."""
    trace = np.trace(information, axis1=-2, axis2=-1)
    # mean of the two variances, without an inverse of what may be singular
    known: Mask = (trace > 0) & (0.5 * trace <= limit**2 * np.linalg.det(information))
    return known


def _log_prior(
    seen: Measurements,
    log_scale: Numbers,
    filtered: PointStates,
    said: Numbers,
    weighted: Numbers,
    motion: MotionModel,
    limit: float,
) -> float:
    """Log evidence of the tracks, each find given those before it, less that of each given all others.

    Where a track begins anywhere will do, which the scale of the evidence makes 1.
    """
    expected, spread = one_frame_ahead(filtered, seen.times, motion.acceleration)
    position, noise = seen.moments()
    found = seen.seen
    sizes = np.where(found, np.linalg.det(noise), 1.0)
    peak = log_scale + np.log(2 * np.pi) + 0.5 * np.log(sizes) + 0.5 * (seen.vector * position).sum(axis=2)
    after = found[1:] & (0.5 * np.trace(spread, axis1=2, axis2=3) <= limit**2)
    total = (
        peak[1:][after] + _log_density((position[1:] - expected)[after], (spread + noise[1:])[after])
    ).sum()
    total -= peak[found].sum()
    both = found & (said[..., 0, 0] > 0)
    others = np.linalg.inv(said[both])
    off = position[both] - (others @ weighted[both][:, :, None])[:, :, 0]
    return float(total - _log_density(off, others + noise[both]).sum())


def _log_density(off: Numbers, covariance: Numbers) -> Numbers:
    sizes = np.log(np.linalg.det(covariance))
    density: Numbers = -0.5 * (squared_distances(off, covariance) + sizes) - np.log(2 * np.pi)
    return density

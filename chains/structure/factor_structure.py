"""Shape from motion as a chain: rigid points seen by an affine camera (factor analysis, RSMCM §4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Cavity, Port, Smoothed
from ...inference.sfm.factor_analysis.factorisation import Factorisation, factorise_robustly, predicted
from ...models.core.checks import Shape, checked
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.identities import common, places_of
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import PointMessage, PointTracks
from .track_association import associate_tracks

Array = NDArray[np.float64]


def observations(incoming_over_time: Sequence[BatchIncoming]) -> tuple[NDArray[np.int64], Array, Array]:
    """Return identities `(n,)`, positions `(n_frames, n, 2)` and 1 / variances `(n_frames, n)`.

    Where there is information about one coordinate only the other one is NaN.
    """
    messages = [incoming[PointTracks].positions for incoming in incoming_over_time]
    identities = np.unique(np.concatenate([each.identities[_is_observed(each)] for each in messages]))
    positions = np.zeros((len(messages), len(identities), 2))
    weights = np.zeros((len(messages), len(identities)))
    for time, message in enumerate(messages):
        known, means, covariances = message.moments
        place = places_of(identities, known)
        positions[time, place] = means
        weights[time, place] = 2 / np.trace(covariances, axis1=1, axis2=2)
        half = message.only(_is_observed(message) & ~message.proper)
        place = places_of(identities, half.identities)
        information = half.information.diagonal(axis1=1, axis2=2)
        positions[time, place] = np.where(information > 0, half.vector, np.nan) / np.where(
            information > 0, information, 1.0
        )
        weights[time, place] = information.max(axis=1)
    return identities, positions, weights


def _is_observed(message: GaussianMessage) -> NDArray[np.bool_]:
    """Of whom both coordinates are known, or one of them."""
    one = np.count_nonzero(message.information.any(axis=2), axis=1) == 1
    return np.asarray(message.proper | one)


LEAST_SCATTER = 1e-6  # of the noise: keeps covariances positive where shape and cameras are known exactly


@short_repr
@dataclass(frozen=True, eq=False)
class StructureTrajectory:
    """Shape, cameras, and which of the feature's points show which point of the shape.

    Parameters
    ----------
    identities, point_of_track
        `(n_tracks,)` int64: points of the feature node, increasing, which may be partial tracks; and column
        of `factorisation.shape`, -1 where it is not sure enough.
    factorisation
        cameras and points; see there.
    noise, scatter
        px^2, variance of an observation about what shape and cameras predict, and what of this is the
        features' own, eq. (20), and not the noise that observations state.
    trusted
        `(n_frames, n_tracks)` bool: whether a place that came in is taken to be right, and no outlier.
    """

    identities: Annotated[NDArray[np.int64], Shape("n_tracks")]
    point_of_track: Annotated[NDArray[np.int64], Shape("n_tracks")]
    factorisation: Factorisation
    noise: float
    scatter: float
    trusted: Annotated[NDArray[np.bool_], Shape("n_frames", "n_tracks")]

    def require_fit(self) -> None:
        """Raise a `ValueError` if the shape is not one of these tracks and frames."""
        cameras, shape = self.factorisation.cameras, self.factorisation.shape
        if len(cameras) != len(self.trusted):
            raise ValueError(f"factorisation: got {len(cameras)} cameras, expected {len(self.trusted)}")
        if not ((self.point_of_track >= -1) & (self.point_of_track < len(shape))).all():
            raise ValueError(f"point_of_track: got other numbers, expected -1 to {len(shape) - 1}")

    @property
    def log_prior(self) -> float:
        """Points are draws of N(0, I); eq. (19) for cameras is part of the fit and is left out here."""
        return -0.5 * float((self.factorisation.shape**2).sum())


@checked
@short_repr
@dataclass(frozen=True)
class FactorStructure:
    """Batch chain of shape and motion over `PointTracks`: cameras M_t, points S_i, RSMCM eq. (18) to (20).

    The message to a point is N(M_t (S_i, 1), P_ti), with P_ti the covariance from shape, cameras and model
    error; `same_as` groups the tracks of one point. Variances of observations are known up to a common
    factor, which is learned. Frames are assumed to be evenly spaced: a step of eq. (19) is one frame.
    Positions are inliers with a learned probability, or outliers; see `factorise_robustly`.

    Parameters
    ----------
    coherence
        whether cameras move smoothly, eq. (19), or are independent.
    associate
        whether partial tracks may show the same point; see `associate_tracks`. If not, every track is a
        separate point.
    outliers
        whether positions may be outliers; if not, cameras and shape are those of least squares.
    """

    coherence: bool = True
    associate: bool = True
    outliers: bool = True
    name: str = "structure"

    ports = (Port(PointTracks, Cavity.OTHERS),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: StructureTrajectory | None = None
    ) -> Smoothed[StructureTrajectory]:
        """Return shape and cameras fitted to `incoming`, from the `current` cameras where there are such.

        Who shows what is decided anew, so that early errors do not persist.

        Raises
        ------
        ValueError
            if there are fewer than 3 frames or 4 tracks, or frames share too few of them.
        """
        identities, positions, weights = observations(incoming_over_time)
        start = None if current is None else current.factorisation
        how: Any = {"coherence": self.coherence, "outliers": self.outliers, "start": start}
        if self.associate:
            found = associate_tracks(positions, weights, **how)
            fit, point, trusted = found.factorisation, found.point_of_track, found.trusted
        else:
            robust = factorise_robustly(positions, weights, **how)
            kept, trusted = robust.consistent, robust.trusted
            fit = robust.factorisation.of_points(kept)
            point = np.where(kept, np.cumsum(kept) - 1, -1)
        stated = 1 / float(np.median(weights[weights > 0]))
        noise = fit.noise_variance * stated
        scatter = max(noise - stated, 0.0)
        return Smoothed(StructureTrajectory(identities, point, fit, noise, scatter, trusted))

    def messages(
        self,
        trajectory: StructureTrajectory,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Return the predicted positions of all tracks that have a point, in each frame."""
        positions, covariances = predicted(trajectory.factorisation)
        covariances[..., [0, 1], [0, 1]] += trajectory.scatter + LEAST_SCATTER * trajectory.noise
        return point_messages(trajectory.identities, trajectory.point_of_track, positions, covariances)


def point_messages(
    identities: NDArray[np.int64], point_of_track: NDArray[np.int64], positions: Array, covariances: Array
) -> list[PointMessage]:
    """Return a shape's predictions of tracks in each frame, with tracks of one point grouped.

    Of `identities` and `point_of_track` `(n_tracks,)` those with -1 are left out; positions `(n_frames,
    n_points, 2)` px and covariances `(n_frames, n_points, 2, 2)` px^2 are of points.
    """
    known = point_of_track >= 0
    tracks, points = identities[known], point_of_track[known]
    first = np.full(positions.shape[1], np.iinfo(np.int64).max)
    np.minimum.at(first, points, tracks)
    return [
        PointMessage(GaussianMessage.from_moments(tracks, mean, covariance), same_as=first[points])
        for mean, covariance in zip(positions[:, points], covariances[:, points], strict=True)
    ]


def without_observations(
    shape: GaussianMessage, evidence: GaussianMessage, structure: StructureTrajectory
) -> GaussianMessage:
    """Return the shape's message about observed points, each without its own observation in this frame.

    Each observation is taken out of the fit for its point and frame, as if the fit was linear.
    """
    identities, mean, covariance = shape.moments
    seen, observed, noise = evidence.moments
    both, here, there = common(identities, seen)
    mean, covariance, observed = mean[here], covariance[here], observed[there]
    about = structure.scatter * np.eye(2)  # by which features scatter about the shape, eq. (20)
    fitted = structure.factorisation.noise_variance * np.trace(noise[there], axis1=1, axis2=2) / 2
    of_observation = np.eye(2) / fitted[:, None, None]
    of_shape = np.linalg.inv(covariance - about)
    information = of_shape - of_observation
    # a point that nothing but this observation determines
    left = np.linalg.eigvalsh(information)[:, 0] > 1e-3 * np.linalg.eigvalsh(of_shape)[:, 0]
    rest = np.linalg.inv(information[left])
    vector = of_shape[left] @ mean[left][:, :, None] - of_observation[left] @ observed[left][:, :, None]
    return GaussianMessage.from_moments(both[left], (rest @ vector)[:, :, 0], rest + about)

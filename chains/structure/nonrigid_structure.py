"""A deforming shape as a chain: points whose places are linear in a few weights (Torresani et al. 2008)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Cavity, Port, Smoothed
from ...inference.sfm.nonrigid.learning import learn_associated
from ...inference.sfm.nonrigid.shape import NonrigidShape
from ...models.core.checks import at_least, checked
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import PointMessage, PointTracks
from .factor_structure import LEAST_SCATTER, observations, point_messages

Array = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class NonrigidTrajectory:
    """Shape, poses and weights, and which of the feature's points show which point of the shape.

    Parameters
    ----------
    identities, point_of_track
        `(n_tracks,)` int64: points of the feature node, increasing, which may be partial tracks; and a point
        of the shape, -1 where the track is too short.
    shape, scatter
        the shape in all frames; px^2, what of the noise is the features' own, and not the one that
        observations state.
    """

    identities: NDArray[np.int64]
    point_of_track: NDArray[np.int64]
    shape: NonrigidShape
    scatter: float

    @property
    def log_prior(self) -> float:
        """Weights are draws of N(0, I); the prior of the bases is part of the fit and is left out here."""
        weights = (self.shape.weights, self.shape.detail_weights)
        return -0.5 * float(sum(np.nansum(each**2) for each in weights))


@checked
@short_repr
@dataclass(frozen=True)
class NonrigidStructure:
    """Batch chain of a deforming shape and its poses over `PointTracks`, in place of `FactorStructure`.

    The message to a point is its predicted position with the covariance from pose, weights, bases and model
    error, in every frame that shows four points or more, whether the point is visible or not. `same_as`
    groups the tracks of one point.

    Parameters
    ----------
    bases
        number of morph bases including the mean shape, 2 or more.
    associate
        whether partial tracks may show the same point; see `learn_associated`. If not, every track is a
        separate point.
    """

    bases: Annotated[int, at_least(2)] = 3
    associate: bool = True
    name: str = "structure"

    ports = (Port(PointTracks, Cavity.OTHERS),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: NonrigidTrajectory | None = None
    ) -> Smoothed[NonrigidTrajectory]:
        """Return shape, poses and weights fitted to `incoming`, from scratch.

        Raises
        ------
        ValueError
            as `learn_shape` does, of tracks that are seen in 3 frames or more.
        """
        identities, positions, weights = observations(incoming_over_time)
        positions[weights == 0] = np.nan
        shape, point = learn_associated(positions, self.bases, associate=self.associate)
        stated = 1 / float(np.median(weights[weights > 0]))
        scatter = max(shape.noise**2 - stated, 0.0)
        return Smoothed(NonrigidTrajectory(identities, point, shape, scatter))

    def messages(
        self,
        trajectory: NonrigidTrajectory,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Return the predicted positions of all tracks in each frame that has a pose."""
        shape = trajectory.shape
        positions = shape.shapes()[..., :2]
        covariances = shape.shape_covariances()[..., :2, :2]
        covariances[..., [0, 1], [0, 1]] += trajectory.scatter + LEAST_SCATTER * shape.noise**2
        posed = shape.frame_determined
        messages = iter(
            point_messages(
                trajectory.identities, trajectory.point_of_track, positions[posed], covariances[posed]
            )
        )
        return [next(messages) if has_pose else feature.uniform() for has_pose in posed]

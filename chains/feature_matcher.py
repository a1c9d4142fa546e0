"""Features matched between pictures near and far: points that need no motion from picture to picture.

p(F_t | X) = prod_i 1 / |I|,    evidence = prod_i |I| N(z_ti; u_ti, (0.1 size_ti)^2)

X is which features of all pictures show one point. A point may be anywhere in the next picture, so that the
chain has no message: all that it knows is evidence, where the pictures show its points. It works where a
tracker cannot: on a turntable, a slow camera, pictures in no order. It and `PointTracker` share one feature
node; which of their points are one is for a chain of the shape to find out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..inference.core.protocols import BatchIncoming, Port, Smoothed
from ..inference.points.film_matches import FilmMatches
from ..models.core.gaussian_message import GaussianMessage
from ..models.core.grey import grey_of
from ..models.core.short_repr import short_repr
from ..models.points.features import Features, find_features
from ..models.points.point_tracks import PointMessage, PointTracks

FIRST_IDENTITY = 1 << 32
"""Of the points: trackers number theirs from 0."""


@short_repr
@dataclass(frozen=True, eq=False)
class FeatureTracks:
    """Which features of all pictures show one point.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    frame, point
        `(k,)` int64, of each observation: index of the frame and of the point among `identities`.
    positions
        `(k, 2)` px.
    deviations
        `(k,)` px, standard deviation of each coordinate.
    areas
        `(n_frames,)` px^2 of the pictures, 1 where there is none.
    """

    identities: NDArray[np.int64]
    frame: NDArray[np.int64]
    point: NDArray[np.int64]
    positions: NDArray[np.float64]
    deviations: NDArray[np.float64]
    areas: NDArray[np.float64]

    @property
    def log_prior(self) -> float:
        """Log probability of the observations: each is as likely anywhere in the picture."""
        return -float(np.log(self.areas)[self.frame].sum())

    def evidence(self) -> list[PointMessage]:
        """What each frame shows of the points."""
        messages = []
        for frame, area in enumerate(self.areas):
            here = np.flatnonzero(self.frame == frame)
            covariances = self.deviations[here, None, None] ** 2 * np.eye(2)
            names = self.identities[self.point[here]]
            positions = GaussianMessage.from_moments(names, self.positions[here], covariances)
            messages.append(PointMessage(replace(positions, log_scale=positions.log_scale + np.log(area))))
        return messages


@short_repr
@dataclass(frozen=True)
class FeatureMatcher:
    """Batch chain of points that are recognised from picture to picture, however far they have moved.

    Parameters
    ----------
    n_points
        how many points to have in a picture at least, as far as there are any; those seen most often stay.
    n_features
        how many features of a picture to compare.
    """

    n_points: int = 500
    n_features: int = 4000
    name: str = "matcher"

    ports = (Port(PointTracks),)

    def __post_init__(self) -> None:
        for name in ("n_points", "n_features"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: FeatureTracks | None = None
    ) -> Smoothed[FeatureTracks]:
        """Features of all pictures that show the same points.

        Frames with points that are given have no others.
        """
        tracks = current or self._matched(incoming_over_time)
        node = incoming_over_time[0].node(PointTracks)
        return Smoothed(tracks, {node: tracks.evidence()} if len(tracks.identities) else {})

    def messages(
        self,
        trajectory: FeatureTracks,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Nothing: where a point is in one picture says nothing of where it is in another."""
        return [PointMessage.uniform()] * len(trajectory.areas)

    def _matched(self, incoming_over_time: Sequence[BatchIncoming]) -> FeatureTracks:
        pictures: list[Features] = []
        areas: list[float] = []
        for incoming in incoming_over_time:
            frame = incoming.frame
            if frame.image is None or frame.points is not None:
                pictures.append(Features.none())
                areas.append(1.0)
            else:
                grey = grey_of(frame.image)
                pictures.append(find_features(grey, self.n_features))
                areas.append(float(grey.size))
        matches = FilmMatches.of(pictures)
        features, track = matches.tracks(self.n_points)
        return FeatureTracks(
            FIRST_IDENTITY + np.arange(track.max(initial=-1) + 1),
            matches.frame[features],
            track,
            np.concatenate([each.positions for each in pictures])[features],
            np.concatenate([each.deviations for each in pictures])[features],
            np.array(areas),
        )

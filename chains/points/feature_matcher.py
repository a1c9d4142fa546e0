"""Features matched between pictures near and far: points that need no motion from picture to picture.

p(F_t | X) = prod_i 1 / |I|,    evidence = prod_i |I| N(z_ti; u_ti, (0.1 size_ti)^2)

X is which features of all pictures show one point. A point may be anywhere in the next picture, so that the
chain has no message: all that it knows is evidence, where the pictures show its points. It works where a
tracker cannot: on a turntable, a slow camera, pictures in no order. It and `PointTracker` share one feature
node; which of their points are one is for a chain of the shape to find out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Port, Smoothed
from ...models.core.grey import grey_of
from ...models.core.short_repr import short_repr
from ...models.points.alignment import sample_patches
from ...models.points.point_tracks import PointMessage, PointTracks
from .feature_tracks import FeatureTracks
from .features import Features, find_features


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

        In later rounds matches have to be where other chains say that their points are, and points are
        searched for wherever others expect them. Frames with points that are given have no others.
        """
        if current is None:
            tracks = self._matched(incoming_over_time)
        else:
            tracks = current.searched_again(incoming_over_time)
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
        patches: list[NDArray[np.float32]] = []
        areas = np.ones(len(incoming_over_time))
        for time, incoming in enumerate(incoming_over_time):
            frame, side = incoming.frame, cast(PointTracks, incoming.node(PointTracks)).patch
            if frame.image is None or frame.points is not None:
                pictures.append(Features.none())
                patches.append(np.zeros((0, side, side), np.float32))
            else:
                grey = grey_of(frame.image)
                pictures.append(find_features(grey, self.n_features))
                patches.append(sample_patches(grey, pictures[-1].positions, side))
                areas[time] = grey.size
        return FeatureTracks.of(pictures, patches, areas, self.n_points)

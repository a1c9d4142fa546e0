"""Features matched between pictures near and far: points that need no motion from picture to picture.

p(F_t | X) = prod_i 1 / |I|,    evidence = prod_i |I| N(z_ti; u_ti, (0.1 size_ti)^2)

X is which features of all pictures show one point. A point may be anywhere in the next picture, so that the
chain has no message: all that it knows is evidence, where the pictures show its points. It works where a
tracker cannot: on a turntable, a slow camera, pictures in no order. It and `PointTracker` share one feature
node; which of their points are one is for a chain of the shape to find out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Port, Smoothed
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.pictures import grey_of
from ...models.core.short_repr import short_repr
from ...models.numerics.densities import squared_distances
from ...models.points.patches import Patches, sample_patches
from ...models.points.point_tracks import PointMessage, PointTracks
from .features import Features, FilmMatches, find_features

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

FIRST_IDENTITY = 1 << 32
"""Of points that are matched: trackers number theirs from 0."""

GATE = 4.0
"""Standard deviations from where others say that a point is, beyond which a feature is another one: one right
one in 3000 is."""


@short_repr
@dataclass(frozen=True, eq=False)
class Sightings:
    """In which pictures points are seen, and where.

    Parameters
    ----------
    frame, point
        `(k,)` int64, of each sighting: index of the picture, and of the point.
    positions, covariances
        `(k, 2)` px and `(k, 2, 2)` px^2.
    """

    frame: Indices
    point: Indices
    positions: Numbers
    covariances: Numbers

    def only(self, kept: Mask) -> "Sightings":
        """Those of which `kept` is true."""
        return Sightings(self.frame[kept], self.point[kept], self.positions[kept], self.covariances[kept])

    def joined(self, others: Sequence["Sightings"]) -> "Sightings":
        """These and some more."""
        every = (self, *others)
        return Sightings(
            np.concatenate([each.frame for each in every]),
            np.concatenate([each.point for each in every]),
            np.concatenate([each.positions for each in every]),
            np.concatenate([each.covariances for each in every]),
        )


@short_repr
@dataclass(frozen=True, eq=False)
class FeatureTracks:
    """Points, and where pictures show them.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    matched
        features that were matched, whatever others say of them.
    patches
        `(k, side, side)` float32: what the picture shows about each of these.
    together
        `(n_frames, n_frames)` bool: pictures of which features were matched.
    areas
        `(n_frames,)` px^2 of the pictures, 1 where there is none.
    seen
        what counts: matches that others do not contradict, and what was found where others expect points.
    """

    identities: Indices
    matched: Sightings
    patches: NDArray[np.float32]
    together: Mask
    areas: Numbers
    seen: Sightings

    @classmethod
    def of(
        cls, pictures: Sequence[Features], patches: Sequence[NDArray[np.float32]], areas: Numbers, most: int
    ) -> "FeatureTracks":
        """Match the features of all pictures, of which `patches` has what they look like.

        Parameters
        ----------
        most
            see `FilmMatches.tracks`.
        """
        matches = FilmMatches.of(pictures)
        features, point = matches.tracks(most)
        together = np.zeros((len(pictures), len(pictures)), np.bool_)
        together[tuple(matches.frame[matches.pairs].T)] = True
        deviations = np.concatenate([each.deviations for each in pictures])[features]
        matched = Sightings(
            matches.frame[features],
            point,
            np.concatenate([each.positions for each in pictures])[features],
            deviations[:, None, None] ** 2 * np.eye(2),
        )
        identities = FIRST_IDENTITY + np.arange(point.max(initial=-1) + 1)
        seen = np.concatenate(patches)[features]
        return cls(identities, matched, seen, together | together.T, areas, matched)

    @property
    def log_prior(self) -> float:
        """Log probability of the features that were matched: they are as likely anywhere in the picture.

        The same in all rounds: the features are there in any case, and evidence says how much likelier they
        are where points are expected.
        """
        return -float(np.log(self.areas)[self.matched.frame].sum())

    def evidence(self) -> list[PointMessage]:
        """What each frame shows of the points."""
        messages = []
        for frame, area in enumerate(self.areas):
            here = self.seen.only(self.seen.frame == frame)
            names = self.identities[here.point]
            positions = GaussianMessage.from_moments(names, here.positions, here.covariances)
            messages.append(PointMessage(replace(positions, log_scale=positions.log_scale + np.log(area))))
        return messages

    def searched_again(self, incoming_over_time: Sequence[BatchIncoming]) -> "FeatureTracks":
        """With what pictures show where others say that points are.

        Matches that others contradict do not count. A point that was not matched in a picture is searched
        for there by what it looks like in the nearest one, if these two have been matched.
        """
        stays = np.ones(len(self.matched.frame), np.bool_)
        more = []
        for frame, incoming in enumerate(incoming_over_time):
            expected = incoming.others(PointTracks).positions
            known = expected.identities >= FIRST_IDENTITY
            if self.areas[frame] == 1 or not known.any():
                continue
            identities, mean, covariance = expected.only(known).moments
            point = np.searchsorted(self.identities, identities)
            here = np.flatnonzero(self.matched.frame == frame)
            stays[here] = self._plausible(here, point, mean, covariance)
            absent = np.isin(point, self.matched.point[here[stays[here]]], invert=True)
            nearest = self._nearest(frame, point)
            absent &= nearest >= 0
            positions = GaussianMessage.from_moments(identities[absent], mean[absent], covariance[absent])
            patches = Patches(identities[absent], self.patches[nearest[absent]])
            found = incoming.search(PointTracks, PointMessage(positions, patches)).positions
            names, places, spreads = found.moments
            points = np.searchsorted(self.identities, names)
            more.append(Sightings(np.full(len(names), frame), points, places, spreads))
        return replace(self, seen=self.matched.only(stays).joined(more))

    def _plausible(self, here: Indices, point: Indices, mean: Numbers, covariance: Numbers) -> Mask:
        """`(k,)`: which of the matches `here` may be what others say of the points `(n,)`."""
        place = np.minimum(np.searchsorted(point, self.matched.point[here]), len(point) - 1)
        off = self.matched.positions[here] - mean[place]
        spread = self.matched.covariances[here] + covariance[place]
        unknown = point[place] != self.matched.point[here]
        plausible: Mask = unknown | (squared_distances(off, spread) <= GATE**2)
        return plausible

    def _nearest(self, frame: int, point: Indices) -> Indices:
        """`(n,)`: the match of each point in the picture next to `frame` that was matched with it, or -1."""
        usable = np.flatnonzero(self.together[self.matched.frame, frame])
        far = np.argsort(-np.abs(self.matched.frame[usable] - frame), kind="stable")
        nearest = np.full(len(self.identities), -1)
        nearest[self.matched.point[usable[far]]] = usable[far]  # the last one stays
        return nearest[point]


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

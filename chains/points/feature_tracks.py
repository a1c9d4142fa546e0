"""Points that features of several pictures show: where they were matched, and where they are searched for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.mahalanobis import squared_distances
from ...models.core.short_repr import short_repr
from ...models.points.patches import Patches
from ...models.points.point_tracks import PointMessage, PointTracks
from .features import Features
from .film_matches import FilmMatches

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

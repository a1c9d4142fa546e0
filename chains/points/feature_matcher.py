"""Matching of SIFT features between all pictures of a sequence, whatever the motion between them.

p(F_t | X) = prod_i 1 / |I|,    evidence = prod_i |I| N(z_ti; u_ti, (0.1 size_ti)^2)

X assigns features of all pictures to points. A point may be anywhere in the next picture, so that the chain's
message is uniform: it contributes evidence, the positions of its points. It works where a tracker cannot: on
a turntable, at a low frame rate, with pictures in no order. It shares its feature node with `PointTracker`;
a chain of the shape finds which of their points are the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...inference.engine.protocols import BatchIncoming, Port, Smoothed
from ...inference.sfm.perspective.structure import tied_frames
from ...models.core.checks import Count, checked
from ...models.core.gaussian_message import GaussianMessage, squared_distances
from ...models.core.identities import find, places_of
from ...models.core.pictures import grey_of
from ...models.core.short_repr import Rows, short_repr
from ...models.numerics.compiled import compiled
from ...models.numerics.threads import side_by_side
from ...models.points.patches import Patches, sample_patches
from ...models.points.point_tracks import PointMessage, PointTracks


@compiled
def best_and_second(likeness, rows, columns, n):
    """Return the column place of the largest entry of each of `n` row places, the entry, and the second one.

    Entries of `likeness` (k, l) are of the places `rows` (k,) and `columns` (l,); the second one is the
    largest of another column place.
    """
    nearest = np.zeros(n, np.int64)
    best, second = np.full(n, np.float32(-1)), np.full(n, np.float32(-1))
    for i in range(likeness.shape[0]):
        row = likeness[i]
        place, first, after = nearest[rows[i]], best[rows[i]], second[rows[i]]
        for j in range(row.shape[0]):
            value = row[j]
            if value > after:
                if columns[j] == place:
                    first = max(first, value)
                elif value > first:
                    after, first, place = first, value, columns[j]
                else:
                    after = value
        nearest[rows[i]], best[rows[i]], second[rows[i]] = place, first, after
    return nearest, best, second


@compiled
def nearest_earlier(pairs, n):
    """Return for each of `n` the first one of its group: `pairs` (k, 2) are in order, the earlier first."""
    group = np.arange(n)
    for number in range(pairs.shape[0]):
        one, other = pairs[number, 0], pairs[number, 1]
        if group[one] == one and group[other] == other:
            group[other] = one
    return group


@compiled
def keep_near(likeness, one, other, least, tolerance):
    """Set `likeness` (k, l) to 0 below `least`, and where a feature is not where the other one allows it.

    `one` (8, k) and `other` (8, l) are of each descriptor: x, y, and in the other picture the line a, b, c,
    from which a feature may be `tolerance` px away, and the middle and the square of the radius of a circle.
    """
    for i in range(likeness.shape[0]):
        row = likeness[i]
        x, y = one[0, i], one[1, i]
        a, b, c, right, down, reach = one[2, i], one[3, i], one[4, i], one[5, i], one[6, i], one[7, i]
        for j in range(row.shape[0]):
            u, v = other[0, j], other[1, j]
            there = max(abs(a * u + b * v + c) - tolerance, (u - right) ** 2 + (v - down) ** 2 - reach)
            off = abs(other[2, j] * x + other[3, j] * y + other[4, j]) - tolerance
            back = max(off, (x - other[5, j]) ** 2 + (y - other[6, j]) ** 2 - other[7, j])
            row[j] = row[j] if max(there, back) <= 0 and row[j] >= least else np.float32(0)


@compiled
def join_matches(matches, frame, n_frames):
    """Return the track of each feature, joined by `matches`, never two of one `frame` (n,) in a track."""
    n = frame.shape[0]
    track, after, length = np.arange(n), np.arange(n), np.ones(n, np.int64)
    stamp = np.full(n_frames, -1)
    for number in range(matches.shape[0]):
        one, other = track[matches[number, 0]], track[matches[number, 1]]
        if one == other:
            continue
        if length[one] < length[other]:
            one, other = other, one
        member = one
        for _ in range(length[one]):
            stamp[frame[member]] = number
            member = after[member]
        member, apart = other, True
        for _ in range(length[other]):
            apart = apart and stamp[frame[member]] != number
            member = after[member]
        if apart:
            for _ in range(length[other]):
                track[member] = one
                member = after[member]
            after[one], after[other] = after[other], after[one]
            length[one] += length[other]
    return track


Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

CONTRAST = 0.005  # of a feature, as OpenCV has it, where Lowe has 0.04: noise has many, but none that match
SMALL = 500_000  # pixels: up to there pictures are searched side by side, which takes 200 bytes per pixel
TILTS = 2  # of surfaces for affine features: by 45 and 60 degrees (Morel, Yu, "ASIFT", 2009)
SAME_PLACE = 1.5  # px: nearer affine features, of different tilts, are one

LOCALISATION = 0.1
"""Standard deviation of a feature's position along an axis, as a share of its size: measured on a turning
body."""

LARGEST = 10.0  # px: features of a larger size are located too badly
RATIO = 0.8  # largest distance of the nearest neighbour over that of the second nearest (Lowe 2004)

NEIGHBOURS, SPREADS = 8, 1.0
"""Matches nearest to a feature, and standard deviations of their motion within which its own has to be:
outside most matches are wrong."""

LEAST_LIKENESS = 0.9
"""Least likeness of two features that are matched among a few candidates, where the ratio tells little: of
pairs that are a pixel or two apart, 96 % are right from there on, 80 % from 0.85 on."""

DESCRIPTOR = 128  # numbers of a descriptor
UNIT = 255.0  # length of a descriptor that is stored


@short_repr
@dataclass(frozen=True, eq=False)
class Features:
    """Features of a picture, each of which may have several descriptors."""

    positions: Array  # (n, 2) px
    deviations: Array  # (n,) px, standard deviation of each coordinate
    descriptors: NDArray[np.uint8]  # (k, 128), square roots, of length `UNIT` but for rounding
    place: Indices  # (k,): the feature that each of them describes

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def none(cls) -> "Features":
        """Return no features."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros((0, DESCRIPTOR), np.uint8), np.zeros(0, np.int64))


def find_features(grey: NDArray[np.uint8], most: int, *, affine: bool = False) -> Features:
    """Return the features of a picture `(height, width)`, at most the `most` of highest contrast.

    `affine`: also as they look on surfaces that are tilted.
    """
    # without precise upscaling places are 0.25 px off to the upper left
    finder: cv2.Feature2D = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
    if affine:
        finder = cv2.AffineFeature.create(finder, maxTilt=TILTS)
    points, descriptors = finder.detectAndCompute(grey, None)
    rows = np.array([(*point.pt, point.size, point.response) for point in points]).reshape(-1, 4)
    _, first = np.unique(rows[:, :3], axis=0, return_index=True)
    inside = (rows[first, :2] >= 0).all(axis=1) & (rows[first, :2] < grey.shape[::-1]).all(axis=1)
    first = np.sort(first[inside & (rows[first, 2] <= LARGEST)])
    best = first[np.argsort(-rows[first, 3], kind="stable")[:most]]
    if not len(best):
        return Features.none()
    positions, group = rows[best, :2], np.arange(len(best))
    if affine:
        pairs = cKDTree(positions).query_pairs(SAME_PLACE, output_type="ndarray")
        group = nearest_earlier(pairs[np.lexsort(pairs.T[::-1])], len(best))
    kept, place = np.unique(group, return_inverse=True)
    sums = np.maximum(descriptors[best].sum(axis=1, keepdims=True), 1e-12)
    roots = np.rint(UNIT * np.sqrt(descriptors[best] / sums)).astype(np.uint8)
    return Features(positions[kept], LOCALISATION * rows[best[kept], 2], roots, place)


def match_features(one: Features, other: Features) -> tuple[Indices, Array]:
    """Match features of two pictures that are mutual nearest neighbours and pass the ratio test.

    Returns pairs `(m, 2)`, of `one` and of `other`, and their doubt `(m,)`: the larger of both ratios of the
    nearest to the second nearest distance, below `RATIO`.
    """
    return _mutual_matches(_likeness(one, other), one, other)


def match_along_lines(
    one: Features, other: Features, pairs: Indices, fundamental: Array, tolerance: float
) -> tuple[Indices, Array]:
    """Match as `match_features`, among the features that given `pairs` and their epipolar geometry allow.

    These are within `tolerance` px of the epipolar line, and within the motion of the nearest pairs, since
    repeated things are often repeated along the line. `pairs` are at least `NEIGHBOURS`; `fundamental` is
    `(3, 3)`, x' F x = 0 for x of `one` and x' of `other`.
    """
    return _matched_along_lines(_likeness(one, other), one, other, pairs, fundamental, tolerance)


def _matched_along_lines(
    likeness: NDArray[np.float32],
    one: Features,
    other: Features,
    pairs: Indices,
    fundamental: Array,
    tolerance: float,
) -> tuple[Indices, Array]:
    """Return the same, given the likeness of descriptors, which is overwritten."""
    allowed = []
    for here, there, geometry, known in (
        (one, other, fundamental, pairs),
        (other, one, fundamental.T, pairs[:, ::-1]),
    ):
        lines = here.positions @ geometry[:, :2].T + geometry[:, 2]
        lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
        known_from, known_to = here.positions[known[:, 0]], there.positions[known[:, 1]]
        _, near = cKDTree(known_from).query(here.positions, NEIGHBOURS)
        motion = (known_to - known_from)[near]
        middle = here.positions + motion.mean(axis=1)
        reach = SPREADS * np.sqrt(motion.var(axis=1).sum(axis=1)) + 2 * tolerance
        numbers = np.concatenate([here.positions, lines, middle, reach[:, None] ** 2], axis=1)
        allowed.append(np.ascontiguousarray(numbers[here.place].T))
    keep_near(likeness, *allowed, np.float32(LEAST_LIKENESS), tolerance)
    return _mutual_matches(likeness, one, other)


def _likeness(one: Features, other: Features) -> NDArray[np.float32]:
    """Return scalar products of descriptors of length 1, `(k, l)`."""
    likeness: NDArray[np.float32] = (
        one.descriptors.astype(np.float32) @ other.descriptors.astype(np.float32).T
    )
    likeness *= np.float32(UNIT**-2)
    return likeness


def _mutual_matches(likeness: NDArray[np.float32], one: Features, other: Features) -> tuple[Indices, Array]:
    """Return mutual matches and their doubt, by the likeness of descriptors; see `match_features`."""
    if min(len(one), len(other)) < 2:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    nearest, best, second = best_and_second(likeness, one.place, other.place, len(one))
    nearest_back, best_back, second_back = best_and_second(
        np.ascontiguousarray(likeness.T), other.place, one.place, len(other)
    )
    mutual = np.flatnonzero((nearest_back[nearest] == np.arange(len(nearest))) & (best > 0))
    there = nearest[mutual]
    doubt = np.maximum(_ratio(best[mutual], second[mutual]), _ratio(best_back[there], second_back[there]))
    sure = doubt < RATIO
    return np.stack([mutual, there], axis=1)[sure], doubt[sure]


def _ratio(best: NDArray[np.float32], second: NDArray[np.float32]) -> Array:
    """Return the ratio of distances of unit vectors, given their scalar products."""
    near, far = (np.maximum(1 - each.astype(np.float64), 1e-9) for each in (best, second))
    ratio: Array = np.sqrt(near / far)
    return ratio


STEPS = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89)  # steps to the pictures matched with each one, until one fails
LOOPS = 3  # most similar pictures with which each one is matched as well
WORDS = 256  # visual words by whose frequencies pictures are compared
LEAST_MATCHES = 15  # of two pictures: a fundamental matrix fits 7 by chance
EPIPOLAR = 1.5  # px from the epipolar line, about three standard deviations of usual features
LEAST_LENGTH = 3  # pictures that have to show a point: of two any camera explains it
MOST_WIDE = 64  # pictures that are tried again with affine features: of more, many will be close


@dataclass(frozen=True, eq=False)
class FilmMatches:
    """Matches between the pictures of a film."""

    frame: Indices  # (n,): the picture of each feature, those of all pictures one after the other
    # (m, 2): features that look alike and obey one epipolar geometry
    pairs: Indices
    doubt: Array  # (m,): of each pair; see `match_features`

    @classmethod
    def of(cls, pictures: Sequence[Features]) -> "FilmMatches":
        """Match each picture with later ones, in growing steps while they match, and with similar ones."""
        edges = np.concatenate([[0], np.cumsum([len(each) for each in pictures])])

        def together(one: int, other: int) -> tuple[int, int, Indices, Array]:
            return one, other, *_verify_matches(pictures[one], pictures[other])

        def with_later(one: int) -> list[tuple[int, int, Indices, Array]]:
            tried: list[tuple[int, int, Indices, Array]] = []
            for step in STEPS:
                if one + step >= len(pictures) or (tried and not len(tried[-1][2])):
                    break
                tried.append(together(one, one + step))
            return tried

        later = side_by_side([partial(with_later, one) for one in range(len(pictures))])
        tried = [each for of_one in later for each in of_one]
        similar = _similar_pictures(pictures, {(one, other) for one, other, _, _ in tried})
        tried += side_by_side([partial(together, one, other) for one, other in similar])
        frame = np.repeat(np.arange(len(pictures)), np.diff(edges))
        pairs = [
            np.zeros((0, 2), np.int64),
            *(matches + edges[[one, other]] for one, other, matches, _ in tried),
        ]
        return cls(frame, np.concatenate(pairs), np.concatenate([np.zeros(0), *(each[3] for each in tried)]))

    def tracks(self, most: int) -> tuple[Indices, Indices]:
        """Join features into tracks, the surest matches first, never two of one picture.

        Keeps tracks that are among the `most` longest of a picture. Returns the features `(k,)` that are part
        of a track, and their tracks `(k,)`, numbered from 0 in order of their first features.
        """
        order = np.argsort(self.doubt, kind="stable")
        track = join_matches(self.pairs[order], self.frame, int(self.frame.max(initial=0)) + 1)
        length = np.bincount(track, minlength=len(track))
        features = np.flatnonzero(length[track] >= LEAST_LENGTH)
        _, track = np.unique(track[features], return_inverse=True)
        kept = _longest(track, self.frame[features], most)[track]
        features, track = features[kept], track[kept]
        _, first, track = np.unique(track, return_index=True, return_inverse=True)
        names = np.empty(len(first), np.int64)
        names[np.argsort(first)] = np.arange(len(first))
        return features, names[track]


def _longest(track: Indices, frame: Indices, most: int) -> Mask:
    """Return which tracks are among the `most` longest in at least one picture."""
    length = np.bincount(track)
    order = np.lexsort((track, -length[track], frame))
    starts = np.concatenate([[True], np.diff(frame[order]) > 0])
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    kept = np.zeros(len(length), np.bool_)
    kept[track[order[rank < most]]] = True
    return kept


def _verify_matches(one: Features, other: Features) -> tuple[Indices, Array]:
    """Return the matches of two pictures that obey one epipolar geometry, if there are enough."""
    likeness = _likeness(one, other)
    pairs, doubt = _mutual_matches(likeness, one, other)
    if len(pairs) >= LEAST_MATCHES:
        left, right = one.positions[pairs[:, 0]], other.positions[pairs[:, 1]]
        try:
            geometry, obeys = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, EPIPOLAR, 0.999, 5000)
        except cv2.error:  # raised if no sample of seven matches determines the geometry
            geometry, obeys = cv2.findFundamentalMat(left, right, cv2.FM_RANSAC, EPIPOLAR, 0.999, 5000)
        if geometry is not None and np.count_nonzero(obeys) >= LEAST_MATCHES:
            fundamental = np.asarray(geometry[:3], np.float64)
            known = pairs[obeys[:, 0] > 0]
            return _matched_along_lines(likeness, one, other, known, fundamental, EPIPOLAR)
    return pairs[:0], doubt[:0]


def _similar_pictures(pictures: Sequence[Features], tried: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return pairs of most similar pictures, the earlier first, that were not `tried` yet."""
    every = np.concatenate([each.descriptors for each in pictures])
    if not len(every):
        return []
    words = every[np.linspace(0, len(every) - 1, min(WORDS, len(every))).astype(int)].astype(np.float32)
    shares = np.array([_shares(each.descriptors, words) for each in pictures])
    rarity = np.log(len(pictures) / np.maximum(np.count_nonzero(shares, axis=0), 1)) + 1
    shares *= rarity
    shares /= np.maximum(np.linalg.norm(shares, axis=1, keepdims=True), 1e-12)
    known = np.eye(len(pictures), dtype=np.bool_)
    for one, other in tried:
        known[one, other] = known[other, one] = True
    chosen = set()
    for one, share in enumerate(shares):
        alike = np.where(known[one], -1.0, shares @ share)
        best = np.argsort(-alike, kind="stable")[:LOOPS]
        chosen |= {(min(one, other), max(one, other)) for other in best[alike[best] > 0].tolist()}
    return sorted(chosen)


def _shares(descriptors: NDArray[np.uint8], words: NDArray[np.float32]) -> Array:
    """Return square roots of the counts of descriptors nearest to each word."""
    nearest = (
        (descriptors.astype(np.float32) @ words.T).argmax(axis=1) if len(descriptors) else np.zeros(0, int)
    )
    return np.sqrt(np.bincount(nearest, minlength=len(words)).astype(np.float64))


FIRST_IDENTITY = 1 << 32  # of points that are matched: trackers number theirs from 0

GATE = 4.0
"""Standard deviations from others' predictions beyond which a match is rejected: one in 3000 true ones is."""


@short_repr
@dataclass(frozen=True, eq=False)
class Observations(Rows):
    """Frame, point, position (px) and covariance (px^2) of `k` observations."""

    frame: Indices
    point: Indices
    positions: Array
    covariances: Array


@short_repr
@dataclass(frozen=True, eq=False)
class FeatureTracks:
    """Points, and their observations in all pictures."""

    identities: Indices  # (n,), increasing
    matched: Observations  # matched features
    patches: NDArray[np.float32]  # (k, side, side): grey values about each of these
    together: Mask  # (n_frames, n_frames): pictures with features in common
    areas: Array  # (n_frames,) px^2 of the pictures, 1 without a picture
    seen: Observations  # matches that agree with other chains, and points found where these predict them

    @classmethod
    def of(
        cls, pictures: Sequence[Features], patches: Sequence[NDArray[np.float32]], areas: Array, most: int
    ) -> "FeatureTracks":
        """Match the features of all pictures, with their `patches`."""
        matches = FilmMatches.of(pictures)
        features, point = matches.tracks(most)
        together = np.zeros((len(pictures), len(pictures)), np.bool_)
        together[tuple(matches.frame[matches.pairs].T)] = True
        deviations = np.concatenate([each.deviations for each in pictures])[features]
        matched = Observations(
            matches.frame[features],
            point,
            np.concatenate([each.positions for each in pictures])[features],
            deviations[:, None, None] ** 2 * np.eye(2),
        )
        identities = FIRST_IDENTITY + np.arange(point.max(initial=-1) + 1)
        seen = np.concatenate(patches)[features]
        return cls(identities, matched, seen, together | together.T, areas, matched)

    @property
    def tied(self) -> Mask:
        """`(n_frames,)`: whether points tie a picture to most others; see `tied_frames`."""
        shown = np.zeros((len(self.areas), len(self.identities)), np.bool_)
        shown[self.matched.frame, self.matched.point] = True
        return tied_frames(shown) & bool(len(self.identities))

    @property
    def log_prior(self) -> float:
        """Log probability of the matched features under the uniform density over the picture.

        It is the same in all rounds: the evidence is relative to this density.
        """
        return -float(np.log(self.areas)[self.matched.frame].sum())

    def evidence(self) -> list[PointMessage]:
        """Return the evidence of each frame."""
        messages = []
        for frame, area in enumerate(self.areas):
            here = self.seen.only(self.seen.frame == frame)
            names = self.identities[here.point]
            positions = GaussianMessage.from_moments(names, here.positions, here.covariances)
            messages.append(PointMessage(replace(positions, log_scale=positions.log_scale + np.log(area))))
        return messages

    def search_again(self, incoming_over_time: Sequence[BatchIncoming]) -> "FeatureTracks":
        """Search for the points where other chains predict them, and drop matches that these contradict."""
        stays = np.ones(len(self.matched.frame), np.bool_)
        more = []
        for frame, incoming in enumerate(incoming_over_time):
            expected = incoming.others(PointTracks).positions
            known = expected.identities >= FIRST_IDENTITY
            if self.areas[frame] == 1 or not known.any():
                continue
            identities, mean, covariance = expected.only(known).moments
            point = places_of(self.identities, identities)
            here = np.flatnonzero(self.matched.frame == frame)
            stays[here] = self._is_plausible(here, point, mean, covariance)
            absent = np.isin(point, self.matched.point[here[stays[here]]], invert=True)
            nearest = self._nearest(frame, point)
            absent &= nearest >= 0
            positions = GaussianMessage.from_moments(identities[absent], mean[absent], covariance[absent])
            patches = Patches(identities[absent], self.patches[nearest[absent]])
            found = incoming.search(PointTracks, PointMessage(positions, patches)).positions
            names, places, spreads = found.moments
            points = places_of(self.identities, names)
            more.append(Observations(np.full(len(names), frame), points, places, spreads))
        return replace(self, seen=self.matched.only(stays).joined(more))

    def _is_plausible(self, here: Indices, point: Indices, mean: Array, covariance: Array) -> Mask:
        """Return which of the matches `here` agree with others' predictions of the points, `(k,)`."""
        place, is_expected = find(point, self.matched.point[here])
        off = self.matched.positions[here] - mean[place]
        spread = self.matched.covariances[here] + covariance[place]
        plausible: Mask = ~is_expected | (squared_distances(off, spread) <= GATE**2)
        return plausible

    def _nearest(self, frame: int, point: Indices) -> Indices:
        """Return the match of each point in the nearest picture that was matched with `frame`, or -1."""
        usable = np.flatnonzero(self.together[self.matched.frame, frame])
        far = np.argsort(-np.abs(self.matched.frame[usable] - frame), kind="stable")
        nearest = np.full(len(self.identities), -1)
        nearest[self.matched.point[usable[far]]] = usable[far]  # the last one stays
        return nearest[point]


@checked
@short_repr
@dataclass(frozen=True)
class FeatureMatcher:
    """Batch chain of points matched by their features between distant images.

    Parameters
    ----------
    n_points
        number of points per image, those seen most often.
    n_features
        number of features per image to match.
    """

    n_points: Count = 500
    n_features: Count = 4000
    name: str = "matcher"

    ports = (Port(PointTracks),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: FeatureTracks | None = None
    ) -> Smoothed[FeatureTracks]:
        """Match the features of all images.

        In later rounds matches have to agree with the predictions of other chains, and points are searched
        for at these. Frames with given points are not matched.
        """
        if current is None:
            tracks = self._match_pictures(incoming_over_time)
        else:
            tracks = current.search_again(incoming_over_time)
        node = incoming_over_time[0].node(PointTracks)
        return Smoothed(tracks, {node: tracks.evidence()} if len(tracks.identities) else {})

    def messages(
        self,
        trajectory: FeatureTracks,
        feature: PointTracks,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PointMessage]:
        """Return uniform messages: a position in one image does not predict that in another."""
        return [PointMessage.uniform()] * len(trajectory.areas)

    def _match_pictures(self, incoming_over_time: Sequence[BatchIncoming]) -> FeatureTracks:
        """Match plain features, and affine ones where these do not tie all pictures together."""
        side = cast(PointTracks, incoming_over_time[0].node(PointTracks)).patch_size
        greys = [
            None if each.frame.image is None or each.frame.points is not None else grey_of(each.frame.image)
            for each in incoming_over_time
        ]
        shown = np.array([grey is not None for grey in greys])
        tracks = self._tracks(greys, side, affine=False)
        if 0 < np.count_nonzero(shown) <= MOST_WIDE and not tracks.tied[shown].all():
            tracks = self._tracks(greys, side, affine=True)
        return tracks

    def _tracks(self, greys: Sequence[NDArray[np.uint8] | None], side: int, *, affine: bool) -> FeatureTracks:
        def seen(grey: NDArray[np.uint8] | None) -> tuple[Features, NDArray[np.float32]]:
            if grey is None:
                return Features.none(), np.zeros((0, side, side), np.float32)
            features = find_features(grey, self.n_features, affine=affine)
            return features, sample_patches(grey, features.positions, side)

        areas = np.array([1 if grey is None else grey.size for grey in greys], np.float64)
        works = [partial(seen, grey) for grey in greys]
        found = side_by_side(works) if areas.max() <= SMALL else [work() for work in works]
        pictures, patches = zip(*found, strict=True)
        return FeatureTracks.of(pictures, patches, areas, self.n_points)

"""Features of pictures far apart (SIFT, Lowe 2004), matched over a whole film and joined into tracks.

Descriptors are compared by their square roots (Arandjelovic and Zisserman 2012), of which the scalar product
is a likeness from 0 to 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from ...models.core.short_repr import short_repr
from .kernels import best_and_second, join_matches, keep_near

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

CONTRAST = 0.02
"""Of a feature, as OpenCV has it: half of Lowe's, so that matt things have some, too."""

LOCALISATION = 0.1
"""Standard deviation of a feature's place along an axis, as a share of its size: measured on a body that
turns."""

LARGEST = 10.0
"""px, size from which a feature says too little of where it is."""

RATIO = 0.8
"""Distance of a feature's nearest neighbour over that of the second nearest, from which on nobody knows which
of them it is (Lowe 2004)."""

NEIGHBOURS, SPREADS = 8, 1.0
"""Pairs nearest to a feature, and standard deviations of their motion within which it moves: where it moves
otherwise, something else is like it more often than not."""

LEAST_LIKENESS = 0.9
"""Of two features that are matched among few, where the second nearest says little: of pairs that are a pixel
or two apart, 96 % are right from there on, 80 % from 0.85 on."""

DESCRIPTOR = 128
"""Numbers of a descriptor."""

UNIT = 255.0
"""Length of a descriptor that is stored."""


@short_repr
@dataclass(frozen=True, eq=False)
class Features:
    """Features of a picture.

    Parameters
    ----------
    positions
        `(n, 2)` px.
    deviations
        `(n,)` px, standard deviation of each coordinate.
    descriptors
        `(n, 128)` uint8, square roots, of length `UNIT` but for rounding.
    """

    positions: Numbers
    deviations: Numbers
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def none(cls) -> "Features":
        """No features."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros((0, DESCRIPTOR), np.uint8))


def find_features(grey: NDArray[np.uint8], most: int) -> Features:
    """Features of a picture `(height, width)`, those of most contrast if there are more than `most`.

    Of those at one place with several directions the first is kept.
    """
    # without it places are 0.25 px off to the upper left
    sift = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
    points = sift.detect(grey, None)
    rows = np.array([(*point.pt, point.size, point.response) for point in points]).reshape(-1, 4)
    _, first = np.unique(rows[:, :3], axis=0, return_index=True)
    first = np.sort(first[rows[first, 2] <= LARGEST])
    best = first[np.argsort(-rows[first, 3], kind="stable")[:most]]
    if not len(best):
        return Features.none()
    _, descriptors = sift.compute(grey, [points[number] for number in best])
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    roots = np.rint(UNIT * np.sqrt(descriptors / sums)).astype(np.uint8)
    return Features(rows[best, :2], LOCALISATION * rows[best, 2], roots)


def match_features(one: Features, other: Features) -> tuple[Indices, Numbers]:
    """Features of two pictures that are each other's nearest, and far nearer than the second.

    Returns
    -------
    pairs
        `(m, 2)`: feature of `one` and of `other`.
    doubt
        `(m,)`: the larger of both ratios of the nearest to the second nearest distance, below `RATIO`.
    """
    return _mutual(_likeness(one, other))


def match_along_lines(
    one: Features, other: Features, pairs: Indices, fundamental: Numbers, tolerance: float
) -> tuple[Indices, Numbers]:
    """As `match_features`, among the few features where some `pairs` that are known leave a choice.

    That is near the epipolar line, and within the motion of the nearest pairs: repeated things are often
    repeated along the line.

    Parameters
    ----------
    pairs
        `(m, 2)`, at least `NEIGHBOURS` of them, as of `match_features`.
    fundamental
        `(3, 3)`: x' F x = 0 for x of `one` and x' of `other`.
    tolerance
        px from the epipolar line, on either side.
    """
    likeness = _likeness(one, other)
    for here, there, rows, geometry, known in (
        (one, other, likeness, fundamental, pairs),
        (other, one, likeness.T, fundamental.T, pairs[:, ::-1]),
    ):
        lines = here.positions @ geometry[:, :2].T + geometry[:, 2]
        lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
        known_from, known_to = here.positions[known[:, 0]], there.positions[known[:, 1]]
        _, near = cKDTree(known_from).query(here.positions, NEIGHBOURS)
        motion = (known_to - known_from)[near]
        middle = here.positions + motion.mean(axis=1)
        reach = SPREADS * np.sqrt(motion.var(axis=1).sum(axis=1)) + 2 * tolerance
        keep_near(rows, lines, middle, reach, there.positions, tolerance)
    likeness[likeness < LEAST_LIKENESS] = 0
    return _mutual(likeness)


def _likeness(one: Features, other: Features) -> NDArray[np.float32]:
    """`(n, m)`: scalar products of descriptors of length 1."""
    likeness: NDArray[np.float32] = (
        one.descriptors.astype(np.float32) @ other.descriptors.astype(np.float32).T
    )
    likeness *= np.float32(UNIT**-2)
    return likeness


def _mutual(likeness: NDArray[np.float32]) -> tuple[Indices, Numbers]:
    """Pairs and their doubt; see `match_features`."""
    if min(likeness.shape) < 2:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    nearest, best, second = best_and_second(likeness)
    nearest_back, best_back, second_back = best_and_second(np.ascontiguousarray(likeness.T))
    mutual = np.flatnonzero((nearest_back[nearest] == np.arange(len(nearest))) & (best > 0))
    there = nearest[mutual]
    doubt = np.maximum(_ratio(best[mutual], second[mutual]), _ratio(best_back[there], second_back[there]))
    sure = doubt < RATIO
    return np.stack([mutual, there], axis=1)[sure], doubt[sure]


def _ratio(best: NDArray[np.float32], second: NDArray[np.float32]) -> Numbers:
    """Ratio of distances of unit vectors, of which these are the scalar products."""
    near, far = (np.maximum(1 - each.astype(np.float64), 1e-9) for each in (best, second))
    ratio: Numbers = np.sqrt(near / far)
    return ratio


STEPS = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89)
"""Pictures from one to the next that it is matched with: as many as there is a common view."""

LOOPS = 3
"""Pictures that are most alike, which each one is matched with beside its neighbours."""

WORDS = 256
"""Descriptors by whose shares pictures are compared."""

LEAST_MATCHES = 15
"""Matches on which two pictures have to agree: a fundamental matrix takes 7, and chance is to do no more."""

EPIPOLAR = 1.5
"""px from the epipolar line, about three standard deviations of usual features."""

LEAST_LENGTH = 3
"""Pictures that have to show a point, so that one confirms the match of two others."""


@dataclass(frozen=True, eq=False)
class FilmMatches:
    """Matches between the pictures of a film.

    Parameters
    ----------
    frame
        `(n,)` int64: the picture of each feature, those of all pictures one after the other.
    pairs
        `(m, 2)` int64: numbers of features that look alike and obey one epipolar geometry, as a third picture
        confirms.
    doubt
        `(m,)`: of each pair; see `match_features`.
    """

    frame: Indices
    pairs: Indices
    doubt: Numbers

    @classmethod
    def of(cls, pictures: Sequence[Features]) -> "FilmMatches":
        """Match each picture with those after it, in growing steps while they show the same, and with those
        that are most alike, whenever they were taken."""
        edges = np.concatenate([[0], np.cumsum([len(each) for each in pictures])])
        pairs: list[Indices] = []
        doubts: list[Numbers] = []
        tried: set[tuple[int, int]] = set()

        def tried_together(one: int, other: int) -> bool:
            tried.add((one, other))
            matches, doubt = _verified(pictures[one], pictures[other])
            if not len(matches):
                return False
            pairs.append(matches + edges[[one, other]])
            doubts.append(doubt)
            return True

        for one in range(len(pictures)):
            for step in STEPS:
                if one + step >= len(pictures) or not tried_together(one, one + step):
                    break
        for one, other in _alike(pictures, tried):
            tried_together(one, other)
        frame = np.repeat(np.arange(len(pictures)), np.diff(edges))
        if not pairs:
            return cls(frame, np.zeros((0, 2), np.int64), np.zeros(0))
        every, doubt = np.concatenate(pairs), np.concatenate(doubts)
        sure = _confirmed(every, len(frame))
        return cls(frame, every[sure], doubt[sure])

    def tracks(self, most: int) -> tuple[Indices, Indices]:
        """Features joined into tracks, the surest matches first, never two of one picture.

        Parameters
        ----------
        most
            of the tracks in a picture the longest count, as many as this.

        Returns
        -------
        features
            `(k,)`: those that are part of a track.
        track
            `(k,)`: their tracks, numbered from 0 in order of their first features.
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


def _confirmed(pairs: Indices, n_features: int) -> Mask:
    """Which matches a third picture confirms: both features match the same one there.

    An epipolar line is long; two of them cross in a point.
    """
    ones = np.ones(2 * len(pairs), np.int32)
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    matched = coo_array((ones, (rows, columns)), shape=(n_features, n_features)).tocsr()
    confirmed: Mask = (matched @ matched)[pairs[:, 0], pairs[:, 1]] > 0
    return confirmed


def _longest(track: Indices, frame: Indices, most: int) -> Mask:
    """Which tracks are among the `most` longest in one of their pictures at least."""
    length = np.bincount(track)
    order = np.lexsort((track, -length[track], frame))
    starts = np.concatenate([[True], np.diff(frame[order]) > 0])
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    kept = np.zeros(len(length), np.bool_)
    kept[track[order[rank < most]]] = True
    return kept


def _verified(one: Features, other: Features) -> tuple[Indices, Numbers]:
    """Matches of two pictures that obey one epipolar geometry, if there are enough.

    With that geometry they are matched again: there are fewer rivals along a line.
    """
    pairs, doubt = match_features(one, other)
    if len(pairs) >= LEAST_MATCHES:
        left, right = one.positions[pairs[:, 0]], other.positions[pairs[:, 1]]
        try:
            geometry, obeys = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, EPIPOLAR, 0.999, 5000)
        except cv2.error:  # as it happens where no sample of seven matches determines the geometry
            geometry, obeys = cv2.findFundamentalMat(left, right, cv2.FM_RANSAC, EPIPOLAR, 0.999, 5000)
        if geometry is not None and np.count_nonzero(obeys) >= LEAST_MATCHES:
            fundamental = np.asarray(geometry[:3], np.float64)
            return match_along_lines(one, other, pairs[obeys[:, 0] > 0], fundamental, EPIPOLAR)
    return pairs[:0], doubt[:0]


def _alike(pictures: Sequence[Features], tried: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs of pictures, the earlier first, that have much in common and were not tried yet."""
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


def _shares(descriptors: NDArray[np.uint8], words: NDArray[np.float32]) -> Numbers:
    """How many descriptors are nearest to each word, as square roots: many of one kind count less."""
    nearest = (
        (descriptors.astype(np.float32) @ words.T).argmax(axis=1) if len(descriptors) else np.zeros(0, int)
    )
    return np.sqrt(np.bincount(nearest, minlength=len(words)).astype(np.float64))

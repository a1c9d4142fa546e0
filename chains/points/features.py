"""Features that are found in pictures far apart: where they are and what they look like (SIFT, Lowe 2004).

Descriptors are compared by their square roots (Arandjelovic and Zisserman 2012), of which the scalar product
is a likeness from 0 to 1.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...models.core.short_repr import short_repr
from .kernels.descriptors import best_and_second, keep_near

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

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

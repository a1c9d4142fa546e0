"""Points found in a picture by what they look like: where, how surely, and when rather not at all.

A patch of 5x5 pixels is easily found where it is not. Three things are asked of a place:

- It is like the patch. The wider the window, the likelier something in it is so by chance. How likely was
  counted on pairs of nine unrelated pictures, corners of one looked for in the other; see `least_likeness`.
- It has no rival. Where a second place is nearly as like it, the prior decides between them, or nobody does.
- It leads back. What is found is looked for in the picture before, and is where the point was.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.mahalanobis import squared_distances
from . import patch_search
from .alignment import Aligned, align_patches
from .kernels.correlation import best_places

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Grey = NDArray[np.uint8]
Pixels = NDArray[np.float32]

REACH = 3.0
"""Standard deviations from where a point should be within which it is looked for."""

GRID = 0.5
"""px, standard deviation added to what is known of a position: places are compared pixel by pixel, and any
hand that holds a camera soon moves it by half a pixel more than expected."""

ODDS = 10.0
"""By which a place must be likelier than its rival."""

NEAR = 1.0
"""px: places that are nearer to each other are one. So far may fractions of a pixel lead, and the way
back."""

LEAST_SPREAD, MOST_SPREAD = 0.05, 0.7
"""px, standard deviation of a found position: the least there is, and from which on it is as good as not
found."""

SHARPNESS, LIKENESS_NOISE = 3.5, 0.02
"""How -log(1 - correlation^2) grows into a log likelihood, and the noise that limits it."""


def least_likeness(false_alarms: float, area: ArrayLike, side: int) -> Numbers:
    """Normalised correlation that a share of `false_alarms` of windows without the point exceeds by chance.

    The expected number of places that are at least so like a patch of `side` px in `area` px^2 is
    0.24 (area / 1089)^0.56 (5 / side)^2.5 ((1 - likeness) / 0.1)^2.5: a fit to counts for sides from 5 to 11,
    areas from 25 to 1089 and likenesses from 0.8 to 0.95, right to a third. What else is
    asked of a place leaves a third of these false alarms.
    """
    at_ten_percent = 0.24 * (np.maximum(area, 1) / 1089) ** 0.56 * (5 / side) ** 2.5
    unlike = 0.1 * (-np.log(1 - false_alarms) / at_ten_percent) ** 0.4
    least: Numbers = np.maximum(1 - unlike, 0.5)
    return least


@dataclass(frozen=True, eq=False)
class Places:
    """The two likeliest places of each of n patches, the likelier first.

    Parameters
    ----------
    position
        `(n, 2, 2)` whole px: patch, place, column and row.
    likeness
        `(n, 2)` normalised correlation; -1 where there is no such place.
    area
        `(n,)` px^2 that were looked at.
    """

    position: Numbers
    likeness: Numbers
    area: Numbers


def likeliest_places(
    grey: Grey, patches: Pixels, mean: Numbers, covariance: Numbers, farthest: float
) -> Places:
    """Look for patches `(n, side, side)` around `mean (n, 2)` px, known to `covariance (n, 2, 2)` px^2.

    No farther than `farthest` px, and only where the whole patch is in the picture.
    """
    count, side = len(patches), patches.shape[1]
    position, likeness, area = np.zeros((count, 2, 2)), np.full((count, 2), -1.0), np.zeros(count)
    flat = patches.reshape(count, side * side)
    centred = flat - flat.mean(axis=1, keepdims=True)
    length = np.sqrt(np.square(centred).sum(axis=1, keepdims=True))
    templates = (centred / np.maximum(length, 1e-6)).astype(np.float32)
    wide = covariance + GRID**2 * np.eye(2)
    deviation = np.sqrt(wide[:, [0, 1], [0, 1]].max(axis=1))
    radius = np.minimum(np.ceil(REACH * deviation + 0.5), farthest).astype(np.int64)
    if count:
        best_places(
            grey, np.ascontiguousarray(mean), np.linalg.inv(wide), radius, templates, side, REACH, SHARPNESS,
            LIKENESS_NOISE, position, likeness, area,
        )  # fmt: skip
    return Places(position, likeness, area)


@dataclass(frozen=True, eq=False)
class Found:
    """Which of the points that were looked for were found, and where.

    Parameters
    ----------
    seen
        `(n,)` bool.
    position, covariance
        `(n, 2)` px and `(n, 2, 2)` px^2, of those that were seen.
    """

    seen: Mask
    position: Numbers
    covariance: Numbers


def find_points(
    grey: Grey, patches: Pixels, mean: Numbers, covariance: Numbers, false_alarms: float, farthest: float
) -> Found:
    """Look for points in a picture.

    Parameters
    ----------
    grey
        `(height, width)`.
    patches
        `(n, side, side)` grey values.
    mean, covariance
        `(n, 2)` px and `(n, 2, 2)` px^2: where they should be.
    false_alarms
        share of windows without the point in which something is as like it as is asked for.
    farthest
        px from the mean beyond which nothing is looked for.
    """
    places = likeliest_places(grey, patches, mean, covariance, farthest)
    way = align_patches(grey, patches, places.position[:, 0], NEAR)
    weight = _weights(way, mean, covariance)
    weight[places.likeness[:, 0] <= 0] = -np.inf
    position, spread, likeness = way.position, way.covariance, way.likeness

    # Fractions of a pixel can make the second place the likelier one.
    second = np.flatnonzero(places.likeness[:, 1] > 0)
    other = align_patches(grey, patches[second], places.position[second, 1], NEAR)
    rival = np.full(len(mean), -np.inf)
    rival[second] = _weights(other, mean[second], covariance[second])
    rival[second[np.abs(other.position - position[second]).max(axis=1) < NEAR]] = -np.inf
    better = rival > weight
    taken = better[second]
    position[better], spread[better] = other.position[taken], other.covariance[taken]
    likeness[better] = other.likeness[taken]

    best, least = np.maximum(weight, rival), np.minimum(weight, rival)
    seen = np.isfinite(best) & (least < best - np.log(ODDS))
    seen &= likeness >= least_likeness(false_alarms, places.area, patches.shape[1])
    seen &= 0.5 * np.trace(spread, axis1=1, axis2=2) <= MOST_SPREAD**2
    return Found(seen, position[seen], spread[seen] + LEAST_SPREAD**2 * np.eye(2))


def _weights(way: Aligned, mean: Numbers, covariance: Numbers) -> Numbers:
    """`(n,)` log of likelihood and prior, up to a constant; -inf where a patch cannot be."""
    off = way.position - mean
    wide = covariance + way.covariance + GRID**2 * np.eye(2)
    square = squared_distances(off, wide)
    weight = -SHARPNESS * np.log(1 - np.clip(way.likeness, 0, 1) ** 2 + LIKENESS_NOISE) - 0.5 * square
    weights: Numbers = np.where((way.likeness > 0) & (square < REACH**2), weight, -np.inf)
    return weights


def leads_back(
    grey: Grey,
    position: Numbers,
    before: Grey,
    origin: Numbers,
    covariance: Numbers,
    side: int,
    farthest: float,
) -> Mask:
    """Whether what is at `position (n, 2)` px was at `origin (n, 2)` px in the picture before.

    It is looked for there in windows as wide as on the way forth, where it was known to
    `covariance (n, 2, 2)` px^2; there is no prior on the way back.
    """
    patches = patch_search.sample_patches(grey, position, side, unit=True)
    back = patch_search.search_patches(
        before, patches, origin, patch_search.reaches_of(covariance, int(farthest))
    )
    led: Mask = (back.score > 0) & (np.abs(back.position - origin).max(axis=1, initial=0) <= NEAR)
    return led

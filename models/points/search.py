"""Points found in a picture by what they look like: where, how surely, and when rather not at all.

A patch of 5x5 pixels is easily found where it is not. Four things are asked of a place:

- It is like the patch. The wider the window, the likelier something in it is so by chance. How likely was
  counted on pairs of nine unrelated pictures, corners of one looked for in the other; see `least_ncc`.
- It has no rival. Where a second place is nearly as like it, the prior decides between them, or nobody does.
- It is no chance find, if the point was not there in the picture before, and may be hidden: what is there by
  chance is one more rival; see `odds_over_chance`.
- It leads back. What is found is searched for in the picture before, in the same way, and is where the point
  was (the forward-backward check of Kalal, Mikolajczyk and Matas 2010).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.mahalanobis import squared_distances
from .alignment import Aligned, align_patches, sample_patches
from .kernels.alignment import Expected
from .kernels.correlation import Candidates, Windows, best_places

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Grey = NDArray[np.uint8]
Pixels = NDArray[np.float32]

REACH = 3.0
"""Standard deviations from where a point should be within which it is searched for."""

GRID = 0.5
"""px, standard deviation added to what is known of a position: places are compared pixel by pixel, and any
hand that holds a camera soon moves it by half a pixel more than expected."""

ODDS = 10.0
"""By which a place must be likelier than its rival."""

NEAR = 1.0
"""px: places that are nearer to each other are one. So far may fractions of a pixel lead, and the way
back."""

WHOLE = 0.5
"""px by which a place is off that is sought pixel by pixel."""

LEAST_SPREAD, MOST_SPREAD = 0.05, 0.7
"""px, standard deviation of a found position: the least there is, and from which on it is as good as not
found."""

SHARPNESS, NCC_NOISE = 3.5, 0.02
"""How -log(1 - correlation^2) grows into a log likelihood, and the noise that limits it."""


UNLIKE = 0.045
"""Mean of 1 - correlation of a point that is seen again after it was hidden, with its patch of before. Of
2900 in a real film the correlation was 0.91, 0.96 and 0.975 in the quartiles."""


def least_ncc(false_alarms: float, area: ArrayLike, side: int) -> Numbers:
    """Normalised correlation that a share of `false_alarms` of windows without the point exceeds by chance.

    The expected number of places that are at least so like a patch of `side` px in `area` px^2 is
    0.24 (area / 1089)^0.56 (5 / side)^2.5 ((1 - ncc) / 0.1)^2.5: a fit to counts for sides from 5 to 11,
    areas from 25 to 1089 and correlations from 0.8 to 0.95, right to a third. What else is
    asked of a place leaves a third of these false alarms.
    """
    unlike = 0.1 * (-np.log(1 - false_alarms) / _at_ten_percent(area, side)) ** 0.4
    least: Numbers = np.maximum(1 - unlike, 0.5)
    return least


def odds_over_chance(ncc: Numbers, square: Numbers, wide: Numbers, area: Numbers, side: int) -> Numbers:
    """Log odds, `(n,)`, that a place shows the point, as against another one that is as like it by chance.

    Of the point, 1 - ncc is exponential with mean `UNLIKE`, and the place is normal about where it should
    be. Of what is there by chance 1 - ncc has the density of `least_ncc`'s count, and the place is any in the
    window.

    Parameters
    ----------
    ncc
        `(n,)` of the likeliest place.
    square
        `(n,)` its squared distance from where the point should be, in units of `wide`.
    wide
        `(n, 2, 2)` px^2, covariance of that distance.
    area
        `(n,)` px^2 that were searched.
    side
        px, of the patches.
    """
    unlike = np.clip(1 - ncc, 1e-3, 1.0)
    by_chance = 2.5 / unlike * _at_ten_percent(area, side) * (unlike / 0.1) ** 2.5
    log_density = -0.5 * square - 0.5 * np.log(np.linalg.det(wide)) - np.log(2 * np.pi)
    odds: Numbers = -unlike / UNLIKE - np.log(UNLIKE * by_chance) + log_density + np.log(np.maximum(area, 1))
    return odds


def _at_ten_percent(area: ArrayLike, side: int) -> Numbers:
    expected: Numbers = 0.24 * (np.maximum(area, 1) / 1089) ** 0.56 * (5 / side) ** 2.5
    return expected


def likeliest_places(
    grey: Grey, patches: Pixels, mean: Numbers, covariance: Numbers, farthest: float, *, prior: bool = True
) -> Candidates:
    """Search for patches `(n, side, side)` around `mean (n, 2)` px, known to `covariance (n, 2, 2)` px^2.

    No farther than `farthest` px, and only where the whole patch is in the picture. Without the `prior` all
    places of the window count alike.
    """
    count, side = len(patches), patches.shape[1]
    found = Candidates(np.zeros((count, 2, 2)), np.full((count, 2), -1.0), np.zeros(count))
    flat = patches.reshape(count, side * side)
    centred = flat - flat.mean(axis=1, keepdims=True)
    length = np.sqrt(np.square(centred).sum(axis=1, keepdims=True))
    templates = (centred / np.maximum(length, 1e-6)).astype(np.float32)
    wide = covariance + GRID**2 * np.eye(2)
    deviation = np.sqrt(wide[:, [0, 1], [0, 1]].max(axis=1))
    radius = np.minimum(np.ceil(REACH * deviation + 0.5), farthest).astype(np.int64)
    precision = np.asarray(np.linalg.inv(wide) if prior else np.zeros_like(wide), np.float64)
    if count:
        windows = Windows(np.ascontiguousarray(mean), precision, radius)
        best_places(grey, windows, templates, side, REACH, SHARPNESS, NCC_NOISE, found)
    return found


@dataclass(frozen=True, eq=False)
class Found:
    """Which of the points that were searched for were found, and where.

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
    grey: Grey,
    patches: Pixels,
    mean: Numbers,
    covariance: Numbers,
    false_alarms: float,
    farthest: float,
    lost: Mask | None = None,
) -> Found:
    """Search for points in a picture.

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
        px from the mean beyond which nothing is searched.
    lost
        `(n,)`: points that the picture before did not show, and that may be hidden. For these, that something
        is as like them by chance counts as one more rival. None if not given.
    """
    places = likeliest_places(grey, patches, mean, covariance, farthest)
    wide = np.linalg.inv(covariance + GRID**2 * np.eye(2))
    way = align_patches(grey, patches, places.position[:, 0], NEAR, Expected(mean, wide))
    weight = _weights(way, mean, covariance)
    weight[places.ncc[:, 0] <= 0] = -np.inf
    position, spread, ncc = way.position, way.covariance, way.ncc

    # Fractions of a pixel can make the second place the likelier one.
    second = np.flatnonzero(places.ncc[:, 1] > 0)
    there = Expected(mean[second], wide[second])
    other = align_patches(grey, patches[second], places.position[second, 1], NEAR, there)
    rival = np.full(len(mean), -np.inf)
    rival[second] = _weights(other, mean[second], covariance[second])
    rival[second[np.abs(other.position - position[second]).max(axis=1) < NEAR]] = -np.inf
    better = rival > weight
    taken = better[second]
    position[better], spread[better] = other.position[taken], other.covariance[taken]
    ncc[better] = other.ncc[taken]

    best, least = np.maximum(weight, rival), np.minimum(weight, rival)
    seen = np.isfinite(best) & (least < best - np.log(ODDS))
    seen &= ncc >= least_ncc(false_alarms, places.area, patches.shape[1])
    seen &= 0.5 * np.trace(spread, axis1=1, axis2=2) <= MOST_SPREAD**2
    if lost is not None and lost.any():
        where = covariance[lost] + spread[lost] + GRID**2 * np.eye(2)
        square = squared_distances(position[lost] - mean[lost], where)
        odds = odds_over_chance(ncc[lost], square, where, places.area[lost], patches.shape[1])
        seen[lost] &= odds > np.log(ODDS)
    return Found(seen, position[seen], spread[seen] + LEAST_SPREAD**2 * np.eye(2))


def _weights(way: Aligned, mean: Numbers, covariance: Numbers) -> Numbers:
    """`(n,)` log of likelihood and prior, up to a constant; -inf where a patch cannot be."""
    off = way.position - mean
    wide = covariance + way.covariance + GRID**2 * np.eye(2)
    square = squared_distances(off, wide)
    weight = -SHARPNESS * np.log(1 - np.clip(way.ncc, 0, 1) ** 2 + NCC_NOISE) - 0.5 * square
    weights: Numbers = np.where((way.ncc > 0) & (square < REACH**2), weight, -np.inf)
    return weights


def forward_backward_check(
    grey: Grey,
    position: Numbers,
    before: Grey,
    origin: Numbers,
    covariance: Numbers,
    side: int,
    farthest: float,
) -> Mask:
    """Whether what is at `position (n, 2)` px was at `origin (n, 2)` px in the picture before.

    It is searched for there in windows as wide as on the way forth, where it was known to
    `covariance (n, 2, 2)` px^2; there is no prior on the way back.
    """
    patches = sample_patches(grey, position, side)
    places = likeliest_places(before, patches, origin, covariance, farthest, prior=False)
    off = np.abs(places.position[:, 0] - origin).max(axis=1, initial=0)
    back: Mask = (places.ncc[:, 0] > 0) & (off <= NEAR + WHOLE)
    return back

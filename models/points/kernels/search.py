"""Which places are the points that are searched for, and which are rather not."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled
from .correlation import LEAST_NCC, LEAST_WEIGHT, NCC_NOISE, SHARPNESS

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH = 3.0
"""Standard deviations from where a point should be within which it is searched for."""

GRID = 0.5
"""px, standard deviation added to what is known of a position: places are compared pixel by pixel, and any
hand that holds a camera soon moves it by half a pixel more than expected."""

ODDS = 10.0
"""By which a place must be likelier than its rival."""

DOUBT = 1.0
"""By which the log weight of a place may be off before it is known to fractions of a pixel."""

NEAR = 1.0
"""px: places that are nearer to each other are one. So far may fractions of a pixel lead, and the way
back."""

WHOLE = 0.5
"""px by which a place is off that is sought pixel by pixel."""

MOST_SPREAD = 0.7
"""px, standard deviation of a found position from which on it is as good as not found. Of a lost point it is
that given what is expected of it, too."""

UNLIKE = 0.045
"""Mean of 1 - correlation of a point that is seen again after it was hidden, with its patch of before. Of
2900 in a real film the correlation was 0.91, 0.96 and 0.975 in the quartiles."""


class Asked(NamedTuple):
    """What is asked of n points.

    Parameters
    ----------
    mean, around, precision
        `(n, 2)` px, `(n, 2, 2)` px^2 and its inverse: where they should be.
    hidden
        `(n,)` bool: those that may be hidden, of which what is there by chance is one more rival.
    false_alarms
        share of windows without the point in which something is as like it as is asked for.
    farthest
        px from the mean beyond which nothing is searched.
    side
        px, of the patches.
    """

    mean: Numbers
    around: Numbers
    precision: Numbers
    hidden: Mask
    false_alarms: float
    farthest: float
    side: int


class Places(NamedTuple):
    """Two places each for n patches.

    Parameters
    ----------
    position, covariance
        `(n, 2, 2)` px: patch, place, x and y; and `(n, 2, 2, 2)` px^2.
    ncc
        `(n, 2)` normalised correlation there, -1 where there is no such place.
    """

    position: Numbers
    covariance: Numbers
    ncc: Numbers


@compiled
def decide(places, asked, better, seen):
    """Say of n points in `better`, `(n,)`, which of two places is the likelier one, and if `seen` there.

    To fractions of a pixel that can be another one than pixel by pixel.
    """
    position, covariance, nccs = places
    mean, around, precision, hidden, false_alarms, farthest, side = asked
    log_odds = np.log(ODDS)
    for k in range(seen.size):
        a, b, c = around[k, 0, 0], around[k, 0, 1], around[k, 1, 1]
        best, rival, best_square = LEAST_WEIGHT, LEAST_WEIGHT, 0.0
        for place in range(2):
            dx, dy = position[k, place, 0] - mean[k, 0], position[k, place, 1] - mean[k, 1]
            xx, xy = a + covariance[k, place, 0, 0], b + covariance[k, place, 0, 1]
            yy = c + covariance[k, place, 1, 1]
            square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
            weight = LEAST_WEIGHT
            if nccs[k, place] > 0 and square < REACH**2:
                weight = -SHARPNESS * np.log(1 - min(nccs[k, place], 1.0) ** 2 + NCC_NOISE) - 0.5 * square
            apart_x, apart_y = (
                abs(position[k, 1, 0] - position[k, 0, 0]),
                abs(position[k, 1, 1] - position[k, 0, 1]),
            )
            if place == 1 and max(apart_x, apart_y) < NEAR:
                continue
            if weight > best:
                best, rival, best_square, better[k] = weight, best, square, place
            else:
                rival = weight
        place = better[k]
        ncc = nccs[k, place]
        xx, xy, yy = covariance[k, place, 0, 0], covariance[k, place, 0, 1], covariance[k, place, 1, 1]
        area = min(np.pi * REACH**2 * np.sqrt(a * c - b * b), (2 * farthest + 1) ** 2)
        seen[k] = best - rival > log_odds and ncc >= least_ncc(false_alarms, area, side)
        if not seen[k]:
            continue
        if not hidden[k]:
            seen[k] = 0.5 * (xx + yy) <= MOST_SPREAD**2
            continue
        # where a hidden point is along an edge, only what is expected can say
        scale = 1 / (xx * yy - xy * xy)
        p, r = scale * yy + precision[k, 0, 0], scale * xx + precision[k, 1, 1]
        q = precision[k, 0, 1] - scale * xy
        determinant = (a + xx) * (c + yy) - (b + xy) ** 2
        odds = odds_over_chance(ncc, best_square, determinant, area, side)
        seen[k] = 0.5 * (p + r) / (p * r - q * q) <= MOST_SPREAD**2 and odds > log_odds


@compiled
def least_ncc(false_alarms, area, side):
    """Normalised correlation that a share of `false_alarms` of windows without the point exceeds by chance.

    The expected number of places that are at least so like a patch of `side` px in `area` px^2 is
    0.24 (area / 1089)^0.56 (5 / side)^2.5 ((1 - ncc) / 0.1)^2.5: a fit to counts for sides from 5 to 11,
    areas from 25 to 1089 and correlations from 0.8 to 0.95, right to a third. What else is
    asked of a place leaves a third of these false alarms.
    """
    unlike = 0.1 * (-np.log(1 - false_alarms) / _at_ten_percent(area, side)) ** 0.4
    return max(1 - unlike, LEAST_NCC)


@compiled
def odds_over_chance(ncc, square, determinant, area, side):
    """Log odds that a place shows the point, as against another one that is as like it by chance.

    Of the point, 1 - ncc is exponential with mean `UNLIKE`, and the place is normal about where it should
    be. Of what is there by chance 1 - ncc has the density of `least_ncc`'s count, and the place is any in the
    window.

    Parameters
    ----------
    ncc
        of the likeliest place.
    square
        its squared distance from where the point should be, in units of the covariance of that.
    determinant
        px^4, of that covariance.
    area
        px^2 that were searched.
    side
        px, of the patch.
    """
    unlike = min(max(1 - ncc, 1e-3), 1.0)
    by_chance = 2.5 / unlike * _at_ten_percent(area, side) * (unlike / 0.1) ** 2.5
    log_density = -0.5 * square - 0.5 * np.log(determinant) - np.log(2 * np.pi)
    return -unlike / UNLIKE - np.log(UNLIKE * by_chance) + log_density + np.log(max(area, 1.0))


@compiled
def _at_ten_percent(area, side):
    return 0.24 * (max(area, 1.0) / 1089) ** 0.56 * (5 / side) ** 2.5

"""Points found in a picture by what they look like: where, how surely, and when rather not at all.

A patch of 5x5 pixels is easily found where it is not. Four things are asked of a place:

- It is like the patch. The wider the window, the likelier something in it is so by chance. How likely was
  counted on pairs of nine unrelated pictures, corners of one looked for in the other; see `least_ncc` of
  `kernels.search`.
- It has no rival. Where a second place is nearly as like it, the prior decides between them, or nobody does.
- It is no chance find, if the point was not there in the picture before, and may be hidden: what is there by
  chance is one more rival; see `odds_over_chance` there.
- It leads back. What is found is searched for in the picture before, in the same way, and is where the point
  was (the forward-backward check of Kalal, Mikolajczyk and Matas 2010).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kernels.alignment import Expected, align_all, sample_all
from .kernels.search import (
    DOUBT,
    GRID,
    LEAST_WEIGHT,
    NEAR,
    ODDS,
    REACH,
    WHOLE,
    Candidates,
    Places,
    Windows,
    best_places,
    decide,
)
from .patches import LIGHT

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Grey = NDArray[np.uint8]
Pixels = NDArray[np.float32]

LEAST_SPREAD = 0.05
"""px, standard deviation of a found position: the least there is."""


@dataclass(frozen=True, eq=False)
class Before:
    """Where the picture before showed points that are searched for.

    Parameters
    ----------
    grey
        `(height, width)`.
    shown
        `(n,)` bool: which ones it showed.
    position
        `(n, 2)` px, of those.
    """

    grey: Grey
    shown: Mask
    position: Numbers


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
    before: Before | None = None,
) -> Found:
    """Search for points in a picture, and from there back in the one before.

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
    before
        the picture before. A point that it showed has to lead back there, any other one may be hidden: what
        is there by chance is one more rival of it. Without it neither is asked.
    """
    count, side = patches.shape[:2]
    mean, around = np.ascontiguousarray(mean), covariance + GRID**2 * np.eye(2)
    precision = _inverses(around)
    places = likeliest_places(grey, patches, Windows(mean, around, True, REACH, farthest), np.arange(count))
    aligned = _aligned(grey, patches, places, Expected(mean, precision))
    hidden = np.zeros(count, np.bool_) if before is None else ~before.shown
    better, seen = np.zeros(count, np.int64), np.empty(count, np.bool_)
    decide(aligned, mean, around, precision, hidden, false_alarms, farthest, side, better, seen)
    position, spread = (both[np.arange(count), better] for both in aligned[:2])
    if before is not None:
        again = np.flatnonzero(seen & before.shown)
        windows = Windows(before.position, around, False, REACH, farthest)
        seen[again] = leads_back(grey, position, before.grey, windows, again, side)
    return Found(seen, position[seen], spread[seen] + LEAST_SPREAD**2 * np.eye(2))


def leads_back(
    grey: Grey, position: Numbers, before: Grey, windows: Windows, which: NDArray[np.int64], side: int
) -> Mask:
    """Whether what is at `position (n, 2)` px was in the middle of its window in the picture before.

    It is searched for there in windows as wide as on the way forth, without a prior. Only those are asked
    for, and answered, whose numbers are in `which`.
    """
    patches = np.empty((len(position), side, side), np.float32)
    sample_all(grey, position, which, patches)
    places = likeliest_places(before, patches, windows, which)
    off = np.abs(places.position[which, 0] - windows.mean[which]).max(axis=1, initial=0)
    back: Mask = (places.ncc[which, 0] > 0) & (off <= NEAR + WHOLE)
    return back


def likeliest_places(grey: Grey, patches: Pixels, windows: Windows, which: NDArray[np.int64]) -> Candidates:
    """Search for those of `patches (n, side, side)` whose numbers are in `which`; all of a patch is seen."""
    count = len(patches)
    found = Candidates(np.zeros((count, 2, 2)), np.full((count, 2), -1.0), np.full((count, 2), LEAST_WEIGHT))
    best_places(grey, windows, patches, which, found)
    return found


def _aligned(grey: Grey, patches: Pixels, places: Candidates, expected: Expected) -> Places:
    """To fractions of a pixel: the likelier place, and the other one where that might become the likelier."""
    close = places.ncc > 0
    close[:, 1] &= places.weight[:, 1] > places.weight[:, 0] - np.log(ODDS) - DOUBT
    position = places.position.copy()
    covariance, ncc = np.zeros((*position.shape, 2)), np.full(close.shape, -1.0)
    lines = position.reshape(-1, 2), covariance.reshape(-1, 2, 2), ncc.reshape(-1)
    align_all(grey, patches, np.flatnonzero(close), lines[0], expected, LIGHT, NEAR, *lines[1:])
    return Places(position, covariance, ncc)


def _inverses(matrices: Numbers) -> Numbers:
    """`(n, 2, 2)`, symmetric; three times as fast as the general way."""
    turned = matrices[:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    determinants = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
    inverses: Numbers = turned / determinants[:, None, None]
    return inverses

"""Damped least squares: the loop of Levenberg and Marquardt, for problems that bring their steps along.

A step solves normal equations with something added to their diagonal: much where the last step did harm,
little where it did good. Problems differ in how a step is solved (by conjugate gradients, with points
eliminated, on rotations); the loop has the damping, what is taken and what is refused, and the end.

Measured against `scipy.optimize.least_squares` (one core): joint least squares of cameras and points with a
sparse Jacobian takes 3 to 46 times as long as a solve by variable projection and stays above its error (`make
bench`); the rotations of a deforming shape, small and dense, take it 4.4 ms (`lm`) and 8.3 ms (`trf`) instead
of 2.9 ms, and it ends higher from one start in ten. It serves where parameters have bounds (`sfm.parallax`).

Three loops are their own. Landmarks are fitted in 256 frames at once, each with a damping of its own: one by
one they take 11 times as long. The poses of a deforming shape take one step of that kind in each iteration of
EM. The experts on a face climb in compiled threads, which cannot call back into Python.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

Place = TypeVar("Place")


@dataclass(frozen=True)
class Damping:
    """How much is added to the diagonal of the normal equations, as a share of it.

    Parameters
    ----------
    first
        of the first step.
    fall, rise
        factors by which it falls after a step that was taken, and rises after one that was refused.
    least, most
        it falls no further than `least`; from `most` on a step is as good as none, and no more are tried.
    """

    first: float = 1e-3
    fall: float = 10.0
    rise: float = 10.0
    least: float = 0.0
    most: float = 1e10


@dataclass(frozen=True, eq=False)
class Minimum(Generic[Place]):
    """Where the loop has ended.

    Parameters
    ----------
    place
        the best one.
    damping
        of the step that would have been next.
    steps
        that were tried.
    """

    place: Place
    damping: float
    steps: int


def levenberg_marquardt(
    start: Place,
    linearised: Callable[[Place], Callable[[float], Place | None]],
    settled: Callable[[Place, Place], bool],
    damping: Damping,
    *,
    most_steps: int,
    patience: int = 1,
) -> Minimum[Place]:
    """Lower an error step by step, as far as it goes.

    Parameters
    ----------
    start
        anything that says where the loop is, with all that the problem wants to know again there.
    linearised
        the problem: it makes the normal equations of a place, and gives the step from there. That is called
        with a damping, and gives the place that is reached; `None` if the error is not lower there; and the
        place itself if no step is worth while.
    settled
        whether a step, from one place to another, has hardly lowered the error.
    damping
        how it begins, and how it changes.
    most_steps
        to be tried.
    patience
        settled steps in a row with which the loop ends: one may be short because it was damped.
    """
    place, added, step, still, tried = start, damping.first, None, 0, 0
    while tried < most_steps and added < damping.most:
        step = step or linearised(place)
        tried += 1
        reached = step(added)
        if reached is place:
            break
        if reached is None:
            added *= damping.rise
            continue
        added = max(added / damping.fall, damping.least)
        still = still + 1 if settled(place, reached) else 0
        place, step = reached, None
        if still == patience:
            break
    return Minimum(place, added, tried)

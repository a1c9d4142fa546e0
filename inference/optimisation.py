"""Iterations to an optimum: Levenberg and Marquardt's loop, and Anderson's acceleration of any other.

Problems bring their step along (by conjugate gradients, with points eliminated, on rotations); the loop has
the damping, what is taken and what is refused, and the end. `scipy.optimize.least_squares` is no substitute:
on cameras and points with a sparse Jacobian it takes 3 to 46 times as long as variable projection and ends
above its error, on the rotations of a deforming shape 1.5 times. It serves where parameters have bounds
(`sfm.depth`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

Place = TypeVar("Place")


@dataclass(frozen=True)
class Damping:
    """Damping of the normal equations: what is added to their diagonal, as a share of it.

    It falls by a factor after a step that was taken, to `least`, and rises after one that was refused; from
    `most` on no more are tried.
    """

    first: float = 1e-3
    fall: float = 10.0
    rise: float = 10.0
    least: float = 0.0
    most: float = 1e10


def levenberg_marquardt(
    start: Place,
    linearised: Callable[[Place], Callable[[float], Place | None]],
    settled: Callable[[Place, Place], bool],
    damping: Damping,
    *,
    most_steps: int,
    settled_steps: int = 1,
) -> tuple[Place, float]:
    """Minimise an error step by step; return the best place, and the damping of the next step.

    Parameters
    ----------
    linearised
        the problem: it makes the normal equations of a place, and gives the step from there. That is called
        with a damping, and gives the place that is reached; `None` if the error is not lower there; and the
        place itself if no step is worth while.
    settled
        whether a step, from one place to another, has hardly lowered the error.
    settled_steps
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
        if still == settled_steps:
            break
    return place, added


RIDGE = 1e-10
MEMORY = 8  # steps that are kept


class Anderson:
    """Anderson acceleration of x <- g(x): extrapolation to where g(x) - x vanishes, from the last steps."""

    def __init__(self) -> None:
        self._places: list[Numbers] = []
        self._steps: list[Numbers] = []

    def propose(self, place: Numbers, image: Numbers) -> Numbers:
        """Return the next place, after `image` = g(`place`); the image itself the first time."""
        self._places.append(place.reshape(-1).copy())
        self._steps.append((image - place).reshape(-1))
        del self._places[: -MEMORY - 1], self._steps[: -MEMORY - 1]
        if len(self._steps) == 1:
            return image
        moves, changes = np.diff(self._places, axis=0), np.diff(self._steps, axis=0)
        gram = changes @ changes.T
        gram[np.diag_indices_from(gram)] *= 1 + RIDGE
        try:
            share = np.linalg.solve(gram, changes @ self._steps[-1])
        except np.linalg.LinAlgError:  # a step of exactly nothing
            return image
        return image - (share @ (moves + changes)).reshape(image.shape)

    def forget(self) -> None:
        """Forget all steps, after a proposal that was refused."""
        del self._places[:-1], self._steps[:-1]

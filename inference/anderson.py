"""Faster ways to where an iteration stands still."""

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

RIDGE = 1e-10


class Anderson:
    """Anderson acceleration of x <- g(x): the combination of the last steps at which g(x) - x would vanish.

    EM creeps along directions that the data hardly determine, always the same ones; a few steps show how.

    Parameters
    ----------
    memory
        steps that are kept.
    """

    def __init__(self, memory: int = 8) -> None:
        self._memory = memory
        self._places: list[Numbers] = []
        self._steps: list[Numbers] = []

    def propose(self, place: Numbers, image: Numbers) -> Numbers:
        """Where to go on, after `image` = g(`place`); the image itself the first time."""
        self._places.append(place.reshape(-1).copy())
        self._steps.append((image - place).reshape(-1))
        del self._places[: -self._memory - 1], self._steps[: -self._memory - 1]
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
        """Begin anew, after a proposal that proved to be none."""
        del self._places[:-1], self._steps[:-1]

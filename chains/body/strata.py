"""Strata of poses, so that resampling keeps what is improbable now and may turn out to be right.

Poses whose hands are in about the same places are a stratum. Each keeps its weight, but has a share of the
samples that does not follow it: a mode of one in a thousand goes on to be followed, with all that speaks for
it added up from frame to frame (Vermaak, Doucet and Perez, "Maintaining multi-modality through mixture
tracking", 2003).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import normalised
from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from .kernels.strata import cut

Array = NDArray[np.float64]

MOST_STRATA = 12

NARROW = 0.3
"""Head heights: standard deviation of hands within which poses say the same."""

EVENLY = 0.5
"""Share of the samples that is divided evenly among strata."""

LEAST_MASS = 1e-9
"""Of a stratum's weight: less is forgotten."""

ROUNDS = 4
"""Of finding the middle between two halves."""


@dataclass(frozen=True, eq=False)
class Strata:
    """Numbers of strata, `(n,)`, from 0."""

    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, body: UpperBody, poses: BodyPoses) -> "Strata":
        """The widest stratum is cut in two, again and again, across the axis along which it is widest: of
        the places of both hands in the picture."""
        points = body.parts(poses)[:, 1:].reshape(len(poses), 4) / body.head_height
        numbers = np.empty(len(points), np.int64)
        cut(points, NARROW**2, MOST_STRATA, ROUNDS, numbers)
        return cls(numbers)

    def balanced(self, log_weights: Array) -> Array:
        """Log probabilities `(n,)` by which samples with `log_weights` are to be drawn.

        Half of the draws go by weight, the others evenly to all strata.
        """
        shares = np.bincount(self.numbers, np.exp(normalised(log_weights)))
        alive = shares > LEAST_MASS
        wanted = np.where(alive, (1 - EVENLY) * shares + EVENLY / alive.sum(), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            boost = np.where(alive, np.log(wanted / shares), -np.inf)
        return normalised(log_weights + boost[self.numbers])

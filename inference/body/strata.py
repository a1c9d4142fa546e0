"""Strata of poses, so that resampling keeps what is improbable now and may turn out to be right.

Poses whose hands are in about the same places are a stratum. Each keeps its weight, but has a share of the
samples that does not follow it: a mode of one in a thousand goes on to be followed, with all that speaks for
it added up from frame to frame (Vermaak, Doucet and Perez, "Maintaining multi-modality through mixture
tracking", 2003).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.body.poses import BodyPoses
from ...models.body.upper_body import UpperBody
from ..filters.resampling import log_sum, normalised

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
        numbers = np.zeros(len(points), np.int64)
        members = [np.arange(len(points))]
        variances = [_variances(points)]
        while len(members) < MOST_STRATA:
            widest = int(np.argmax([each.max() for each in variances]))
            axis = int(variances[widest].argmax())
            if variances[widest][axis] < NARROW**2:
                break
            rows = members[widest]
            values = points[rows, axis]
            upper = values > _between(values)
            members[widest] = rows[~upper]
            members.append(rows[upper])
            numbers[rows[upper]] = len(members) - 1
            variances[widest] = _variances(points[members[widest]])
            variances.append(_variances(points[members[-1]]))
        return cls(numbers)

    def balanced(self, log_weights: Array) -> Array:
        """Log probabilities `(n,)` by which samples with `log_weights` are to be drawn.

        Half of the draws go by weight, the others evenly to all strata.
        """
        masses = np.array(
            [log_sum(log_weights[self.numbers == each]) for each in range(self.numbers.max() + 1)]
        )
        shares = np.exp(normalised(masses))
        alive = shares > LEAST_MASS
        wanted = np.where(alive, (1 - EVENLY) * shares + EVENLY / alive.sum(), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            boost = np.where(alive, np.log(wanted) - masses, -np.inf)
        return normalised(log_weights + boost[self.numbers])


def _variances(points: Array) -> Array:
    return np.asarray(points.var(axis=0)) if len(points) > 1 else np.zeros(points.shape[1])


def _between(values: Array) -> float:
    """A value between two halves, each of which is nearer to its own mean."""
    middle = float(values.mean())
    for _ in range(ROUNDS):
        upper = values > middle
        middle = 0.5 * float(values[upper].mean() + values[~upper].mean())
    return middle

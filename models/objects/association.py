"""Which detection belongs to which object: marginals over all ways to pair them, one to one."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Numbers = NDArray[np.float64]

MOST_ROUNDS = 50
TOLERANCE = 1e-6
"""Belief propagation for assignments ends when no message changes by more."""


class Marginals(NamedTuple):
    """Probabilities of pairs.

    `pairs` `(n_objects, n_boxes)`, `missed` `(n_objects,)`, `alone` `(n_boxes,)`; `open` `(n_objects,
    n_boxes)` is how far a box is free for an object given all others (1: nobody else wants it), and
    `log_sum` the log of the sum over all assignments, by Bethe's approximation.
    """

    pairs: Numbers
    missed: Numbers
    alone: Numbers
    open: Numbers
    log_sum: float


def assignment_marginals(weights: Numbers, missed: Numbers) -> Marginals:
    """Marginals of p(assignment) ~ product of the weights of its pairs and of what is missed.

    J. Williams, R. Lau, *Approximate evaluation of marginal association probabilities with belief
    propagation* (2014), eq. 29-33; exact where the pairs that are possible form no loop.

    Parameters
    ----------
    weights
        `(n_objects, n_boxes)`, 0 or more: of an object with a box, over the box alone.
    missed
        `(n_objects,)`, 0 or more: of an object without a box.
    """
    free = np.ones_like(weights)
    claimed = np.zeros_like(weights)
    for _ in range(MOST_ROUNDS):
        wanted = weights * free
        rest = missed[:, None] + wanted.sum(axis=1, keepdims=True) - wanted
        claimed = weights / np.maximum(rest, 1e-300)
        before, free = free, 1 / (1 + claimed.sum(axis=0) - claimed)
        if np.abs(free - before).max(initial=0.0) < TOLERANCE:
            break
    wanted = weights * free
    whole = missed + wanted.sum(axis=1)
    asked = 1 + claimed.sum(axis=0)
    log_sum = np.log(whole).sum() + np.log(asked).sum() - np.log1p(claimed * free).sum()
    return Marginals(wanted / whole[:, None], missed / whole, 1 / asked, free, float(log_sum))


@short_repr
@dataclass(frozen=True, eq=False)
class Association:
    """What the boxes of a frame are, given the objects that are known.

    Parameters
    ----------
    boxes
        `(n_boxes, 4)` px that the detector has found: foot x, foot y, width, height.
    noise
        `(n_boxes, 4)` px^2: their variances.
    scores
        `(n_boxes,)` of the detector, all 1 where it gives none.
    identities
        `(n_objects,)` int64: who was expected.
    pairs
        `(n_objects, n_boxes)` probability that the object exists and this is its box.
    expected
        `(n_objects,)` probability with which the object, if it exists, would be found.
    missed
        `(n_objects,)` probability that the object exists and has no box.
    visible
        `(n_objects,)` share of each that is in sight.
    new
        `(n_boxes,)` probability that the box is of somebody not known before.
    double
        `(n_boxes,)` probability that the box is a second one of somebody who has another.
    log_evidence
        log density of all boxes together, given who was expected.
    """

    boxes: Numbers
    noise: Numbers
    scores: Numbers
    identities: NDArray[np.int64]
    pairs: Numbers
    expected: Numbers
    missed: Numbers
    visible: Numbers
    new: Numbers
    double: Numbers
    log_evidence: float

    def __len__(self) -> int:
        return len(self.boxes)

    @cached_property
    def drawn(self) -> tuple[Numbers, Numbers]:
        """Where the boxes draw each object: `(n_objects, 4)` 1/px^2 and, times it, px; 0 if it was missed.

        That is the mean of the likelihood's logarithm over all assignments.
        """
        exists = np.maximum(self.pairs.sum(axis=1) + self.missed, 1e-30)
        share = self.pairs / exists[:, None]
        return share @ (1 / self.noise), share @ (self.boxes / self.noise)

    @property
    def in_sight(self) -> float:
        """How many objects were missed though they could be seen."""
        return float((self.missed * self.visible).sum())

    @property
    def true(self) -> Numbers:
        """`(n_boxes,)` probability that a box is the one box of an object, known or new."""
        true: Numbers = self.pairs.sum(axis=0) + self.new
        return true

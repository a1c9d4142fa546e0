"""Which thing in the picture each part of a body is: the best assignment, and how sure it is."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import logsumexp

from ...models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures
from .part_filter import PartPosterior

Array = NDArray[np.float64]
Labels = NDArray[np.int64]

MOST_NATS = 500.0
"""By so much the best and the worst choice of a part differ at most: costs must be finite."""


@dataclass(frozen=True, eq=False)
class PartChoices:
    """How well each part fits each thing, none of them, or a place where another part hides it.

    A thing is only one part's image; another part there adds nothing that could be seen. So a part that is
    hidden by the one that is seen is as probable as it was to be there, without what the thing would add.

    Parameters
    ----------
    labels
        `(n,)` int64, increasing, `NO_LABEL` first: what a part may be.
    log_masses
        `(n_parts, n)` log of the probability of all that is known of the part if it is that, up to a constant
        of the part; at most `MOST_NATS` below the part's largest.
    hidden
        `(n_parts, n)` the same if it is where that thing is, and another part is the thing; minus infinity
        for `NO_LABEL`.
    """

    labels: Labels
    log_masses: Array
    hidden: Array

    @classmethod
    def of(cls, posterior: PartPosterior, detections: GaussianMixtures, radius: float, hiding: float) -> Self:
        """Sums over the components with the same label.

        Parameters
        ----------
        posterior
            of the parts,
        detections
            after these.
        radius
            px: a part whose centre is about so close to a thing's is hidden there.
        hiding
            nats by which a part is more probably not seen where it is hidden.
        """
        present = np.unique(np.append(posterior.labels[np.isfinite(posterior.log_weights)], NO_LABEL))
        same = posterior.labels[:, None] == present[:, None]
        masses = logsumexp(np.where(same, posterior.log_weights[:, None], -np.inf), axis=2)
        best = masses.max(axis=1, keepdims=True)
        best = np.where(np.isfinite(best), best, 0.0)  # nothing is known of the part: all is alike
        masses = np.maximum(masses, best - MOST_NATS)

        thing = (detections.labels == present[1:, None, None]) & np.isfinite(detections.log_weights)
        centres = (thing[..., None] * detections.means).sum(axis=(1, 2)) / thing.sum(axis=(1, 2))[:, None]
        unseen = np.where(posterior.labels == NO_LABEL, posterior.log_weights, -np.inf)
        within = posterior.log_within(centres, radius) + unseen[:, None]
        hidden = np.full(masses.shape, -np.inf)
        hidden[:, 1:] = logsumexp(within, axis=2) + hiding
        return cls(present, masses, hidden)

    def best(self) -> "Assignment":
        """The most probable assignment: each thing is one part, and hides any number of others.

        Where somebody would best be hidden by a thing that is nobody, it is a good one, not always the best.
        """
        masses, n_parts = self.log_masses, len(self.log_masses)
        behind = self.hidden.argmax(axis=1)
        not_seen = np.maximum(masses[:, 0], self.hidden.max(axis=1))
        never = np.full((n_parts, n_parts), masses.min() - MOST_NATS)
        never[np.diag_indices(n_parts)] = not_seen
        _, columns = linear_sum_assignment(np.concatenate([masses[:, 1:], never], axis=1), maximize=True)
        places = np.where(columns < masses.shape[1] - 1, columns + 1, 0)
        # A part is hidden by another one, or not at all.
        hides = (places == 0) & (self.hidden.max(axis=1) > masses[:, 0]) & np.isin(behind, places[places > 0])
        return Assignment(self, np.where(hides, behind, places), hides)


@dataclass(frozen=True, eq=False)
class Assignment:
    """What each part is taken for.

    Parameters
    ----------
    choices
        that there were.
    places
        `(n_parts,)` in their labels.
    hidden
        `(n_parts,)` bool: parts that another one hides.
    """

    choices: PartChoices
    places: NDArray[np.intp]
    hidden: NDArray[np.bool_]

    @property
    def labels(self) -> Labels:
        """`(n_parts,)`: what each part is, or what it is hidden by."""
        return self.choices.labels[self.places]

    @property
    def log_masses(self) -> Array:
        """`(n_parts,)` logs of the probability of all that is known of each part."""
        parts = np.arange(len(self.places))
        choices = self.choices
        return np.where(
            self.hidden, choices.hidden[parts, self.places], choices.log_masses[parts, self.places]
        )

    @property
    def shares(self) -> Array:
        """`(n_parts,)`: probability of each part's choice, among what the other parts leave to it."""
        own = (self.places[:, None] == np.arange(len(self.choices.labels))) & ~self.hidden[:, None]
        left = own | ~own.any(axis=0) | (self.choices.labels == NO_LABEL)
        everything = np.where(left, self.choices.log_masses, -np.inf)
        everything = np.column_stack([everything, np.where(self.hidden, self.log_masses, -np.inf)])
        return np.asarray(np.exp(self.log_masses - logsumexp(everything, axis=1)))

    def advantage(self, one: int, other: int) -> float:
        """Nats by which it is better than that in which two parts exchange what they are."""
        masses, places = self.choices.log_masses, self.places
        kept = masses[one, places[one]] + masses[other, places[other]]
        exchanged = masses[one, places[other]] + masses[other, places[one]]
        return float(kept - exchanged)

"""What is said of where head and hands are: a mixture over hypotheses of all of them together."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.gaussian_mixtures import GaussianMixtures
from ..core.short_repr import short_repr
from ..numerics.densities import log_sums
from .image_features import BodyImage
from .upper_body import PARTS

Array = NDArray[np.float64]

MOST_HYPOTHESES = 16
"""Of a product; of more, those of the least mass are left out."""

N_PARTS = len(PARTS)


@short_repr
@dataclass(frozen=True, eq=False)
class PartMessage:
    """What is said of the parts' positions, by chains and by the image.

    Chains say joint hypotheses, in which each part has a mixture of its own:

        p(F) = sum_h exp(log_hypotheses[h]) prod_part m_h,part(F_part)

    What the image says is kept apart, since who compares whole bodies with the image reads it better than its
    mixtures can say.

    Parameters
    ----------
    stacked
        product of the chains' messages: the mixtures of all hypotheses, one after the other, H times 3.
    image
        what the image says; `None` where it says nothing.
    log_hypotheses
        `(H,)` log weights; of one hypothesis, unless given.

    Raises
    ------
    ValueError
        if there are not three mixtures for each hypothesis.
    """

    stacked: GaussianMixtures
    image: BodyImage | None = None
    log_hypotheses: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        if self.stacked.n_parts != N_PARTS * len(self.log_hypotheses):
            raise ValueError(
                f"part message: got {self.stacked.n_parts} mixtures, expected {N_PARTS} for each of "
                f"{len(self.log_hypotheses)} hypotheses"
            )

    @classmethod
    def of_hypotheses(cls, hypotheses: Sequence[GaussianMixtures], log_weights: ArrayLike) -> Self:
        """Some hypotheses of all parts, with log weights `(H,)`."""
        return cls(GaussianMixtures.stacked(hypotheses), None, np.asarray(log_weights, np.float64))

    @cached_property
    def hypotheses(self) -> tuple[GaussianMixtures, ...]:
        """The mixtures of the three parts under each hypothesis."""
        rows = np.arange(self.stacked.n_parts).reshape(-1, N_PARTS)
        return tuple(self.stacked.take(row) for row in rows)

    @property
    def predicted(self) -> GaussianMixtures:
        """What chains say of each part, whatever holds for the others.

        A hypothesis counts by its mass; flat components count as 1.
        """
        return self._marginals(self.stacked, self.log_hypotheses)

    @cached_property
    def mixtures(self) -> GaussianMixtures:
        """The same of the product of all, the image among them."""
        return self._marginals(self._all_said, self.log_hypotheses)

    @property
    def log_mass(self) -> float:
        """Log of the integral over all parts' positions."""
        masses = self._all_said.log_masses.reshape(-1, N_PARTS).sum(axis=1)
        return float(log_sums(self.log_hypotheses + masses))

    def log_values(self, places: Array) -> Array:
        """`(n,)` nats: what chains say of parts at `places`, `(n, 3, 2)` px."""
        return self.stacked.log_joint_values(places, self.log_hypotheses)

    def __mul__(self, other: Self) -> Self:
        """Every hypothesis of one with every one of the other; the `MOST_HYPOTHESES` of the greatest mass."""
        if self.image is not None and other.image is not None:
            raise ValueError("part message: got two images, expected at most one")
        ours, theirs = np.indices((len(self.log_hypotheses), len(other.log_hypotheses))).reshape(2, -1)
        product = self._of(ours) * other._of(theirs)
        weights = self.log_hypotheses[ours] + other.log_hypotheses[theirs]
        if len(weights) > MOST_HYPOTHESES:
            masses = weights + product.log_masses.reshape(-1, N_PARTS).sum(axis=1)
            kept = np.sort(np.argsort(-masses, kind="stable")[:MOST_HYPOTHESES])
            product, weights = product.take(_rows(kept)), weights[kept]
        return type(self)(product, self.image or other.image, weights)

    def _of(self, hypotheses: NDArray[np.intp]) -> GaussianMixtures:
        return self.stacked.take(_rows(hypotheses))

    @property
    def _all_said(self) -> GaussianMixtures:
        if self.image is None:
            return self.stacked
        rows = np.tile(np.arange(N_PARTS), len(self.log_hypotheses))
        return self.stacked * self.image.mixtures.take(rows)

    @staticmethod
    def _marginals(stacked: GaussianMixtures, log_hypotheses: Array) -> GaussianMixtures:
        if len(log_hypotheses) == 1:
            return stacked
        masses = log_sums(stacked.log_weights).reshape(-1, N_PARTS)
        others = masses.sum(axis=1, keepdims=True) - masses + log_hypotheses[:, None]
        return stacked.pooled(N_PARTS, others.ravel())


def _rows(hypotheses: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where the parts of some hypotheses are."""
    return np.asarray((N_PARTS * hypotheses[:, None] + np.arange(N_PARTS)).ravel())

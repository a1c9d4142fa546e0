"""Independent Gaussians by identity: what is known of many things of one kind, each on its own."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .kernels import invert
from .short_repr import short_repr

Numbers = NDArray[np.float64]

LEAST_INFORMATION = 1e-12
"""Smallest pivot of an information matrix, scaled to a unit diagonal, that is told from rounding."""


@short_repr
@dataclass(frozen=True, eq=False)
class GaussianMessage:
    """A product over things k of exp(scale_k + vector_k . F_k - F_k . information_k F_k / 2).

    In information form products add, and a thing that a message does not mention has no information there.
    Things are kept apart: what a chain knows of several together (one plane below all boxes, one camera that
    sees all points) is sent as each one's own marginal.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    information
        `(n, d, d)` 1/px^2, symmetric, positive definite or semi-definite.
    vector
        `(n, d)` 1/px, information times mean.
    log_scale
        `(n,)`; see `from_moments` for that of a density.
    """

    identities: NDArray[np.int64]
    information: Numbers
    vector: Numbers
    log_scale: Numbers

    @classmethod
    def uniform(cls, dimension: int) -> Self:
        """The constant 1, which mentions nothing."""
        return cls(
            np.zeros(0, np.int64),
            np.zeros((0, dimension, dimension)),
            np.zeros((0, dimension)),
            np.zeros(0, np.float64),
        )

    @classmethod
    def from_moments(cls, identities: ArrayLike, means: ArrayLike, covariances: ArrayLike) -> Self:
        """Densities that integrate to 1.

        Parameters
        ----------
        identities
            `(n,)` integers in any order, each once.
        means
            `(n, d)` px.
        covariances
            `(n, d, d)` px^2.

        Raises
        ------
        ValueError
            if an identity comes twice, the shapes do not fit, or a covariance is not positive definite.
        """
        numbers = np.asarray(identities, np.int64).reshape(-1)
        mean, covariance = np.asarray(means, np.float64), np.asarray(covariances, np.float64)
        count, dimension = len(numbers), mean.shape[-1]
        for name, array, shape in (
            ("means", mean, (count, dimension)),
            ("covariances", covariance, (count, dimension, dimension)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name}: got {array.shape} for {count} identities, expected {shape}")
        if (numbers[1:] <= numbers[:-1]).any():
            order = np.argsort(numbers, kind="stable")
            numbers, mean, covariance = numbers[order], mean[order], covariance[order]
            twice = numbers[1:][numbers[1:] == numbers[:-1]]
            if len(twice):
                raise ValueError(f"identities: got {twice[0]} twice, expected each once")
        information, vector, log_determinants, regular = _inverted(covariance, mean, 0.0)
        if not regular.all():
            raise ValueError("covariances: got one that is not positive definite, expected all to be")
        log_peak = -0.5 * (dimension * np.log(2 * np.pi) + log_determinants)
        return cls(numbers, information, vector, log_peak - 0.5 * (vector * mean).sum(axis=1))

    def __len__(self) -> int:
        return len(self.identities)

    def __mul__(self, other: Self) -> Self:
        if not other.identities.size or not self.identities.size:
            return other if other.identities.size else self
        one, two = self, other
        if self.identities is not other.identities and not np.array_equal(self.identities, other.identities):
            union = np.union1d(self.identities, other.identities)
            one, two = self.among(union), other.among(union)
        return type(self)(
            one.identities,
            one.information + two.information,
            one.vector + two.vector,
            one.log_scale + two.log_scale,
        )

    @property
    def dimension(self) -> int:
        """Numbers of each thing."""
        return int(self.vector.shape[1])

    @cached_property
    def _solved(self) -> tuple[Numbers, Numbers, Numbers, NDArray[np.bool_]]:
        return _inverted(self.information, self.vector, LEAST_INFORMATION)

    @property
    def proper(self) -> NDArray[np.bool_]:
        """`(n,)`: whether there is information about all numbers of the thing."""
        return self._solved[3]

    @cached_property
    def moments(self) -> tuple[NDArray[np.int64], Numbers, Numbers]:
        """Identities `(m,)`, means `(m, d)` px and covariances `(m, d, d)` px^2 of the proper ones."""
        covariances, means, _, proper = self._solved
        if proper.all():
            return self.identities, means, covariances
        return self.identities[proper], means[proper], covariances[proper]

    @property
    def log_mass(self) -> float:
        """Log of the integral over all things that the message knows something of.

        A number without any information counts as if it were not mentioned, and so does a thing without any,
        but for its scale; one with information about a direction between its numbers has no finite integral.
        """
        known = np.asarray(self.information.any(axis=(1, 2)))
        if not self.proper[known].all():
            return self._without_unmentioned(known)
        _, means, log_determinants, proper = self._solved
        quadratic = (self.vector * means).sum(axis=1)
        gaussian = 0.5 * (self.dimension * np.log(2 * np.pi) - log_determinants + quadratic)[proper]
        return float(self.log_scale.sum() + gaussian.sum())

    def _without_unmentioned(self, known: NDArray[np.bool_]) -> float:
        """Log of the integral over those numbers of known things about which there is information."""
        unmentioned = np.asarray(~self.information[known].any(axis=2))
        if not unmentioned.any():
            return float("inf")
        # each one as a standard normal, whose integral is 1
        filled = self.information.copy()
        filled[known] += unmentioned[:, :, None] * np.eye(self.dimension)
        scales = self.log_scale.copy()
        scales[known] -= 0.5 * np.log(2 * np.pi) * np.count_nonzero(unmentioned, axis=1)
        return type(self)(self.identities, filled, self.vector, scales).log_mass

    def marginal(self, identity: int) -> tuple[Numbers, Numbers]:
        """Mean `(d,)` px and covariance `(d, d)` px^2 of one thing.

        Raises
        ------
        KeyError
            if there is none of that number, or not enough is known to say where it is.
        """
        identities, means, covariances = self.moments
        place = int(np.searchsorted(identities, identity))
        if place == len(identities) or identities[place] != identity:
            raise KeyError(f"{identity}: nothing that fixes it is known")
        return means[place], covariances[place]

    def among(self, identities: NDArray[np.int64]) -> Self:
        """The same function, which also mentions things of which it says nothing.

        Parameters
        ----------
        identities
            `(m,)` int64, increasing; all of this message's are there.
        """
        place = np.searchsorted(identities, self.identities)
        count, dimension = len(identities), self.dimension
        information, vector = np.zeros((count, dimension, dimension)), np.zeros((count, dimension))
        log_scale = np.zeros(count)
        information[place], vector[place], log_scale[place] = self.information, self.vector, self.log_scale
        return type(self)(identities, information, vector, log_scale)

    def only(self, kept: NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """The factors of those of whom `kept` is true, or at these places, in order."""
        return type(self)(
            self.identities[kept], self.information[kept], self.vector[kept], self.log_scale[kept]
        )


def _inverted(
    matrices: Numbers, vectors: Numbers, least: float
) -> tuple[Numbers, Numbers, Numbers, NDArray[np.bool_]]:
    """Inverses, these times vectors, log determinants of the matrices, and which of them are regular."""
    matrices, vectors = np.ascontiguousarray(matrices), np.ascontiguousarray(vectors)
    count = len(matrices)
    inverses, products = np.empty(matrices.shape), np.empty(vectors.shape)
    log_determinants, regular = np.empty(count), np.empty(count, np.bool_)
    invert(matrices, vectors, least, inverses, products, log_determinants, regular)
    return inverses, products, log_determinants, regular

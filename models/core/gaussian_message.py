"""Independent Gaussians by identity: one of each thing."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.compiled import compiled, inlined
from .checks import Count, Shape, checked, made
from .frame import Frame
from .identities import Identities, Places, find, places_of, union
from .short_repr import Rows, short_repr

Numbers = NDArray[np.float64]

LEAST_INFORMATION = 1e-12
"""Smallest pivot of an information matrix, scaled to a unit diagonal, that differs from rounding."""


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class GaussianMessage(Rows):
    """Product over vectors F_k of exp(scale_k + vector_k . F_k - F_k . information_k F_k / 2).

    In information form products are sums, and the message is uniform for identities that it does not contain.
    The vectors are independent: a chain with joint knowledge of several (one ground plane, one camera) sends
    the marginal of each.
    """

    identities: Annotated[NDArray[np.int64], Shape("n")]  # increasing
    information: Annotated[Numbers, Shape("n", "d", "d")]  # 1/px^2, positive semi-definite
    vector: Annotated[Numbers, Shape("n", "d")]  # 1/px, information times mean
    log_scale: Annotated[Numbers, Shape("n")]  # see `from_moments` for that of a density

    @classmethod
    def uniform(cls, dimension: int) -> Self:
        """Return the constant 1, which contains no identity."""
        nothing = np.zeros((0, dimension))
        return cls(np.zeros(0, np.int64), np.zeros((0, dimension, dimension)), nothing, np.zeros(0))

    @classmethod
    def from_moments(cls, identities: ArrayLike, means: ArrayLike, covariances: ArrayLike) -> Self:
        """Return densities, which integrate to 1.

        Parameters
        ----------
        identities
            `(n,)` integers in any order, each once.
        means, covariances
            `(n, d)` px and `(n, d, d)` px^2.

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
            both, here, there = union(self.identities, other.identities)
            one, two = self._spread(both, here), other._spread(both, there)
        return made(
            type(self),
            one.identities,
            one.information + two.information,
            one.vector + two.vector,
            one.log_scale + two.log_scale,
        )

    @property
    def gaussians(self) -> Self:
        """The message, as it is for messages of which Gaussians are a factor."""
        return self

    def with_gaussians(self, gaussians: Self) -> Self:
        """Return the Gaussians."""
        return gaussians

    def __pow__(self, exponent: float) -> Self:
        parts = (self.information, self.vector, self.log_scale)
        return type(self)(self.identities, *(exponent * part for part in parts))

    def distance(self, other: Self) -> float:
        """Return how far two messages are apart, whatever their scales.

        The greatest difference of information, and of the slope of the logarithm at the product's mean, in
        units of the product's information.
        """
        both = self * other
        one, two = self.among(both.identities), other.among(both.identities)
        size = np.sqrt(both.information.diagonal(axis1=1, axis2=2))
        size[size == 0] = np.inf  # neither says anything
        information = one.information - two.information
        means = both._solved[1]
        slope = one.vector - two.vector - (information @ means[:, :, None])[:, :, 0]
        changes = (information / (size[:, :, None] * size[:, None, :]), slope / size)
        return float(max(np.abs(change).max(initial=0.0) for change in changes))

    @property
    def dimension(self) -> int:
        """Number of coordinates of each vector."""
        return int(self.vector.shape[1])

    @cached_property
    def _solved(self) -> tuple[Numbers, Numbers, Numbers, NDArray[np.bool_]]:
        return _inverted(self.information, self.vector, LEAST_INFORMATION)

    @property
    def proper(self) -> NDArray[np.bool_]:
        """`(n,)`: whether the information matrix is positive definite."""
        return self._solved[3]

    @cached_property
    def moments(self) -> tuple[NDArray[np.int64], Numbers, Numbers]:
        """Identities `(m,)`, means `(m, d)` px and covariances `(m, d, d)` px^2 of proper Gaussians."""
        covariances, means, _, proper = self._solved
        if proper.all():
            return self.identities, means, covariances
        return self.identities[proper], means[proper], covariances[proper]

    @property
    def log_mass(self) -> float:
        """Log of the integral over all vectors with information.

        Coordinates without any information are omitted; with information only about a direction between
        coordinates, the integral is infinite.
        """
        informed = np.asarray(self.information.any(axis=(1, 2)))
        if not self.proper[informed].all():
            return self._without_unmentioned(informed)
        _, means, log_determinants, proper = self._solved
        quadratic = (self.vector * means).sum(axis=1)
        gaussian = 0.5 * (self.dimension * np.log(2 * np.pi) - log_determinants + quadratic)[proper]
        return float(self.log_scale.sum() + gaussian.sum())

    def _without_unmentioned(self, informed: NDArray[np.bool_]) -> float:
        """Log of the integral over those coordinates about which there is information."""
        unmentioned = np.asarray(~self.information[informed].any(axis=2))
        if not unmentioned.any():
            return float("inf")
        # each one as a standard normal, whose integral is 1
        filled = self.information.copy()
        filled[informed] += unmentioned[:, :, None] * np.eye(self.dimension)
        scales = self.log_scale.copy()
        scales[informed] -= 0.5 * np.log(2 * np.pi) * np.count_nonzero(unmentioned, axis=1)
        return type(self)(self.identities, filled, self.vector, scales).log_mass

    def marginal(self, identity: int) -> tuple[Numbers, Numbers]:
        """Return mean `(d,)` px and covariance `(d, d)` px^2 of a proper Gaussian, otherwise a `KeyError`."""
        identities, means, covariances = self.moments
        place, is_proper = find(identities, identity)
        if not is_proper:
            raise KeyError(f"{identity}: not mentioned, or without full information")
        return means[place], covariances[place]

    def among(self, identities: NDArray[np.int64]) -> Self:
        """Return the same function with zero rows for all other of these identities."""
        return self._spread(identities, places_of(identities, self.identities))

    def _spread(self, identities: Identities, place: Places) -> Self:
        count, dimension = len(identities), self.dimension
        information, vector = np.zeros((count, dimension, dimension)), np.zeros((count, dimension))
        log_scale = np.zeros(count)
        information[place], vector[place], log_scale[place] = self.information, self.vector, self.log_scale
        return made(type(self), identities, information, vector, log_scale)


@checked
@short_repr
@dataclass(frozen=True)
class GaussianFeature:
    """Feature node of vectors by identity, with or without a likelihood of the image.

    Parameters
    ----------
    name
        of the node.
    dimension
        numbers of a vector.
    measure
        likelihood of a frame that is not missing: `measure(frame)`. `None` if images contain no information
        about it.
    """

    name: str
    dimension: Count
    measure: Callable[[Frame], GaussianMessage] | None = None

    searches = False

    def uniform(self) -> GaussianMessage:
        """Return the constant 1."""
        return GaussianMessage.uniform(self.dimension)

    def evidence(self, frame: Frame, prior: GaussianMessage) -> GaussianMessage:
        """Return the likelihood of the frame; a `ValueError` if `measure` gives another dimension."""
        if self.measure is None:
            return self.uniform()
        message = self.measure(frame)
        if message.dimension != self.dimension:
            raise ValueError(
                f"measure of {self.name!r}: got {message.dimension} numbers at frame {frame.number}, "
                f"expected {self.dimension}"
            )
        return message


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


@inlined
def _cholesky(matrix, scales, least, root):
    """Lower root of a matrix scaled to a unit diagonal; whether all its pivots are more than `least`."""
    size = scales.size
    for i in range(size):
        if not matrix[i, i] > 0:
            return False
        scales[i] = math.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j] / (scales[i] * scales[j])
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = value / root[j, j]
            elif value > least:
                root[i, i] = math.sqrt(value)
            else:
                return False
    return True


@inlined
def _inverse(root, scales, lower, out):
    """Inverse of the matrix of which `_cholesky` gave the root; `lower` is for the root's."""
    size = scales.size
    for j in range(size):
        for i in range(j, size):
            value = 1.0 if i == j else 0.0
            for k in range(j, i):
                value -= root[i, k] * lower[k, j]
            lower[i, j] = value / root[i, i]
    for i in range(size):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, size):
                value += lower[k, i] * lower[k, j]
            out[i, j] = out[j, i] = value / (scales[i] * scales[j])


@compiled
def invert(matrices, vectors, least, inverses, products, log_determinants, regular):
    """Inverses of symmetric `(n, d, d)` matrices, and these times vectors; 0 of those not `regular`."""
    size = matrices.shape[1]
    scales, root, lower = np.empty(size), np.zeros((size, size)), np.zeros((size, size))
    for n in range(matrices.shape[0]):
        inverse, product = inverses[n], products[n]
        log_determinant = 0.0
        regular[n] = _cholesky(matrices[n], scales, least, root)
        if regular[n]:
            _inverse(root, scales, lower, inverse)
            for i in range(size):
                log_determinant += math.log(root[i, i] * scales[i])
        else:
            inverse[:] = 0.0
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += inverse[i, j] * vectors[n, j]
            product[i] = value
        log_determinants[n] = 2 * log_determinant


def squared_distances(off: Numbers, covariance: Numbers) -> Numbers:
    """Squared distances `(...)` of vectors `(..., d)` from 0, by covariances `(..., d, d)`."""
    return np.asarray((off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1))

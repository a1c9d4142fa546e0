"""Boxes of objects as a feature node: where each one stands and how large it looks, by identity.

This is where what follows single objects through the pixels meets what knows the scene that they move in.
A message holds a Gaussian over the box of every object it speaks of, in information form: products add, and
an object that a message does not mention has no information there.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .frame import Frame

FOOT_X, FOOT_Y, WIDTH, HEIGHT = range(4)
"""Order of a box's numbers (px): middle of its bottom edge, as column and row, then its size."""

BOX = 4

LEAST_INFORMATION = 1e-12
"""Smallest eigenvalue of an information matrix, scaled to a unit diagonal, that is told from rounding."""


@dataclass(frozen=True, eq=False)
class BoxMessage:
    """A product over objects k of exp(scale_k + vector_k . F_k - F_k . information_k F_k / 2).

    Objects are kept apart: what a chain knows of several together (one plane below all of them) is sent as
    each one's own marginal.

    Parameters
    ----------
    identities
        `(n_objects,)` int64, increasing.
    information
        `(n_objects, 4, 4)` 1/px^2, symmetric, positive definite or semi-definite.
    vector
        `(n_objects, 4)` 1/px, information times mean.
    log_scale
        `(n_objects,)`; see `from_moments` for that of a density.
    """

    identities: NDArray[np.int64]
    information: NDArray[np.float64]
    vector: NDArray[np.float64]
    log_scale: NDArray[np.float64]

    @classmethod
    def from_moments(cls, identities: ArrayLike, means: ArrayLike, covariances: ArrayLike) -> Self:
        """Densities that integrate to 1.

        Parameters
        ----------
        identities
            `(n_objects,)` integers in any order, each once.
        means
            `(n_objects, 4)` px: foot x, foot y, width, height.
        covariances
            `(n_objects, 4, 4)` px^2.

        Raises
        ------
        ValueError
            if an identity comes twice, the shapes do not fit, or a covariance is not positive definite.
        """
        numbers = np.asarray(identities, np.int64).reshape(-1)
        mean, covariance = np.asarray(means, np.float64), np.asarray(covariances, np.float64)
        n_objects = len(numbers)
        for name, array, shape in (
            ("means", mean, (n_objects, BOX)),
            ("covariances", covariance, (n_objects, BOX, BOX)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name}: got {array.shape} for {n_objects} identities, expected {shape}")
        order = np.argsort(numbers, kind="stable")
        numbers, mean, covariance = numbers[order], mean[order], covariance[order]
        if n_objects > 1 and not (np.diff(numbers) > 0).all():
            twice = numbers[1:][np.diff(numbers) == 0][0]
            raise ValueError(f"identities: got {twice} twice, expected each object once")
        try:
            root = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            raise ValueError("covariances: got one that is not positive definite, expected all to be") from None
        information = np.linalg.inv(covariance)
        vector = (information @ mean[:, :, None])[:, :, 0]
        log_density = -0.5 * BOX * np.log(2 * np.pi) - np.log(root.diagonal(axis1=1, axis2=2)).sum(axis=1)
        return cls(numbers, information, vector, log_density - 0.5 * (vector * mean).sum(axis=1))

    def __len__(self) -> int:
        return len(self.identities)

    def __mul__(self, other: Self) -> Self:
        if not len(other):
            return self
        if not len(self):
            return other
        one, two = self, other
        if not np.array_equal(self.identities, other.identities):
            union = np.union1d(self.identities, other.identities)
            one, two = self._among(union), other._among(union)
        return type(self)(
            one.identities,
            one.information + two.information,
            one.vector + two.vector,
            one.log_scale + two.log_scale,
        )

    @cached_property
    def proper(self) -> NDArray[np.bool_]:
        """`(n_objects,)`: whether there is information about all four numbers of the box."""
        sizes = np.sqrt(self.information.diagonal(axis1=1, axis2=2))
        some = sizes.all(axis=1)
        sizes = np.where(some[:, None], sizes, 1.0)
        scaled = self.information / (sizes[:, :, None] * sizes[:, None, :])
        enough: NDArray[np.bool_] = some & (np.linalg.eigvalsh(scaled)[:, 0] > LEAST_INFORMATION)
        return enough

    @cached_property
    def moments(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Identities `(m,)`, means `(m, 4)` px and covariances `(m, 4, 4)` px^2 of the proper ones."""
        identities, information, vector = self.identities, self.information, self.vector
        if not self.proper.all():
            identities, information, vector = (part[self.proper] for part in (identities, information, vector))
        covariances = np.linalg.inv(information)
        return identities, (covariances @ vector[:, :, None])[:, :, 0], covariances

    @property
    def log_mass(self) -> float:
        """Log of the integral over the boxes of all objects that the message knows something of.

        An object without any information counts with its scale alone, as if it were not mentioned; one with
        information about some of its numbers has no finite integral.
        """
        known = self.information.any(axis=(1, 2))
        if not self.proper[known].all():
            return float("inf")
        _, means, covariances = self.moments
        _, log_determinants = np.linalg.slogdet(covariances)
        quadratic = (self.vector[self.proper] * means).sum(axis=1)
        gaussian = 0.5 * (BOX * np.log(2 * np.pi) + log_determinants + quadratic)
        return float(self.log_scale.sum() + gaussian.sum())

    def marginal(self, identity: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean `(4,)` px and covariance `(4, 4)` px^2 of one object's box.

        Raises
        ------
        KeyError
            if there is no object of that number, or not enough is known to say where it is.
        """
        identities, means, covariances = self.moments
        place = int(np.searchsorted(identities, identity))
        if place == len(identities) or identities[place] != identity:
            raise KeyError(f"object {identity}: nothing that fixes its box is known")
        return means[place], covariances[place]

    def _among(self, identities: NDArray[np.int64]) -> Self:
        """The same function, with objects of which it says nothing."""
        place = np.searchsorted(identities, self.identities)
        n_objects = len(identities)
        information, vector = np.zeros((n_objects, BOX, BOX)), np.zeros((n_objects, BOX))
        log_scale = np.zeros(n_objects)
        information[place], vector[place], log_scale[place] = self.information, self.vector, self.log_scale
        return type(self)(identities, information, vector, log_scale)


@dataclass(frozen=True)
class ObjectBoxes:
    """Feature node of the boxes of objects, shared by trackers and by what knows the scene.

    Images say nothing of it by themselves: what they show of objects comes through the chain that also
    speaks to the pixels.
    """

    name: str = "objects"

    def uniform(self) -> BoxMessage:
        """The message that mentions no object."""
        return BoxMessage(
            np.zeros(0, np.int64), np.zeros((0, BOX, BOX)), np.zeros((0, BOX)), np.zeros(0, np.float64)
        )

    def evidence(self, frame: Frame, prior: BoxMessage) -> BoxMessage:
        """Nothing."""
        return self.uniform()

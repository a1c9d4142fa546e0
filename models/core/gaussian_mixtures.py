"""Mixtures of Gaussians in the picture, one for each of a few parts, with components that are flat."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.densities import log_sums
from ..numerics.threads import over_bands
from .kernels import products, sums_of_densities, sums_over_hypotheses
from .short_repr import short_repr

Array = NDArray[np.float64]

MOST_COMPONENTS = 32
"""Of a part in a product; of more, the lightest are left out."""

NO_LABEL = -1
LOG_TWO_PI = float(np.log(2 * np.pi))

WORTH_THREADS = 1000
"""Points from which several threads are faster than one."""

NO_WEIGHT = -1e30
"""Log weight of a filler in kernels, where nothing is infinite."""


@short_repr
@dataclass(frozen=True, eq=False)
class GaussianMixtures:
    """Per part p the function sum_k exp(log_weights[p, k]) g_pk(F_p) of its position F_p.

    g is a Gaussian density, or the constant 1 of a flat component. Parts have equally many components: those
    with a weight of 0 are fillers.

    Parameters
    ----------
    log_weights
        `(n_parts, n)`; minus infinity for a filler.
    means
        `(n_parts, n, 2)` px.
    covariances
        `(n_parts, n, 2, 2)` px^2, positive definite.
    flat
        `(n_parts, n)` bool: components without mean and covariance (whose entries are not used).
    labels
        `(n_parts, n)` int64: number of the thing in the picture that a component stands for, which may be
        the same in several parts; -1 for none. A product keeps them.
    """

    log_weights: Array
    means: Array
    covariances: Array
    flat: NDArray[np.bool_]
    labels: NDArray[np.int64]

    @classmethod
    def uniform(cls, n_parts: int) -> Self:
        """The constant 1."""
        one = (n_parts, 1)
        return cls(
            np.zeros(one),
            np.zeros((*one, 2)),
            np.broadcast_to(np.eye(2), (*one, 2, 2)).copy(),
            np.ones(one, np.bool_),
            np.full(one, NO_LABEL, np.int64),
        )

    @classmethod
    def of_parts(
        cls,
        log_weights: Sequence[ArrayLike],
        means: Sequence[ArrayLike],
        covariances: Sequence[ArrayLike],
        log_flat: ArrayLike | None = None,
        labels: Sequence[ArrayLike] | None = None,
    ) -> Self:
        """Mixtures with different numbers of components.

        Parameters
        ----------
        log_weights, means, covariances, labels
            one array for each part: `(n,)`, `(n, 2)` px, `(n, 2, 2)` px^2, `(n,)`; n may be 0.
        log_flat
            `(n_parts,)` log weight of a flat component of each part (per px^2), minus infinity for none.

        Raises
        ------
        ValueError
            if the shapes do not fit.
        """
        n_parts = len(log_weights)
        counts = [len(np.asarray(each)) for each in log_weights]
        flat = np.full(n_parts, -np.inf) if log_flat is None else np.asarray(log_flat, np.float64)
        most = max(counts) + 1
        made = cls.uniform(n_parts)._filled(most)
        made.log_weights[:, 0] = flat
        for part, count in enumerate(counts):
            mean = np.asarray(means[part], np.float64).reshape(-1, 2)
            covariance = np.asarray(covariances[part], np.float64).reshape(-1, 2, 2)
            if len(mean) != count or len(covariance) != count:
                raise ValueError(
                    f"mixture of part {part}: got {len(mean)} means and {len(covariance)} covariances, "
                    f"expected {count} of each"
                )
            here = slice(1, count + 1)
            made.log_weights[part, here] = log_weights[part]
            made.means[part, here], made.covariances[part, here] = mean, covariance
            made.flat[part, here] = False
            if labels is not None:
                made.labels[part, here] = labels[part]
        return made

    @property
    def n_parts(self) -> int:
        """Number of parts."""
        return len(self.log_weights)

    def __mul__(self, other: Self) -> Self:
        a, b = self, other
        n_parts, n, m = *a.log_weights.shape, b.log_weights.shape[1]
        means, covariances = np.empty((n_parts, n * m, 2)), np.empty((n_parts, n * m, 2, 2))
        overlaps = np.empty((n_parts, n * m))
        products(a.means, a.covariances, a.flat, b.means, b.covariances, b.flat, means, covariances, overlaps)
        weights = (a.log_weights[:, :, None] + b.log_weights[:, None]).reshape(n_parts, -1) + overlaps
        labels = np.where(a.labels[:, :, None] == NO_LABEL, b.labels[:, None], a.labels[:, :, None])
        flat = a.flat[:, :, None] & b.flat[:, None]
        return type(self)(
            weights, means, covariances, flat.reshape(n_parts, -1), labels.reshape(n_parts, -1)
        )._pruned()

    def take(self, parts: Sequence[int] | NDArray[np.intp]) -> Self:
        """Mixtures of some of the parts, in that order."""
        chosen = np.asarray(parts)
        return type(self)(
            self.log_weights[chosen],
            self.means[chosen],
            self.covariances[chosen],
            self.flat[chosen],
            self.labels[chosen],
        )

    @classmethod
    def stacked(cls, mixtures: "Sequence[GaussianMixtures]") -> Self:
        """The parts of several, one after the other."""
        most = max(each.log_weights.shape[1] for each in mixtures)
        filled = [each._filled(most) for each in mixtures]
        return cls(
            np.concatenate([each.log_weights for each in filled]),
            np.concatenate([each.means for each in filled]),
            np.concatenate([each.covariances for each in filled]),
            np.concatenate([each.flat for each in filled]),
            np.concatenate([each.labels for each in filled]),
        )

    def pooled(self, n_parts: int, log_weights: Array) -> Self:
        """Sums of several mixtures of the same parts, which are stacked here.

        Parameters
        ----------
        n_parts
            of the sum; these are a multiple of it.
        log_weights
            nats for each of these.
        """

        def side_by_side(values: NDArray[Any]) -> NDArray[Any]:
            """`(k * n_parts, n, ...)` as `(n_parts, k * n, ...)`."""
            each = values.reshape(-1, n_parts, *values.shape[1:]).swapaxes(0, 1)
            return each.reshape(n_parts, -1, *values.shape[2:])

        return type(self)(
            side_by_side(self.log_weights + log_weights[:, None]),
            side_by_side(self.means),
            side_by_side(self.covariances),
            side_by_side(self.flat),
            side_by_side(self.labels),
        )

    def proper(self, log_mass: float, means: Array, covariances: Array) -> Self:
        """Mixtures in which a Gaussian stands for every flat component.

        Parameters
        ----------
        log_mass
            by how much a Gaussian's log weight is more than that of its flat component: log of the area,
            px^2, over which that one counts; one number for all parts.
        means, covariances
            `(n_parts, 2)` px and `(n_parts, 2, 2)` px^2 of these Gaussians.
        """
        flat = self.flat[..., None]
        return type(self)(
            self.log_weights + np.where(self.flat, log_mass, 0.0),
            np.where(flat, means[:, None], self.means),
            np.where(flat[..., None], covariances[:, None], self.covariances),
            np.zeros_like(self.flat),
            self.labels,
        )

    def blended(self, other: Self, share: float) -> Self:
        """Densities: this one, or with probability `share` the other one; both proper, each counted as 1."""
        own, more = (each.log_weights - each.log_masses[:, None] for each in (self, other))
        return type(self)(
            np.concatenate([own + np.log1p(-share), more + np.log(share)], axis=1),
            np.concatenate([self.means, other.means], axis=1),
            np.concatenate([self.covariances, other.covariances], axis=1),
            np.concatenate([self.flat, other.flat], axis=1),
            np.concatenate([self.labels, other.labels], axis=1),
        )

    @property
    def informative(self) -> NDArray[np.bool_]:
        """`(n_parts,)`: whether a part has any component that is not flat."""
        return np.asarray((~self.flat & np.isfinite(self.log_weights)).any(axis=1))

    @cached_property
    def log_masses(self) -> Array:
        """`(n_parts,)` logs of the integrals; infinite with a flat component."""
        improper = (self.flat & np.isfinite(self.log_weights)).any(axis=1)
        return np.where(improper, np.inf, log_sums(self.log_weights))

    def log_values(self, points: Array) -> Array:
        """`(n, n_parts)` logs of the functions at `points`, `(n, n_parts, 2)` px."""
        peaks, sums = np.empty((2, len(points), self.n_parts))
        sums_of_densities(points, *self._middles, peaks, sums)
        values = peaks + np.log(sums)
        values[peaks < 0.5 * NO_WEIGHT] = -np.inf
        return values

    def log_joint_values(self, points: Array, log_hypotheses: Array) -> Array:
        """`(n,)` logs of a sum over hypotheses of the product of its parts' functions.

        Parameters
        ----------
        points
            `(n, k, 2)` px, of k parts.
        log_hypotheses
            `(h,)` log weights; these mixtures are those of the k parts of each, one after the other.
        """
        logs = np.empty(len(points))
        weights = np.maximum(log_hypotheses, NO_WEIGHT)

        def work(first: int, end: int) -> None:
            sums_over_hypotheses(points[first:end], weights, *self._middles, logs[first:end])

        if len(points) < WORTH_THREADS:
            work(0, len(points))
        else:
            over_bands(work, len(points))
        logs[logs < 0.5 * NO_WEIGHT] = -np.inf
        return logs

    @cached_property
    def _middles(self) -> tuple[Array, Array, Array]:
        """Log heights, means and half precisions as `sums_of_densities` takes them."""
        a, b, d = self.covariances[..., 0, 0], self.covariances[..., 0, 1], self.covariances[..., 1, 1]
        determinant = np.where(self.flat, 1.0, a * d - b * b)
        heights = self.log_weights - np.where(self.flat, 0.0, LOG_TWO_PI + 0.5 * np.log(determinant))
        halves = np.where(self.flat, 0.0, 0.5 / determinant) * np.stack([d, -b, a])
        return (
            np.maximum(heights, NO_WEIGHT),
            np.ascontiguousarray(self.means.swapaxes(1, 2)),
            np.ascontiguousarray(halves.swapaxes(0, 1)),
        )

    def log_overlaps(self, means: Array, covariances: Array) -> Array:
        """`(n_parts, n)` logs of the integrals of the functions times Gaussian densities.

        Parameters
        ----------
        means, covariances
            of n densities a part: `(n_parts, n, 2)` px and `(n_parts, n, 2, 2)` px^2.
        """
        step = means[:, :, None] - self.means[:, None]
        overlap = _log_density(step, covariances[:, :, None] + self.covariances[:, None])
        overlap = np.where(self.flat[:, None], 0.0, overlap)
        return log_sums(self.log_weights[:, None] + overlap)

    def moments(self, area: float, centre: ArrayLike) -> tuple[Array, Array]:
        """Means `(n_parts, 2)` px and covariances `(n_parts, 2, 2)` px^2.

        Flat components count over a square region of `area` px^2 about `centre`.
        """
        weights = self.log_weights + np.where(self.flat, np.log(area), 0.0)
        share = np.exp(weights - log_sums(weights)[:, None])
        means = np.where(self.flat[..., None], np.asarray(centre, np.float64), self.means)
        spreads = np.where(self.flat[..., None, None], area / 12 * np.eye(2), self.covariances)
        mean = (share[..., None] * means).sum(axis=1)
        apart = means - mean[:, None]
        scatter = spreads + apart[..., :, None] * apart[..., None, :]
        return mean, (share[..., None, None] * scatter).sum(axis=1)

    def _filled(self, most: int) -> Self:
        """With fillers up to `most` components a part."""
        missing = most - self.log_weights.shape[1]
        return type(self)(
            np.pad(self.log_weights, ((0, 0), (0, missing)), constant_values=-np.inf),
            np.pad(self.means, ((0, 0), (0, missing), (0, 0))),
            np.concatenate(
                [self.covariances, np.broadcast_to(np.eye(2), (self.n_parts, missing, 2, 2))], axis=1
            ),
            np.pad(self.flat, ((0, 0), (0, missing))),
            np.pad(self.labels, ((0, 0), (0, missing)), constant_values=NO_LABEL),
        )

    def _pruned(self) -> Self:
        """The heaviest components; flat ones stay, since their mass is without bound."""
        if self.log_weights.shape[1] <= MOST_COMPONENTS:
            return self
        rank = np.where(self.flat & np.isfinite(self.log_weights), np.inf, self.log_weights)
        kept = np.sort(np.argsort(-rank, axis=1, kind="stable")[:, :MOST_COMPONENTS], axis=1)
        return type(self)(
            np.take_along_axis(self.log_weights, kept, 1),
            np.take_along_axis(self.means, kept[..., None], 1),
            np.take_along_axis(self.covariances, kept[..., None, None], 1),
            np.take_along_axis(self.flat, kept, 1),
            np.take_along_axis(self.labels, kept, 1),
        )


def _log_density(steps: Array, covariances: Array) -> Array:
    """Logs of Gaussian densities in 2-D; leading axes are broadcast."""
    a, b, d = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    determinant = a * d - b * b
    x, y = steps[..., 0], steps[..., 1]
    quadratic = (d * x * x - 2 * b * x * y + a * y * y) / determinant
    return np.asarray(-LOG_TWO_PI - 0.5 * np.log(determinant) - 0.5 * quadratic)

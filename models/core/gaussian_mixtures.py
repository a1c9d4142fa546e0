"""Mixtures of Gaussians in the picture, one for each of a few parts, with components that are flat."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.compiled import compiled, falling
from ..numerics.threads import over_bands
from .checks import Shape, checked, made
from .short_repr import short_repr

Array = NDArray[np.float64]

MOST_COMPONENTS = 32  # of a part in a product; of more, the lightest are left out

NO_LABEL = -1  # of a component that stands for nothing in particular
LOG_TWO_PI = float(np.log(2 * np.pi))

WORTH_THREADS = 1000  # points from which several threads are faster than one
NO_WEIGHT = -1e30  # log weight of a filler in kernels, where nothing is infinite


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class GaussianMixtures:
    """Per part p the function sum_k exp(log_weights[p, k]) g_pk(F_p) of its position F_p.

    g is a Gaussian density, or the constant 1 of a flat component. All parts have the same number of
    components; some have weight 0.
    """

    log_weights: Annotated[Array, Shape("parts", "n", finite=False)]  # minus infinity for a filler
    means: Annotated[Array, Shape("parts", "n", 2, finite=False)]  # px
    covariances: Annotated[Array, Shape("parts", "n", 2, 2, finite=False)]  # px^2, positive definite
    flat: Annotated[NDArray[np.bool_], Shape("parts", "n")]  # whether mean and covariance are not used
    labels: Annotated[NDArray[np.int64], Shape("parts", "n")]  # what a component stands for; -1 for none

    @classmethod
    def uniform(cls, n_parts: int) -> Self:
        """Return the constant 1."""
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
        """Return mixtures with different numbers of components.

        `log_weights` `(n,)`, `means` `(n, 2)` px, `covariances` `(n, 2, 2)` px^2 and `labels` `(n,)` are one
        array for each part, n may be 0; `log_flat` `(n_parts,)` is the log weight of a flat component of each
        (per px^2), minus infinity for none.

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
        # or the loop is compiled for each layout
        of_a, of_b = np.ascontiguousarray(a.covariances), np.ascontiguousarray(b.covariances)
        products(a.means, of_a, a.flat, b.means, of_b, b.flat, means, covariances, overlaps)
        weights = (a.log_weights[:, :, None] + b.log_weights[:, None]).reshape(n_parts, -1) + overlaps
        labels = np.where(a.labels[:, :, None] == NO_LABEL, b.labels[:, None], a.labels[:, :, None])
        flat = a.flat[:, :, None] & b.flat[:, None]
        return type(self)(
            weights, means, covariances, flat.reshape(n_parts, -1), labels.reshape(n_parts, -1)
        )._pruned()

    def take(self, parts: Sequence[int] | NDArray[np.intp]) -> Self:
        """Return mixtures of some of the parts, in that order."""
        return self._each(lambda values: values[np.asarray(parts)])

    @classmethod
    def stacked(cls, mixtures: "Sequence[GaussianMixtures]") -> Self:
        """Return the parts of several mixtures, one after the other."""
        most = max(each.log_weights.shape[1] for each in mixtures)
        return cls._joined([each._filled(most) for each in mixtures], 0)

    def pooled(self, n_parts: int, log_weights: Array) -> Self:
        """Return sums of several stacked mixtures of the same `n_parts`, with a log weight each."""

        def side_by_side(values: NDArray[Any]) -> NDArray[Any]:
            """Return `(k * n_parts, n, ...)` as `(n_parts, k * n, ...)`."""
            each = values.reshape(-1, n_parts, *values.shape[1:]).swapaxes(0, 1)
            return each.reshape(n_parts, -1, *values.shape[2:])

        return replace(self, log_weights=self.log_weights + log_weights[:, None])._each(side_by_side)

    def proper(self, log_mass: float, means: Array, covariances: Array) -> Self:
        """Return mixtures with a Gaussian in place of every flat component.

        `log_mass` is added to its log weight: log of the area, px^2, over which the flat component is
        integrated.
        """
        flat = self.flat[..., None]
        return replace(
            self,
            log_weights=self.log_weights + np.where(self.flat, log_mass, 0.0),
            means=np.where(flat, means[:, None], self.means),
            covariances=np.where(flat[..., None], covariances[:, None], self.covariances),
            flat=np.zeros_like(self.flat),
        )

    def blended(self, other: Self, share: float) -> Self:
        """Return the mixture of this density and, with weight `share`, the other one; both proper."""
        own, more = (each.log_weights - each.log_masses[:, None] for each in (self, other))
        one = replace(self, log_weights=own + np.log1p(-share))
        return self._joined([one, replace(other, log_weights=more + np.log(share))], 1)

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
        """Return `(n, n_parts)` logs of the functions at `points`, `(n, n_parts, 2)` px."""
        peaks, sums = np.empty((2, len(points), self.n_parts))
        points = np.ascontiguousarray(points)  # or the loop is compiled for each layout
        sums_of_densities(points, *self._middles, peaks, sums)
        values = peaks + np.log(sums)
        values[peaks < 0.5 * NO_WEIGHT] = -np.inf
        return values

    def log_joint_values(self, points: Array, log_hypotheses: Array) -> Array:
        """Return `(n,)` logs of the sum over hypotheses of products of functions at `points` `(n, k, 2)` px.

        These mixtures are those of the k parts of each hypothesis, `(h,)` log weights, one after the other.
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
        """Return `(n_parts, n)` logs of the integrals of the functions times Gaussian densities."""
        step = means[:, :, None] - self.means[:, None]
        overlap = _log_density(step, covariances[:, :, None] + self.covariances[:, None])
        overlap = np.where(self.flat[:, None], 0.0, overlap)
        return log_sums(self.log_weights[:, None] + overlap)

    def moments(self, area: float, centre: ArrayLike) -> tuple[Array, Array]:
        """Return means `(n_parts, 2)` px and covariances `(n_parts, 2, 2)` px^2."""
        weights = self.log_weights + np.where(self.flat, np.log(area), 0.0)
        share = np.exp(weights - log_sums(weights)[:, None])
        means = np.where(self.flat[..., None], np.asarray(centre, np.float64), self.means)
        spreads = np.where(self.flat[..., None, None], area / 12 * np.eye(2), self.covariances)
        mean = (share[..., None] * means).sum(axis=1)
        apart = means - mean[:, None]
        scatter = spreads + apart[..., :, None] * apart[..., None, :]
        return mean, (share[..., None, None] * scatter).sum(axis=1)

    def _each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Self:
        """With all arrays changed alike."""
        return made(type(self), *(change(getattr(self, field.name)) for field in fields(self)))

    @classmethod
    def _joined(cls, mixtures: "Sequence[GaussianMixtures]", axis: int) -> Self:
        arrays = ([getattr(each, field.name) for each in mixtures] for field in fields(cls))
        return made(cls, *(np.concatenate(each, axis=axis) for each in arrays))

    def _filled(self, most: int) -> Self:
        """With fillers up to `most` components a part."""
        missing = most - self.log_weights.shape[1]
        n_parts = self.n_parts
        fillers = type(self)(
            np.full((n_parts, missing), -np.inf),
            np.zeros((n_parts, missing, 2)),
            np.broadcast_to(np.eye(2), (n_parts, missing, 2, 2)),
            np.zeros((n_parts, missing), np.bool_),
            np.full((n_parts, missing), NO_LABEL, np.int64),
        )
        return self._joined([self, fillers], 1)

    def _pruned(self) -> Self:
        """The heaviest components; flat ones stay, since their mass is without bound."""
        if self.log_weights.shape[1] <= MOST_COMPONENTS:
            return self
        rank = np.where(self.flat & np.isfinite(self.log_weights), np.inf, self.log_weights)
        kept = np.sort(np.argsort(-rank, axis=1, kind="stable")[:, :MOST_COMPONENTS], axis=1)
        return self._each(
            lambda values: np.take_along_axis(values, kept.reshape(*kept.shape, *(values.ndim - 2) * [1]), 1)
        )


def _log_density(steps: Array, covariances: Array) -> Array:
    """Logs of Gaussian densities in 2-D; leading axes are broadcast."""
    a, b, d = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    determinant = a * d - b * b
    x, y = steps[..., 0], steps[..., 1]
    quadratic = (d * x * x - 2 * b * x * y + a * y * y) / determinant
    return np.asarray(-LOG_TWO_PI - 0.5 * np.log(determinant) - 0.5 * quadratic)


def log_sums(values: Array, axis: int = -1) -> Array:
    """Return log sum exp of `values` along an axis; infinite where one is, minus infinity where all are.

    scipy's `logsumexp`, which does more, takes ten times as long for a few hundred numbers.
    """
    peaks = values.max(axis=axis, keepdims=True, initial=-np.inf)
    peaks[~np.isfinite(peaks)] = 0.0
    with np.errstate(divide="ignore", over="ignore"):
        sums = np.exp(values - peaks).sum(axis=axis)
        return np.asarray(np.log(sums) + peaks.squeeze(axis))


_BLOCK = 64  # points that are looked at together


@compiled
def sums_of_densities(points, heights, means, precisions, peaks, sums):
    """Sums over components of exp(height) times an unnormalised Gaussian, by their largest term.

    `points` are `(n, n_parts, 2)`, `heights` `(n_parts, m)` finite logs of the components' values in their
    middles, `means` `(n_parts, 2, m)`, and `precisions` `(n_parts, 3, m)` xx, xy and yy of half the inverse
    covariances, 0 of flat ones. `peaks` and `sums` `(n, n_parts)` get the log of the largest term, and all by
    it.
    """
    n_parts, m = heights.shape
    logs = np.empty(m)
    for part in range(n_parts):
        height = heights[part]
        mx, my = means[part, 0], means[part, 1]
        xx, xy, yy = precisions[part, 0], precisions[part, 1], precisions[part, 2]
        for k in range(len(points)):
            px, py = points[k, part, 0], points[k, part, 1]
            best = -1e300
            for j in range(m):
                x, y = px - mx[j], py - my[j]
                value = height[j] - (xx[j] * x + 2.0 * xy[j] * y) * x - yy[j] * y * y
                logs[j] = value
                best = max(best, value)
            total = 0.0
            for j in range(m):
                total += falling(logs[j] - best)
            peaks[k, part], sums[k, part] = best, total


@compiled
def sums_over_hypotheses(points, log_weights, heights, means, precisions, logs):
    """Log of a sum over hypotheses of the products of `sums_of_densities` of all parts, into `logs` `(n,)`.

    Points `(n, n_parts, 2)` are processed in blocks: loops over them are vector code, and all stays in the
    nearest cache. `log_weights` `(h,)` are finite; the rest is as of `sums_of_densities`, for the `n_parts`
    mixtures of each hypothesis, one after the other.
    """
    n_parts, m = points.shape[1], heights.shape[1]
    places = np.zeros((n_parts, 2, _BLOCK))
    values = np.empty((m, _BLOCK))
    peak, product, high, total = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    best, sums = np.empty(_BLOCK), np.empty(_BLOCK)
    for first in range(0, len(points), _BLOCK):
        count = min(_BLOCK, len(points) - first)
        for k in range(count):
            for part in range(n_parts):
                places[part, 0, k] = points[first + k, part, 0]
                places[part, 1, k] = points[first + k, part, 1]
        best[:], sums[:] = -1e300, 0.0
        for h in range(len(log_weights)):
            peak[:], product[:] = log_weights[h], 1.0
            for part in range(n_parts):
                row = h * n_parts + part
                px, py = places[part, 0], places[part, 1]
                high[:], total[:] = -1e300, 0.0
                for j in range(m):
                    height, mx, my = heights[row, j], means[row, 0, j], means[row, 1, j]
                    xx, xy, yy = precisions[row, 0, j], precisions[row, 1, j], precisions[row, 2, j]
                    value = values[j]
                    for k in range(_BLOCK):
                        x, y = px[k] - mx, py[k] - my
                        value[k] = height - (xx * x + 2.0 * xy * y) * x - yy * y * y
                        high[k] = max(high[k], value[k])
                for j in range(m):
                    value = values[j]
                    for k in range(_BLOCK):
                        total[k] += falling(value[k] - high[k])
                for k in range(_BLOCK):
                    peak[k] += high[k]
                    product[k] *= total[k]
            for k in range(_BLOCK):
                higher = max(best[k], peak[k])
                sums[k] = sums[k] * falling(best[k] - higher) + product[k] * falling(peak[k] - higher)
                best[k] = higher
        for k in range(count):
            logs[first + k] = best[k] + np.log(sums[k])


@compiled
def products(a_means, a_covariances, a_flat, b_means, b_covariances, b_flat, means, covariances, overlaps):
    """Products of each component of one mixture with each of another one.

    Written: `means` `(n_parts, n * m, 2)` and `covariances`, those of the other factor if one is flat, of the
    first if both are; `overlaps` `(n_parts, n * m)`, log of the integral of the product, 0 where a factor is
    flat.
    """
    n_parts, n = a_flat.shape
    m = b_flat.shape[1]
    for part in range(n_parts):
        for i in range(n):
            ax, ay = a_means[part, i, 0], a_means[part, i, 1]
            axx, ayy = a_covariances[part, i, 0, 0], a_covariances[part, i, 1, 1]
            axy = a_covariances[part, i, 0, 1]
            for j in range(m):
                bx, by = b_means[part, j, 0], b_means[part, j, 1]
                bxx, byy = b_covariances[part, j, 0, 0], b_covariances[part, j, 1, 1]
                bxy = b_covariances[part, j, 0, 1]
                overlap = 0.0
                if b_flat[part, j]:
                    x, y, xx, xy, yy = ax, ay, axx, axy, ayy
                elif a_flat[part, i]:
                    x, y, xx, xy, yy = bx, by, bxx, bxy, byy
                else:
                    cxx, cxy, cyy = axx + bxx, axy + bxy, ayy + byy
                    determinant = cxx * cyy - cxy * cxy
                    ixx, ixy, iyy = cyy / determinant, -cxy / determinant, cxx / determinant
                    dx, dy = bx - ax, by - ay
                    rx, ry = ixx * dx + ixy * dy, ixy * dx + iyy * dy
                    x, y = ax + axx * rx + axy * ry, ay + axy * rx + ayy * ry
                    # A (A + B)^-1 B as a sum of positive definite matrices, which rounding leaves so
                    of_a = (bxx * byy - bxy * bxy) / determinant
                    of_b = (axx * ayy - axy * axy) / determinant
                    xx, xy, yy = of_a * axx + of_b * bxx, of_a * axy + of_b * bxy, of_a * ayy + of_b * byy
                    overlap = -LOG_TWO_PI - 0.5 * np.log(determinant) - 0.5 * (rx * dx + ry * dy)
                place = i * m + j
                means[part, place, 0], means[part, place, 1] = x, y
                covariances[part, place, 0, 0], covariances[part, place, 0, 1] = xx, xy
                covariances[part, place, 1, 0], covariances[part, place, 1, 1] = xy, yy
                overlaps[part, place] = overlap

"""When does it pay to combine two chains? (§3.3 and Appendix A of the RSMCM paper.)

Two chains predict the same feature F ~ N(g, Sigma_0), which is then observed with noise Sigma_v. Predictions
are off by errors with second moments P_1, P_2 and P_12 = E[mu_1 mu_2^T]. The cost of a prediction is the KL
divergence from the right posterior to the one that it leads to, on average, in nats (eq. 16). Combining pays
exactly if C(q*) < min(C(q_1), C(q_2)).

With A = Sigma_0 + P_1, B = Sigma_0 + P_2, K = Sigma_0 + P_12 and Lemma 1's noises

    C(q_1) - C(q*) = log|I + D B^-1| / 2 - Tr((B + D)^-1 Q K),    D = (A^-1 + Sigma_v^-1)^-1,   Q = D A^-1,

and C(q_2) - C(q*) is the same with A and B exchanged and K transposed. So gains depend on Sigma_0 only
through A, B and K, which are what prediction errors show.

What the paper prints differently (checked by Monte Carlo in the tests):

- (13), (14): the means are g^_1 and g^_2, not g.
- (A.2), last line: the trace with (Sigma_1 + Sigma_v)^-1 is subtracted, not added. In the first form of
  C(q*) both traces have the wrong sign.
- (A.3) ends in an equation that does not hold; the derivative is half of
  S^-1 X S^-1 - (S + Sigma_v)^-1 X (S + Sigma_v)^-1 with S = Sigma_1 and X = S - Sigma_0 - P_1. It vanishes
  for X = 0 only; that this is the minimum follows from C(q_1) - C(q_1opt) being what observing through noise
  takes away from a KL divergence. Lemma 1 is right.
- (A.4): both costs lack the factor 1/2.
- Theorem 2 and eq. (17) are right as printed, and sufficient (Gamma_i seem asymmetric and are symmetric), but
  only with Lemma 1's noises and far from necessary. The remark on P_1 = P_12 misplaces a transpose:
  Gamma_1 = -Q (P_12 + Sigma_0) there. That the correlation must be less than 0.5 is true of (17) with
  Sigma_0 > 0, not of benefit: in one dimension products help up to a correlation of A, B, K of log 2 = 0.69.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..models.core.checks import Count, Shape, checked
from ..models.core.gaussian_message import squared_distances

Numbers = NDArray[np.float64]
Matrices = Annotated[Numbers, Shape(..., "d", "d", finite=False)]


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Second moments of two chains' errors (eq. 11) and of the noise about them (eq. 7).

    All are `(..., d, d)`, in squared units of the feature; leading axes are independent cases.

    Parameters
    ----------
    first, second, cross
        P_1, P_2 and P_12, mean mu mu^T of the errors of g. A bias counts as error.
    process
        Sigma_0, by which the feature differs from g; it cannot be predicted.
    observation
        Sigma_v.
    """

    first: Numbers
    second: Numbers
    cross: Numbers
    process: Numbers
    observation: Numbers

    @property
    def optimal_noises(self) -> tuple[Numbers, Numbers]:
        """Sigma_1 and Sigma_2 that minimise each chain's cost: Sigma_0 + P_i (Lemma 1)."""
        return self.process + self.first, self.process + self.second

    @property
    def swapped(self) -> "PredictionErrors":
        """The chains in the other order."""
        return PredictionErrors(
            self.second, self.first, transposed(self.cross), self.process, self.observation
        )

    @property
    def gains(self) -> tuple[Numbers, Numbers]:
        """C(q_1) - C(q*) and C(q_2) - C(q*) with Lemma 1's noises, `(...)` nats, for any Sigma_0."""
        first, second = (share - loss for share, loss in self._shares_and_losses())
        return first, second

    @property
    def critical_factor(self) -> Numbers:
        """`(...)`: factor of K above which the product is worse than the better chain; may be infinite."""
        with np.errstate(divide="ignore"):
            factors = [np.where(loss > 0, share / loss, np.inf) for share, loss in self._shares_and_losses()]
        return np.minimum(*factors)

    @property
    def gammas(self) -> tuple[Numbers, Numbers]:
        """Gamma_1 and Gamma_2 of Theorem 2, `(..., d, d)`.

        If both are positive semi-definite, the product with Lemma 1's noises is better than either chain:
        C(q_1) - C(q*) is a KL divergence plus Tr((B + D)^-1 Gamma_1) / 2. The converse does not hold.
        """

        def gamma(errors: PredictionErrors) -> Numbers:
            total = errors.process + errors.first
            weight = _of_the_observation(total, errors.observation)
            crossed = weight @ (errors.process + errors.cross)
            return symmetric(weight @ total - crossed - transposed(crossed))

        return gamma(self), gamma(self.swapped)

    @property
    def theorem_holds(self) -> NDArray[np.bool_]:
        """`(...)`: whether Theorem 2's condition is met; enough for benefit, but not needed for it."""
        meets = [np.linalg.eigvalsh(gamma)[..., 0] >= 0 for gamma in self.gammas]
        return np.logical_and(*meets)

    @property
    def correlation(self) -> Numbers:
        """`(...)` of the errors: Tr(Sigma_v^-1 K) over the root of Tr(Sigma_v^-1 A) Tr(Sigma_v^-1 B)."""
        first, second, both = (
            np.trace(_solve(self.observation, self.process + part), axis1=-2, axis2=-1)
            for part in (self.first, self.second, self.cross)
        )
        ratio: Numbers = both / np.sqrt(first * second)
        return ratio

    def _shares_and_losses(self) -> Iterator[tuple[Numbers, Numbers]]:
        """What the product gains by being surer, and loses by common errors, over either chain."""
        for errors in (self, self.swapped):
            first, second = errors.optimal_noises
            weight = _of_the_observation(first, errors.observation)
            sum_of_both = second + symmetric(weight @ first)
            share = 0.5 * (log_determinant(sum_of_both) - log_determinant(second))
            common = _solve(sum_of_both, weight @ (errors.process + errors.cross))
            yield share, np.trace(common, axis1=-2, axis2=-1)


@checked
def cost(stated: Matrices, error: Matrices, process: Matrices, observation: Matrices) -> Numbers:
    """Return C(q) of eq. (16) and (A.2), with corrected signs, `(...)` nats.

    `stated` is the noise Sigma_i of the prediction, `error` the second moment P_i of the error of its mean,
    `process` Sigma_0, `observation` Sigma_v; all `(..., d, d)`.
    """
    total, seen = process + error, stated + observation
    with np.errstate(divide="ignore"):
        logs = log_determinant(stated) - log_determinant(process)
    logs = logs - log_determinant(seen) + log_determinant(process + observation)
    traces = np.trace(_solve(stated, total), axis1=-2, axis2=-1)
    traces = traces - np.trace(_solve(seen, total + observation), axis1=-2, axis2=-1)
    half: Numbers = 0.5 * (logs + traces)
    return half


@checked
def product_of(first: Matrices, second: Matrices) -> tuple[Numbers, Numbers, Numbers]:
    """Return the covariance of two Gaussians' product and the weights of their means, all `(..., d, d)`."""
    of_first = transposed(_solve(first + second, second))
    return symmetric(of_first @ first), of_first, np.eye(first.shape[-1]) - of_first


def _solve(matrix: Numbers, right: Numbers) -> Numbers:
    return np.linalg.solve(matrix, right).astype(np.float64, copy=False)


def _of_the_observation(prediction: Numbers, observation: Numbers) -> Numbers:
    """Q = (I + A Sigma_v^-1)^-1."""
    return transposed(_solve(prediction + observation, observation))


def log_determinant(matrix: Numbers) -> Numbers:
    """Return log determinants `(...)` of `(..., d, d)`; minus infinity for a singular one."""
    value: Numbers = np.linalg.slogdet(matrix)[1]
    return value


def transposed(matrix: Numbers) -> Numbers:
    """Return the matrices with the last two axes exchanged."""
    return np.swapaxes(matrix, -1, -2)


def symmetric(matrix: Numbers) -> Numbers:
    """Return the symmetric part."""
    return 0.5 * (matrix + transposed(matrix))


Bounded = TypeVar("Bounded", float, Numbers)
Verdict = Literal["helps", "does not help", "not sure"]

LEAST_VARIANCE = 1e-6  # of prediction errors, as a share of the observation's: less is as good as none

FEWEST_GROUPS = 20
"""Below, no verdict: 95 % intervals of 12 groups hold the true gain in 88 %, of 40 in 90 to 94 %."""

CONFIDENCE = 0.95  # of all intervals
ENDS = (0.5 * (1 - CONFIDENCE), 0.5 * (1 + CONFIDENCE))
WEIGHTS_AT_ONCE = 1 << 20  # of the bootstrap, to keep memory small


@checked
@dataclass(frozen=True, eq=False)
class RecordedPredictions:
    """Two chains' predictions of the same feature, and what was then observed.

    Predictions must have been made without these observations. If the chains exchanged messages while they
    were recorded, their errors are more alike than without.

    Parameters
    ----------
    first, second, observed
        `(n, d)` means of the predictions of both chains, and observations.
    noise
        `(n, d, d)` covariance of the observation's noise (or one `(d, d)` for all).
    first_covariance, second_covariance
        `(n, d, d)` stated covariances of both chains, or `None` for both.

    Raises
    ------
    ValueError
        if shapes do not fit, something is not finite, or a covariance is not positive definite.
    """

    first: Numbers
    second: Numbers
    observed: Numbers
    noise: Numbers
    first_covariance: Numbers | None = None
    second_covariance: Numbers | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.observed)
        if len(shape) != 2 or not np.size(self.observed):
            raise ValueError(f"observed: got {shape}, expected (n, d) with a row at least")
        if (self.first_covariance is None) != (self.second_covariance is None):
            raise ValueError("first_covariance, second_covariance: got one of them, expected both or none")
        square = (*shape, shape[1])
        if np.shape(self.noise) == square[1:]:
            object.__setattr__(self, "noise", np.tile(self.noise, (shape[0], 1, 1)))
        for part in fields(self):
            given = getattr(self, part.name)
            if given is not None:
                array = np.asarray(given, np.float64)
                is_covariance = part.name.endswith(("noise", "covariance"))
                _check(part.name, array, square if is_covariance else shape)
                if is_covariance:
                    _check_positive(part.name, array)
                object.__setattr__(self, part.name, array)

    def __len__(self) -> int:
        return len(self.observed)

    def rows(self, chosen: NDArray[Any]) -> "RecordedPredictions":
        """Return some of the predictions, by number or by a mask."""
        arrays: dict[str, Any] = {part.name: getattr(self, part.name) for part in fields(self)}
        return replace(self, **{name: array[chosen] for name, array in arrays.items() if array is not None})


@dataclass(frozen=True)
class Interval(Generic[Bounded]):
    """An estimate and the ends of its 95 % interval."""

    estimate: Bounded
    low: Bounded
    high: Bounded

    def __format__(self, form: str) -> str:
        form = form or ".3g"
        return f"{self.estimate:{form}} ({self.low:{form}} to {self.high:{form}})"


@dataclass(frozen=True, eq=False)
class StatedComparison:
    """Measures of predictions with the covariances that the chains state.

    Parameters
    ----------
    nis_first, nis_second, nis_product
        normalised innovation squared, a dimension: 1 is consistent, more is overconfident, less is timid.
    score_gain
        nats by which the product's mean log density of the observed is above that of the better chain.
    gain
        C(q) of the better chain less that of the product, nats. Scores judge predictions of the observed,
        this the posterior once it is observed.
    """

    nis_first: Interval[float]
    nis_second: Interval[float]
    nis_product: Interval[float]
    score_gain: Interval[float]
    gain: Interval[float]


class Judged:
    """A gain, estimated from independent groups."""

    groups: int
    gain: Interval[float]

    @property
    def verdict(self) -> Verdict:
        """Whether combining pays, in a word."""
        if self.groups >= FEWEST_GROUPS and self.gain.low > 0:
            return "helps"
        return "does not help" if self.groups >= FEWEST_GROUPS and self.gain.high < 0 else "not sure"


@dataclass(frozen=True, eq=False)
class Comparison(Judged):
    """Whether combining two chains pays, from their recorded predictions.

    Parameters
    ----------
    count, groups
        how many predictions, in how many independent groups.
    first, second, cross
        `(d, d)`: P_1, P_2 and P_12 if all error is put down to the chains (Sigma_0 = 0). Any other Sigma_0
        is to be subtracted from each of the three; gains and verdict stay as they are.
    errors
        the same as a model, with the mean observation noise.
    rms_first, rms_second
        root mean squared error of each prediction, per coordinate, without the observation noise.
    correlation, critical_correlation
        of the errors, and the correlation above which the product is worse than the better chain; may be
        infinite.
    gain_first, gain_second, gain
        C(q_1) - C(q*) and C(q_2) - C(q*), nats, with Lemma 1's noises, and the smaller one: positive if the
        product is better than both.
    theorem_holds
        whether Theorem 2's sufficient condition is met by the estimates.
    stated
        comparison with the stated covariances; `None` if these were not recorded.
    """

    count: int
    groups: int
    first: Interval[Numbers]
    second: Interval[Numbers]
    cross: Interval[Numbers]
    errors: PredictionErrors
    rms_first: Interval[float]
    rms_second: Interval[float]
    correlation: Interval[float]
    critical_correlation: float
    gain_first: Interval[float]
    gain_second: Interval[float]
    gain: Interval[float]
    theorem_holds: bool
    stated: StatedComparison | None

    @property
    def reason(self) -> str:
        """Why, in a sentence."""
        critical, gain = self.critical_correlation, f"{self.gain:.2g} nats"
        errors = (
            f"Errors of {self.rms_first.estimate:.3g} and {self.rms_second.estimate:.3g} "
            f"correlate {self.correlation.estimate:.2f}"
        )
        limit = (
            f"combining helps below {critical:.2f}"
            if np.isfinite(critical)
            else "combining helps at any correlation"
        )
        if self.groups < FEWEST_GROUPS:
            return f"{errors}, gain {gain}, but only from {self.groups} independent groups"
        if self.verdict == "helps":
            return f"{errors} and {limit}: gain over the better chain {gain}"
        if self.verdict == "does not help":
            return f"{errors} and {limit}: the product is overconfident about common errors, gain {gain}"
        return f"{errors}, {limit}, and the gain may be positive or negative: {gain}"


@checked
def compare_predictions(
    recorded: RecordedPredictions,
    groups: ArrayLike,
    random: np.random.Generator | None = None,
    resamples: Count = 1000,
) -> Comparison:
    """Compare the product of two chains with the better one, from recorded predictions.

    Parameters
    ----------
    recorded
        the predictions.
    groups
        `(n,)` integers: errors in one group (a track, or an interval of frames) may be correlated, different
        groups are independent. Whole groups are resampled.
    random, resamples
        of the bootstrap; seeded with 0 if not given.

    Raises
    ------
    ValueError
        if there is not one group a row, or fewer than two groups.
    """
    labels = np.asarray(groups)
    count, d = recorded.observed.shape
    if labels.shape != (count,):
        raise ValueError(f"groups: got {labels.shape} for {count} predictions, expected ({count},)")
    random = np.random.default_rng(0) if random is None else random
    of_first, of_second = recorded.observed - recorded.first, recorded.observed - recorded.second
    both = np.hstack([of_first, of_second])
    columns = [(both[:, :, None] * both[:, None, :]).reshape(count, -1), recorded.noise.reshape(count, -1)]
    if recorded.first_covariance is not None and recorded.second_covariance is not None:
        covariances = recorded.first_covariance, recorded.second_covariance
        columns.append(_measures_as_stated(of_first, of_second, *covariances, recorded.noise))
    sums = group_sums(np.hstack(columns), labels)
    moments, noise, as_stated = np.split(sums.resampled(random, resamples), [4 * d**2, 5 * d**2], axis=1)
    errors = _without_noise(moments.reshape(-1, 2 * d, 2 * d), noise.reshape(-1, d, d))
    gain_first, gain_second = errors.gains
    correlation, factor = errors.correlation, float(errors.critical_factor[0])
    estimate = float(correlation[0])
    critical = estimate * factor if estimate > 0 and math.isfinite(factor) else math.inf
    return Comparison(
        count=count,
        groups=sums.count,
        first=_interval_of_matrices(errors.first),
        second=_interval_of_matrices(errors.second),
        cross=_interval_of_matrices(errors.cross),
        errors=PredictionErrors(*(getattr(errors, part.name)[0] for part in fields(errors))),
        rms_first=interval_of(_rms(errors.first)),
        rms_second=interval_of(_rms(errors.second)),
        correlation=interval_of(correlation),
        critical_correlation=critical,
        gain_first=interval_of(gain_first),
        gain_second=interval_of(gain_second),
        gain=interval_of(np.minimum(gain_first, gain_second)),
        theorem_holds=bool(errors.theorem_holds[0]),
        stated=_summarised(as_stated) if as_stated.size else None,
    )


@dataclass(frozen=True, eq=False)
class GroupSums:
    """Sums over the rows of each group, `(count, k)`, and how many rows that were, `(count,)`."""

    sums: Numbers
    rows: Numbers

    @property
    def count(self) -> int:
        """How many groups."""
        return len(self.rows)

    def resampled(self, random: np.random.Generator, resamples: int) -> Numbers:
        """Return `(1 + resamples, k)` means over all rows, and over the rows of resampled groups."""
        table = np.column_stack([self.rows, self.sums])
        totals = [table.sum(axis=0, keepdims=True)]
        at_once = max(1, WEIGHTS_AT_ONCE // self.count)
        for start in range(0, resamples, at_once):
            size = min(at_once, resamples - start)
            drawn = random.integers(self.count, size=(size, self.count))
            drawn += self.count * np.arange(size)[:, None]
            times = np.bincount(drawn.ravel(), minlength=size * self.count).reshape(size, self.count)
            totals.append(times @ table)
        total = np.concatenate(totals)
        means: Numbers = total[:, 1:] / total[:, :1]
        return means


def group_sums(values: Numbers, labels: NDArray[np.generic]) -> GroupSums:
    """Return sums of `values` `(n, k)` over rows of each label `(n,)`; a `ValueError` for fewer than two."""
    _, place, rows = np.unique(labels, return_inverse=True, return_counts=True)
    if len(rows) < 2:
        raise ValueError(f"groups: got {len(rows)} of {len(labels)} rows, expected two or more")
    order = np.argsort(place, kind="stable")
    starts = np.concatenate([[0], np.cumsum(rows)[:-1]])
    return GroupSums(np.add.reduceat(values[order], starts, axis=0), rows.astype(np.float64))


def _without_noise(moments: Numbers, noise: Numbers) -> PredictionErrors:
    """A, B, K from the moments `(m, 2 d, 2 d)` of both errors; negative eigenvalues are chance."""
    d = noise.shape[-1]
    root: Numbers = np.linalg.cholesky(noise).astype(np.float64, copy=False)
    both = np.zeros_like(moments)
    both[:, :d, :d] = both[:, d:, d:] = np.linalg.inv(root)
    whitened = both @ moments @ transposed(both) - np.tile(np.eye(d), (2, 2))
    values, vectors = np.linalg.eigh(symmetric(whitened))
    possible = (vectors * np.maximum(values, LEAST_VARIANCE)[:, None, :]) @ transposed(vectors)
    first, second, cross = (
        root @ part @ transposed(root)
        for part in (possible[:, :d, :d], possible[:, d:, d:], possible[:, :d, d:])
    )
    return PredictionErrors(symmetric(first), symmetric(second), cross, np.zeros_like(noise), noise)


def _measures_as_stated(
    error: Numbers, other: Numbers, covariance: Numbers, other_covariance: Numbers, noise: Numbers
) -> Numbers:
    """`(n, 9)`: squared error over stated, log score, cost but for a constant; of both and product."""
    covariance_of_both, of_first, of_second = product_of(covariance, other_covariance)
    combined = (of_first @ error[:, :, None] + of_second @ other[:, :, None])[:, :, 0]
    d = error.shape[1]
    cases = ((error, covariance), (other, other_covariance), (combined, covariance_of_both))
    squares, scores, costs = [], [], []
    for off, stated in cases:
        predicted = stated + noise
        square = squared_distances(off, predicted)
        log_size = log_determinant(predicted)
        of_feature = squared_distances(off, stated)
        of_feature -= np.trace(np.linalg.solve(stated, noise), axis1=1, axis2=2)
        squares.append(square / d)
        scores.append(-0.5 * (d * np.log(2 * np.pi) + log_size + square))
        costs.append(0.5 * (log_determinant(stated) - log_size + of_feature - square))
    return np.column_stack([*squares, *scores, *costs])


def _summarised(means: Numbers) -> StatedComparison:
    scores, costs = means[:, 3:6], means[:, 6:9]
    better_score = np.maximum(scores[:, 0], scores[:, 1])
    better_cost = np.minimum(costs[:, 0], costs[:, 1])
    gains = scores[:, 2] - better_score, better_cost - costs[:, 2]
    return StatedComparison(*map(interval_of, [*means[:, :3].T, *gains]))


def interval_of(samples: Numbers) -> Interval[float]:
    """Return the first of the samples, with quantiles of the others."""
    low, high = np.quantile(samples[1:], ENDS)
    return Interval(float(samples[0]), float(low), float(high))


def _interval_of_matrices(samples: Numbers) -> Interval[Numbers]:
    low, high = np.quantile(samples[1:], ENDS, axis=0)
    return Interval(samples[0], low, high)


def _rms(moment: Numbers) -> Numbers:
    mean: Numbers = np.trace(moment, axis1=-2, axis2=-1) / moment.shape[-1]
    return np.sqrt(mean)


def _check(name: str, array: Numbers, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"{name}: got {array.shape}, expected {shape}")
    finite = np.isfinite(array).reshape(len(array), -1).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ValueError(f"{name}: got {array[row].tolist()} in row {row}, expected finite numbers")


def _check_positive(name: str, covariances: Numbers) -> None:
    if not np.allclose(covariances, transposed(covariances)):
        raise ValueError(f"{name}: got one that is not symmetric, expected all to be")
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        raise ValueError(f"{name}: got one that is not positive definite, expected all to be") from None


@dataclass(frozen=True, eq=False)
class ScoreComparison(Judged):
    """Whether combining two chains pays, from log densities of both and of their product.

    Parameters
    ----------
    count, groups
        how many rows, in how many independent groups.
    first, second, product
        mean log densities of what was observed, nats.
    gain
        that of the product less the larger one of the chains'; positive means that combining pays.
    """

    count: int
    groups: int
    first: Interval[float]
    second: Interval[float]
    product: Interval[float]
    gain: Interval[float]

    @property
    def reason(self) -> str:
        """Why, in a sentence."""
        few = f", but only from {self.groups} independent groups" if self.groups < FEWEST_GROUPS else ""
        return f"The product scores {self.gain:.2g} nats above the better chain{few}"


@checked
def compare_scores(
    scores: Annotated[Numbers, Shape("n", 3)],
    groups: Annotated[ArrayLike, Shape("n")],
    resamples: Count = 1000,
) -> ScoreComparison:
    """Compare the product of two chains with the better one, from log densities; see `compare_predictions`.

    `scores` are `(n, 3)` nats: of what was observed under the first chain's prediction, the second's, their
    product.

    Raises
    ------
    ValueError
        if the shapes do not fit, a score is not finite, or there are fewer than two groups.
    """
    labels = np.asarray(groups)
    sums = group_sums(scores, labels)
    means = sums.resampled(np.random.default_rng(0), resamples)
    gain = means[:, 2] - np.maximum(means[:, 0], means[:, 1])
    first, second, product = (interval_of(each) for each in means.T)
    return ScoreComparison(len(scores), sums.count, first, second, product, interval_of(gain))

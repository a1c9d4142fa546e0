"""When does it pay to combine two chains? (§3.3 and Appendix A of the RSMCM paper.)

Two chains predict the same feature F ~ N(g, Sigma_0), which is then observed with noise Sigma_v. Predictions
are off by errors with second moments P_1, P_2 and P_12 = E[mu_1 mu_2^T]. The cost of a prediction is the KL
divergence from the right posterior to the one that it leads to, on average, in nats (eq. 16). Combining pays
exactly if C(q*) < min(C(q_1), C(q_2)); every verdict here rests on that.

With A = Sigma_0 + P_1, B = Sigma_0 + P_2, K = Sigma_0 + P_12 and Lemma 1's noises, all terms of the product's
cost that do not cancel leave

    C(q_1) - C(q*) = log|I + D B^-1| / 2 - Tr((B + D)^-1 Q K),    D = (A^-1 + Sigma_v^-1)^-1,   Q = D A^-1,

and C(q_2) - C(q*) is the same with A and B exchanged and K transposed. So gains depend on Sigma_0 only
through A, B and K, which are what prediction errors show; they need no guess of Sigma_0.

What the paper prints differently (all of it checked by Monte Carlo in the tests):

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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Costs:
    """Costs of either chain and of their product, nats, each `(...)`."""

    first: Numbers
    second: Numbers
    product: Numbers

    @property
    def gain(self) -> Numbers:
        """What the product saves over the better one of the chains; positive where combining pays."""
        better: Numbers = np.minimum(self.first, self.second)
        return better - self.product


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Second moments of two chains' errors (eq. 11) and of the noise about them (eq. 7).

    All are `(..., d, d)`, in squared units of the feature; leading axes are independent cases.

    Parameters
    ----------
    first, second
        P_1 and P_2, mean mu mu^T of either chain's error of g. A bias counts as error.
    cross
        P_12, mean mu_1 mu_2^T.
    process
        Sigma_0, by which the feature differs from g, which nobody can predict.
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

    def costs(self, noises: tuple[Numbers, Numbers] | None = None) -> Costs:
        """C(q_1), C(q_2), C(q*) of eq. (16); infinite where Sigma_0 is singular.

        Parameters
        ----------
        noises
            Sigma_1 and Sigma_2, `(..., d, d)`, which the chains state; Lemma 1's if not given.
        """
        first, second = self.optimal_noises if noises is None else noises
        noise, of_first, of_second = product_of(first, second)
        crossed = of_first @ self.cross @ transposed(of_second)
        error = (
            of_first @ self.first @ transposed(of_first)
            + of_second @ self.second @ transposed(of_second)
            + crossed
            + transposed(crossed)
        )
        return Costs(
            cost(first, self.first, self.process, self.observation),
            cost(second, self.second, self.process, self.observation),
            cost(noise, error, self.process, self.observation),
        )

    @property
    def gains(self) -> tuple[Numbers, Numbers]:
        """C(q_1) - C(q*) and C(q_2) - C(q*) with Lemma 1's noises, `(...)` nats, for any Sigma_0."""
        shares, losses = self._shares_and_losses()
        return shares[0] - losses[0], shares[1] - losses[1]

    @property
    def bearable(self) -> Numbers:
        """`(...)`: by what factor K = Sigma_0 + P_12 could grow before combining stops paying; 1 is the edge.

        Infinite where errors are not correlated, or so that they cancel.
        """
        shares, losses = self._shares_and_losses()
        pairs = zip(shares, losses, strict=True)
        with np.errstate(divide="ignore"):
            factors = [np.where(loss > 0, share / loss, np.inf) for share, loss in pairs]
        smaller: Numbers = np.minimum(*factors)
        return smaller

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
        both: NDArray[np.bool_] = np.logical_and(*meets)
        return both

    @property
    def correlation(self) -> Numbers:
        """`(...)`: of the errors A, B, K, taken in units of the observation noise.

        Tr(Sigma_v^-1 K) over the root of Tr(Sigma_v^-1 A) Tr(Sigma_v^-1 B), which no linear change of the
        feature's coordinates alters. Without noise of its own (Sigma_0 = 0) it is that of P_1, P_2, P_12.
        """
        first, second, both = (
            np.trace(_solve(self.observation, self.process + part), axis1=-2, axis2=-1)
            for part in (self.first, self.second, self.cross)
        )
        ratio: Numbers = both / np.sqrt(first * second)
        return ratio

    def _shares_and_losses(self) -> tuple[tuple[Numbers, Numbers], tuple[Numbers, Numbers]]:
        """What the product gains by being surer, and what it loses by common errors, over either chain."""

        def parts(errors: PredictionErrors) -> tuple[Numbers, Numbers]:
            first, second = errors.optimal_noises
            weight = _of_the_observation(first, errors.observation)
            posterior = symmetric(weight @ first)
            sum_of_both = second + posterior
            share = 0.5 * (log_determinant(sum_of_both) - log_determinant(second))
            common = _solve(sum_of_both, weight @ (errors.process + errors.cross))
            return share, np.trace(common, axis1=-2, axis2=-1)

        (share, loss), (other_share, other_loss) = parts(self), parts(self.swapped)
        return (share, other_share), (loss, other_loss)


def cost(stated: Numbers, error: Numbers, process: Numbers, observation: Numbers) -> Numbers:
    """C(q), eq. (16) and (A.2) with its signs put right, `(...)` nats.

    Parameters
    ----------
    stated
        `(..., d, d)`, the noise Sigma_i of the prediction.
    error
        `(..., d, d)`, second moment P_i of what its mean is off by.
    process, observation
        `(..., d, d)`, Sigma_0 and Sigma_v.
    """
    total, seen = process + error, stated + observation
    with np.errstate(divide="ignore"):
        logs = log_determinant(stated) - log_determinant(process)
    logs = logs - log_determinant(seen) + log_determinant(process + observation)
    traces = np.trace(_solve(stated, total), axis1=-2, axis2=-1)
    traces = traces - np.trace(_solve(seen, total + observation), axis1=-2, axis2=-1)
    half: Numbers = 0.5 * (logs + traces)
    return half


def product_of(first: Numbers, second: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Covariance of the product of two Gaussians, and the weights of their means in its mean.

    All are `(..., d, d)`.
    """
    of_first = transposed(_solve(first + second, second))
    return symmetric(of_first @ first), of_first, np.eye(first.shape[-1]) - of_first


def _solve(matrix: Numbers, right: Numbers) -> Numbers:
    return np.linalg.solve(matrix, right).astype(np.float64, copy=False)


def _of_the_observation(prediction: Numbers, observation: Numbers) -> Numbers:
    """Q = (I + A Sigma_v^-1)^-1."""
    return transposed(_solve(prediction + observation, observation))


def log_determinant(matrix: Numbers) -> Numbers:
    """`(...)`, of `(..., d, d)`; minus infinity for a singular one."""
    value: Numbers = np.linalg.slogdet(matrix)[1]
    return value


def transposed(matrix: Numbers) -> Numbers:
    """The last two axes exchanged."""
    return np.swapaxes(matrix, -1, -2)


def symmetric(matrix: Numbers) -> Numbers:
    """The symmetric part; takes rounding off."""
    return 0.5 * (matrix + transposed(matrix))

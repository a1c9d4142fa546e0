"""Noise with heavy tails: Student's t of two coordinates at once, by which outliers lose their weight."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ....models.core.short_repr import short_repr
from ..factor_analysis.observations import Numbers

HEAVIEST, LIGHTEST = 3.0, 100.0
"""Degrees of freedom that are considered: Cauchy's distribution, and one that is as good as normal."""

HARDLY = 0.1
"""Share of its weight that is left to an outlier; with the heaviest tails it is reached at 5 deviations."""

LEAST_VARIANCE = 1e-8
"""px^2, below which rounding decides."""

MOST_ROUNDS = 50
ACCURACY = 1e-4
"""Of the logarithm of the variance."""


@short_repr
@dataclass(frozen=True)
class StudentNoise:
    """Errors of positions in two coordinates.

    With d the distance in px and g the weight of the observation, the density is

        g / (2 pi s^2) (1 + g d^2 / (nu s^2))^(-(nu + 2) / 2).

    Parameters
    ----------
    variance
        s^2, px^2 at weight 1: of an error that is no outlier.
    freedom
        nu; large where the errors are normal.
    """

    variance: float
    freedom: float

    @classmethod
    def of_errors(cls, squares: Numbers, weight: Numbers) -> "StudentNoise":
        """The noise under which errors are likeliest.

        Parameters
        ----------
        squares
            `(n,)` squared distances, px^2.
        weight
            `(n,)` 1 / relative variance of the observations.
        """
        middle = float(np.median(weight * squares))

        def of_freedom(log_freedom: float) -> "StudentNoise":
            freedom = float(np.exp(log_freedom))
            # the median of d^2 is nu s^2 (2^(2 / nu) - 1)
            start = cls(max(middle / (freedom * (2 ** (2 / freedom) - 1)), LEAST_VARIANCE), freedom)
            return start.rescaled(squares, weight)

        found = minimize_scalar(
            lambda at: -of_freedom(at).log_likelihood(squares, weight),
            bounds=(np.log(HEAVIEST), np.log(LIGHTEST)),
            method="bounded",
            options={"xatol": 0.05},
        )
        return of_freedom(float(found.x))

    def rescaled(self, squares: Numbers, weight: Numbers) -> "StudentNoise":
        """The likeliest variance for these degrees of freedom, by EM; arguments as of `of_errors`."""
        weighted, variance = weight * squares, self.variance
        for _ in range(MOST_ROUNDS):
            shares = (self.freedom + 2) / (self.freedom + weighted / variance)
            better = max(float(np.mean(shares * weighted)) / 2, LEAST_VARIANCE)
            change, variance = abs(math.log(better / variance)), better
            if change < ACCURACY:
                break
        return replace(self, variance=variance)

    def weights(self, squares: Numbers, weight: Numbers) -> Numbers:
        """What each observation counts in least squares `(n,)`: `weight` less what makes it an outlier."""
        result: Numbers = weight * (self.freedom + 2) / (self.freedom + weight * squares / self.variance)
        return result

    def agrees(self, squares: Numbers, weight: Numbers) -> NDArray[np.bool_]:
        """Whether an observation is no outlier: it counts for `HARDLY` or more of one that fits."""
        agreeing: NDArray[np.bool_] = weight * squares <= (1 / HARDLY - 1) * self.freedom * self.variance
        return agreeing

    def log_likelihood(self, squares: Numbers, weight: Numbers) -> float:
        """Log density of errors `(n,)` px^2."""
        unlikely = np.log1p(weight * squares / (self.freedom * self.variance)).sum()
        scale = len(squares) * np.log(2 * np.pi * self.variance) - np.log(weight).sum()
        return -float(scale + 0.5 * (self.freedom + 2) * unlikely)

    def precision(self, squares: Numbers, weight: Numbers, parameters: float) -> float:
        """Information, 1/px^2, that a coordinate of weight 1 gives about where it should be.

        By Huber's formula for M-estimators ("Robust Statistics", 1981, section 7.6): with psi the derivative
        of minus the log density by a coordinate it is mean(psi')^2 / mean(psi^2), here times what is left of
        the observations when `parameters` numbers have been fitted to them.
        """
        ratio = weight * squares / self.variance
        share = (self.freedom + 2) / (self.freedom + ratio)
        pull = share**2 * ratio / 2
        slope = share - (self.freedom + 2) * ratio / (self.freedom + ratio) ** 2
        left = max(1 - parameters / (2 * len(squares)), 1 / (2 * len(squares)))
        return float(np.mean(slope)) ** 2 / max(float(np.mean(pull)), 1e-300) * left / self.variance

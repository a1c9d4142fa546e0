"""Shape and cameras from positions of which some are wrong: a mixture of right ones and of outliers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from .factorisation import Factorisation, factorise
from .observations import Indices, Numbers

MOST_ROUNDS = 20
SETTLED = 0.002
"""Mean change of the probabilities of being right with which the rounds end."""

ITERATIONS = 50
"""Of EM in a round: the next one goes on from there."""

FAREST = 25.0
"""Variance of outliers over that of right positions, at the least: closer ones are noise, and are needed."""

LEAST_FREE = 0.02
"""Share of an observation that its own point leaves free, at the least: of less, rounding decides."""

FIRST_ROUNDS = 3
"""In which the variance of right positions is that of their median: the mean is still that of outliers."""

FIRST_SHARE, LEAST_SHARE, MOST_SHARE = 0.05, 1e-4, 0.5
"""Of outliers, to begin with and within which it is learned: where most are wrong, nobody knows what is right."""

ROUNDING, TINY = 1e-12, 1e-300
"""Of the largest square, and absolutely: the least variance, for positions without noise."""

MEDIAN = 2 * float(np.log(2))
"""Of the squared length of a vector of two standard normal numbers."""

TRUSTED = 0.5
"""Probability from which a position is taken to be right."""


@dataclass(frozen=True, eq=False)
class RobustFactorisation:
    """Cameras and shape, and which positions they were found from.

    Parameters
    ----------
    factorisation
        as of `factorise` with the weights `weights`.
    weights
        `(n_frames, n_points)`: those that were given, less where a position is likely wrong.
    right
        `(n_frames, n_points)`, probability that a position is right; 0 where nothing was seen.
    """

    factorisation: Factorisation
    weights: Numbers
    right: Numbers

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """`(n_frames, n_points)`: positions that are more likely right than not."""
        return np.asarray(self.right > TRUSTED)

    @property
    def consistent(self) -> NDArray[np.bool_]:
        """`(n_points,)`: points of which more positions are right than wrong."""
        return np.asarray(2 * self.trusted.sum(axis=0) > (self.weights > 0).sum(axis=0))


def factorise_robustly(
    positions: ArrayLike, weights: ArrayLike | None = None, *, coherence: bool = False
) -> RobustFactorisation:
    """Find cameras and shape where some positions are wrong.

    A position is right with a probability that is learned, and then off by noise of its weight; or else it
    is an outlier, off by noise of a larger variance that is learned as well: a contaminated normal (Tukey,
    "A survey of sampling from contaminated distributions", 1960), by EM. Probabilities come from what
    `factorise` leaves, and make the weights of the next `factorise`. Where nothing is wrong all of them are
    near 1, and the result is that of `factorise`.

    What is left of a position counts in parts of what its point's other positions leave open: of a mismatch
    in a track of two frames three quarters go into the point.

    Parameters
    ----------
    positions, weights, coherence
        as of `factorise`.

    Raises
    ------
    ValueError
        as `factorise` does.
    """
    where = np.asarray(positions, np.float64)
    given = np.asarray(~np.isnan(where).any(axis=2) if weights is None else weights, np.float64)
    fit = _roughly(where, given, coherence, "grow")
    seen = np.nonzero(given > 0)
    right, weight = np.where(given > 0, 1.0, 0.0), given.copy()
    share, outlying = FIRST_SHARE, 0.0
    for number in range(MOST_ROUNDS):
        squares = given[seen] * _free_squares(fit, where[seen], weight[seen], seen)
        before = right[seen]
        noise = _noise(squares, before, first=number < FIRST_ROUNDS)
        wrong = 1 - before
        learned = (
            float(wrong @ squares) / (2 * float(wrong.sum())) if wrong.any() else float(squares.mean()) / 2
        )
        outlying = max(learned, FAREST * noise)
        odds = np.log(1 / share - 1) + np.log(outlying / noise) - squares / 2 * (1 / noise - 1 / outlying)
        right[seen] = expit(odds)
        weight[seen] = given[seen] * (right[seen] + (1 - right[seen]) * noise / outlying)
        share = float(np.clip(1 - right[seen].mean(), LEAST_SHARE, MOST_SHARE))
        if np.abs(right[seen] - before).mean() < SETTLED:
            break
        fit = _roughly(where, weight, coherence, fit)
    return RobustFactorisation(factorise(where, weight, coherence=coherence, start=fit), weight, right)


def _roughly(
    where: Numbers, weights: Numbers, coherence: bool, start: Literal["grow"] | Factorisation
) -> Factorisation:
    """A few steps of EM: variable projection would follow outliers to far places."""
    return factorise(
        where, weights, coherence=coherence, start=start, polish=coherence, iterations=ITERATIONS
    )


def _noise(squares: Numbers, right: Numbers, *, first: bool) -> float:
    """Variance of right positions, in the unit of the squares."""
    if first:
        variance = float(np.median(squares[right > TRUSTED])) / MEDIAN
    else:
        variance = float(right @ squares) / (2 * float(right.sum()))
    return max(variance, ROUNDING * float(squares.max()), TINY)


def _free_squares(
    fit: Factorisation, where: Numbers, weights: Numbers, seen: tuple[Indices, Indices]
) -> Numbers:
    """Squared distances `(n,)` px^2 of positions from the fit, over the share that their points leave free."""
    frames, points = seen
    cameras = fit.cameras[frames]
    rows = cameras[..., :3]
    off = where - np.einsum("ncj,nj->nc", rows, fit.shape[points]) - cameras[..., 3]
    spread = np.einsum("ncj,njk,nck->n", rows, fit.shape_covariance[points], rows, optimize=True)
    free = 1 - 0.5 * weights * spread / fit.noise_variance
    squares: Numbers = np.square(off).sum(axis=1) / np.maximum(free, LEAST_FREE)
    return squares

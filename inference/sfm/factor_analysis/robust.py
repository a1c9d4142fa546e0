"""Shape and cameras from positions of which some are wrong: a mixture of right ones and of outliers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from .factorisation import Factorisation, factorise
from .observations import Indices, Numbers, as_arrays

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

FIRST_SHARE, LEAST_SHARE, MOST_SHARE = 0.05, 1e-4, 0.2
"""Of outliers: to begin with, at the least, and at most. Where more do not fit, the camera is not affine (a
plane seen from near leaves its corners over), and nothing is an outlier."""

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
    where, given = as_arrays(positions, weights)
    fit = _roughly(where, given, coherence, "grow")
    frames, points = np.nonzero(given > 0)
    seen: tuple[Indices, Indices] = frames.astype(np.int64), points.astype(np.int64)
    numbers = np.count_nonzero(~np.isnan(where[seen]), axis=1)
    right, weight = np.where(given > 0, 1.0, 0.0), given.copy()
    share, renewed = FIRST_SHARE, False
    for number in range(MOST_ROUNDS):
        squares: Numbers = given[seen] * _free_squares(fit, where[seen], weight[seen], seen)
        before = right[seen]
        noise = _noise(squares, before, numbers, first=number < FIRST_ROUNDS)
        wrong = 1 - before
        learned = (
            float(wrong @ squares) / float((wrong * numbers).sum())
            if wrong.any()
            else float(squares.mean() / numbers.mean())
        )
        outlying = max(learned, FAREST * noise)
        odds = (
            np.log(1 / min(share, 0.5) - 1)
            + numbers / 2 * np.log(outlying / noise)
            - squares / 2 * (1 / noise - 1 / outlying)
        )
        right[seen] = expit(odds)
        weight[seen] = given[seen] * (right[seen] + (1 - right[seen]) * noise / outlying)
        share = max(float(1 - right[seen].mean()), LEAST_SHARE)
        settled = bool(np.abs(right[seen] - before).mean() < SETTLED)
        fit = _roughly(where, weight, coherence, fit)
        if settled and renewed:
            break
        if settled or number == FIRST_ROUNDS:
            # where to begin was chosen among outliers, which may have led astray
            fit, renewed = _renewed(where, np.where(right > TRUSTED, weight, 0.0), coherence, fit), True
    if share > MOST_SHARE:
        right[seen], weight = 1.0, given
    return RobustFactorisation(factorise(where, weight, coherence=coherence, start=fit), weight, right)


def _roughly(
    where: Numbers, weights: Numbers, coherence: bool, start: Literal["grow"] | Factorisation
) -> Factorisation:
    """A few steps of EM: variable projection would follow outliers to far places."""
    return factorise(
        where, weights, coherence=coherence, start=start, polish=coherence, iterations=ITERATIONS
    )


def _renewed(where: Numbers, weights: Numbers, coherence: bool, fit: Factorisation) -> Factorisation:
    """The better one of a fit and of that which is grown from positions that are trusted."""
    try:
        anew = _roughly(where, weights, coherence, "grow")
    except ValueError:  # they are too few, or fall apart
        return fit
    return min(fit, anew, key=lambda each: each.noise_variance)


def _noise(squares: Numbers, right: Numbers, numbers: Indices, *, first: bool) -> float:
    """Variance of right positions, in the unit of the squares, of each the sum over so many numbers."""
    if first:
        variance = float(np.median(squares[(right > TRUSTED) & (numbers == numbers.max())])) / MEDIAN
    else:
        variance = float(right @ squares) / float((right * numbers).sum())
    return max(variance, ROUNDING * float(squares.max()), TINY)


def _free_squares(
    fit: Factorisation, where: Numbers, weights: Numbers, seen: tuple[Indices, Indices]
) -> Numbers:
    """Squared distances `(n,)` px^2 of positions from the fit, over what their points leave free."""
    frames, points = seen
    cameras = fit.cameras[frames]
    rows = cameras[..., :3]
    known = ~np.isnan(where)
    off = np.where(known, where - np.einsum("ncj,nj->nc", rows, fit.shape[points]) - cameras[..., 3], 0)
    rows = rows * known[..., None]
    spread = np.einsum("ncj,njk,nck->n", rows, fit.shape_covariance[points], rows, optimize=True)
    free = 1 - weights * spread / (np.count_nonzero(known, axis=1) * fit.noise_variance)
    squares: Numbers = np.square(off).sum(axis=1) / np.maximum(free, LEAST_FREE)
    return squares

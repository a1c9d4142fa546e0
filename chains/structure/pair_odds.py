"""How often pairs of points that were never seen together are one point."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

Numbers = NDArray[np.float64]

MOST_SHARE, LEAST_SHARE, SHARE_STEPS = 0.1, 1e-9, 50
"""Of pairs that are at one place: at most, and to begin with; at the least; steps of EM."""


def log_odds_of_new(gains: Numbers, apart: NDArray[np.bool_]) -> float:
    """Log prior odds that a pair of points is two and not one.

    Which share of the pairs is at one place is learned by EM. Different points may be there, too, more often
    than if they were draws from a Gaussian, as on surfaces: as often as pairs that are two for sure.

    Parameters
    ----------
    gains
        `(n_pairs,)`, log of how much likelier a pair is if it is at one place than if it is not.
    apart
        `(n_pairs,)`, whether it is two points for sure.
    """
    share = max(_share_in_one_place(gains[~apart]) - _share_in_one_place(gains[apart]), LEAST_SHARE)
    return float(np.log((1 - share) / share))


def _share_in_one_place(gains: Numbers) -> float:
    share = MOST_SHARE if len(gains) else 0.0
    for _ in range(SHARE_STEPS):
        if share <= LEAST_SHARE:
            break
        share = min(float(expit(gains + np.log(share / (1 - share))).mean()), MOST_SHARE)
    return share

"""Mahalanobis distances: how far things are from where they should be, in units of what is known of that."""

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


def squared_distances(off: Numbers, covariance: Numbers) -> Numbers:
    """Squared distances `(...)` of vectors `(..., d)` from 0, by covariances `(..., d, d)`."""
    distances: Numbers = (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1)
    return distances

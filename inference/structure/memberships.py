"""Which tracks show which points, as sparse matrices of probabilities."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]


def certain(point: Indices, n_points: int) -> csr_array:
    """Memberships `(n_tracks, n_points)` of tracks that show a point for sure, or none where it is -1."""
    shown = point >= 0
    edges = np.concatenate([[0], np.cumsum(shown)])
    return csr_array((np.ones(edges[-1]), point[shown], edges), shape=(len(point), n_points))


def pooled(membership: csr_array, values: Numbers) -> Numbers:
    """Sums `(n_points, ...)` over tracks of what each of them says, `(n_tracks, ...)`, by memberships."""
    sums = np.asarray(membership.T @ values.reshape(len(values), -1), np.float64)
    return sums.reshape(membership.shape[1], *values.shape[1:])

"""Which tracks show which points, as sparse matrices of probabilities."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

LEAST_WEIGHT = 1e-3
"""Of a position that is pooled from tracks: less is none."""


def certain(point: Indices, n_points: int) -> csr_array:
    """Memberships `(n_tracks, n_points)` of tracks that show a point for sure, or none where it is -1."""
    shown = point >= 0
    edges = np.concatenate([[0], np.cumsum(shown)])
    return csr_array((np.ones(edges[-1]), point[shown], edges), shape=(len(point), n_points))


def pooled(membership: csr_array, values: Numbers) -> Numbers:
    """Sums `(n_points, ...)` over tracks of what each of them says, `(n_tracks, ...)`, by memberships."""
    sums = np.asarray(membership.T @ values.reshape(len(values), -1), np.float64)
    return sums.reshape(membership.shape[1], *values.shape[1:])


def pooled_positions(membership: csr_array, positions: Numbers, weights: Numbers) -> tuple[Numbers, Numbers]:
    """Positions `(n_frames, n_points, 2)` px and weights `(n_frames, n_points)` of points, of their tracks.

    A coordinate that no track knows while one knows the other is NaN.
    """
    known = ~np.isnan(positions)
    weight = weights[..., None] * known
    each = pooled(membership, weight.transpose(1, 0, 2)).transpose(1, 0, 2)
    sums = pooled(membership, (weight * np.where(known, positions, 0.0)).transpose(1, 0, 2))
    each[each < LEAST_WEIGHT] = 0
    with np.errstate(invalid="ignore"):
        return sums.transpose(1, 0, 2) / np.where(each > 0, each, np.nan), each.max(axis=2)

"""What observations say of cameras given points, and of points given cameras, through both sides' moments."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .kernels.moments import frame_moments, invert_information, point_moments
from .observations import Numbers, Observations

UPPER = np.triu_indices(4)
DENSE = 0.5
"""Share of the matrix that must be seen for products of full matrices to be faster than lists."""

_SYMMETRIC = np.zeros((4, 4), np.int64)
_SYMMETRIC[UPPER] = np.arange(10)
_SYMMETRIC = np.maximum(_SYMMETRIC, _SYMMETRIC.T)


def homogeneous(shape: Numbers) -> Numbers:
    """`(n, 4)`: points `(n, 3)` with a 1 behind."""
    return np.concatenate([shape, np.ones((len(shape), 1))], axis=1)


def shape_moments(shape: Numbers, covariance: Numbers) -> Numbers:
    """Give E[s s^T], s = (S, 1), as ten numbers `(n_points, 10)`."""
    moments = np.empty((len(shape), 10))
    x, y, z = shape.T
    for place, j, k, product in ((0, 0, 0, x * x), (1, 0, 1, x * y), (2, 0, 2, x * z), (4, 1, 1, y * y)):
        moments[:, place] = product + covariance[:, j, k]
    moments[:, 5] = y * z + covariance[:, 1, 2]
    moments[:, 7] = z * z + covariance[:, 2, 2]
    moments[:, 3], moments[:, 6], moments[:, 8], moments[:, 9] = x, y, z, 1.0
    return moments


def camera_moments(cameras: Numbers, covariance: Numbers) -> Numbers:
    """Give E[m m^T] summed over the rows of u and v, as ten numbers `(n_frames, 10)`."""
    second = np.einsum("tcj,tck->tjk", cameras, cameras) + 2 * covariance
    moments: Numbers = second[:, UPPER[0], UPPER[1]]
    return moments


class Sums:
    """Weighted sums over the observations.

    Over lists where the matrix is sparse; as matrix products where most points are seen; and where all are,
    with equal weights, the normal matrices of all points are one, and so are those of all frames: then they
    come as one matrix that is repeated without being stored more than once.
    """

    def __init__(self, observations: Observations) -> None:
        self._observations = observations
        size = observations.n_frames * observations.n_points
        weight = observations.by_frame.weight
        self._dense = observations.count > DENSE * size
        self._equal = observations.count == size and float(np.ptp(weight)) == 0.0

    @cached_property
    def _tables(self) -> tuple[Numbers, Numbers]:
        """Weights `(n_frames, n_points)` and weighted positions `(2 n_frames, n_points)`."""
        listed, n_points = self._observations.by_frame, self._observations.n_points
        n_frames = self._observations.n_frames
        weight, weighted = np.zeros((n_frames, n_points)), np.zeros((n_frames, 2, n_points))
        weight[listed.own, listed.other] = listed.weight
        weighted[listed.own, 0, listed.other] = listed.weight * listed.x
        weighted[listed.own, 1, listed.other] = listed.weight * listed.y
        return weight, weighted.reshape(2 * n_frames, n_points)

    @cached_property
    def _squares(self) -> Numbers:
        """Weighted squares of each point's positions."""
        listed = self._observations.by_point
        squares = listed.weight * (listed.x**2 + listed.y**2)
        sums: Numbers = np.bincount(listed.own, squares, self._observations.n_points).astype(np.float64)
        return sums

    @cached_property
    def total(self) -> float:
        """Weighted squares of all positions."""
        return float(self._squares.sum())

    def of_frames(self, shape: Numbers, moments: Numbers) -> tuple[Numbers, Numbers]:
        """Information `(n_frames, 4, 4)` and vector `(n_frames, 4, 2)` of cameras, at noise variance 1."""
        if not self._dense:
            information, vector = frame_moments(self._observations.by_frame, shape, moments)
            return information, vector
        weight, weighted = self._tables
        seconds = _summed(moments, len(weight)) if self._equal else weight @ moments
        vector = weighted @ homogeneous(shape)
        return _matrices(seconds, _SYMMETRIC), np.ascontiguousarray(
            vector.reshape(-1, 2, 4).transpose(0, 2, 1)
        )

    def of_points(self, cameras: Numbers, moments: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Information `(n_points, 3, 3)`, vector `(n_points, 3)` and quadratic `(n_points,)` of points."""
        if not self._dense:
            information, vector, quadratic = point_moments(self._observations.by_point, cameras, moments)
            return information, vector, quadratic
        weight, weighted = self._tables
        seconds = _summed(moments, weight.shape[1]) if self._equal else weight.T @ moments
        vector = weighted.T @ cameras.reshape(-1, 4)
        quadratic = self._squares - 2 * vector[:, 3] + seconds[:, 9]
        information = _matrices(seconds, _SYMMETRIC[:3, :3])
        return information, vector[:, :3] - seconds[:, [3, 6, 8]], quadratic


def _summed(moments: Numbers, n: int) -> Numbers:
    """Moments of all, which each of `n` others sees with weight 1."""
    return np.broadcast_to(moments.sum(axis=0), (n, moments.shape[1]))


def _matrices(seconds: Numbers, places: NDArray[np.int64]) -> Numbers:
    """Symmetric matrices from ten numbers each; one that is repeated stays so."""
    if repeated(seconds):
        matrix = seconds[0, places]
        return np.broadcast_to(matrix, (len(seconds), *matrix.shape))
    matrices: Numbers = seconds[:, places]
    return matrices


def repeated(matrices: Numbers) -> bool:
    """Whether an array is one matrix many times over."""
    return matrices.strides[0] == 0 and len(matrices) > 1


def inverses(information: Numbers, prior: Numbers, scale: float) -> tuple[Numbers, Numbers]:
    """Invert `scale * information + diag(prior)`, and give the log determinants of that."""
    if repeated(information):
        covariance, log_determinant = invert_information(information[:1].copy(), prior, scale)
        n = len(information)
        return np.broadcast_to(covariance, (n, *covariance.shape[1:])), np.broadcast_to(log_determinant, (n,))
    covariance, log_determinant = invert_information(information, prior, scale)
    return covariance, log_determinant

"""EM of factor analysis with missing data: RSMCM eq. (18), cameras independent or coherent by eq. (19).

Model, in the units of `Observations`: position = M_t (S_i, 1) + noise of variance sigma^2 / weight; points
S_i ~ N(0, I), which is no restriction as long as cameras are free to scale and shear; the rows of M_t
either independent, or moving by eq. (19). The posterior is sought in the form q(M) q(S) (variational EM).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optimisation import Anderson
from .kernels import invert_information, smooth_cameras
from .observations import Array, Observations, SparseObservations

UPPER = np.triu_indices(4)
DENSE = 0.5  # share of the matrix that must be seen for products of full matrices to be faster than lists

_SYMMETRIC = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
"""Which of the ten numbers each entry of a symmetric matrix is."""


def homogeneous(shape: Array) -> Array:
    """Return `(n, 4)`: points `(n, 3)` with a 1 behind."""
    return np.concatenate([shape, np.ones((len(shape), 1))], axis=1)


def shape_moments(shape: Array, covariance: Array | None = None) -> Array:
    """Return E[s s^T], s = (S, 1), as ten numbers `(n_points, 10)`."""
    covariance = np.zeros((len(shape), 3, 3)) if covariance is None else covariance
    moments = np.empty((len(shape), 10))
    x, y, z = shape.T
    for place, j, k, product in ((0, 0, 0, x * x), (1, 0, 1, x * y), (2, 0, 2, x * z), (4, 1, 1, y * y)):
        moments[:, place] = product + covariance[:, j, k]
    moments[:, 5] = y * z + covariance[:, 1, 2]
    moments[:, 7] = z * z + covariance[:, 2, 2]
    moments[:, 3], moments[:, 6], moments[:, 8], moments[:, 9] = x, y, z, 1.0
    return moments


def camera_moments(cameras: Array, covariance: Array | None = None) -> Array:
    """Return E[m m^T] summed over the rows of u and v, as ten numbers `(n_frames, 10)`."""
    covariance = np.zeros((len(cameras), 4, 4)) if covariance is None else covariance
    second = np.einsum("tcj,tck->tjk", cameras, cameras) + 2 * covariance
    moments: Array = second[:, UPPER[0], UPPER[1]]
    return moments


class ObservationSums:
    """Weighted sums over observations by frame, of `n_points` points.

    Products with sparse matrices, or with full ones where most points are seen. Where all are, with a
    weight of 1, all points have one normal matrix, and so have all frames: it is not stored for each.
    """

    def __init__(self, by_frame: SparseObservations, n_points: int) -> None:
        weight = by_frame.weight
        size = (len(by_frame.edges) - 1) * n_points
        self._equal = len(weight) == size and bool((weight == 1).all())
        tables: list[Any] = [
            by_frame.matrix(values, n_points) for values in (weight, weight * by_frame.x, weight * by_frame.y)
        ]
        if len(weight) > DENSE * size:
            tables = [table.toarray() for table in tables]
        self.weight, self._x, self._y = tables
        self.transposed, self._x_transposed, self._y_transposed = (table.T for table in tables)
        self._squares = np.bincount(by_frame.other, weight * (by_frame.x**2 + by_frame.y**2), n_points)

    @property
    def total(self) -> float:
        """Weighted squares of all positions."""
        return float(self._squares.sum())

    def of_frames(self, shape: Array, moments: Array) -> tuple[Array, Array]:
        """Return information `(n_frames, 4, 4)`, vector `(n_frames, 4, 2)` of cameras at noise variance 1.

        `moments` `(n_points, 10)` are E[s s^T], s = (S, 1), as of `shape_moments`.
        """
        n_frames = self.weight.shape[0]
        seconds = _summed(moments, n_frames) if self._equal else self.weight @ moments
        points = homogeneous(shape)
        return _matrices(seconds, _SYMMETRIC), np.stack([self._x @ points, self._y @ points], axis=2)

    def of_points(self, cameras: Array, moments: Array) -> tuple[Array, Array, Array]:
        """Return information `(n_points, 3, 3)`, vector `(n_points, 3)`, quadratic `(n_points,)`.

        E[sum_t w |x_t - M_t (S, 1)|^2] = quadratic - 2 vector . S + S . information S. `moments` `(n_frames,
        10)` are E[m m^T] summed over both rows m, as of `camera_moments`.
        """
        n_points = self.weight.shape[1]
        seconds = _summed(moments, n_points) if self._equal else self.transposed @ moments
        vector = self._x_transposed @ cameras[:, 0] + self._y_transposed @ cameras[:, 1]
        quadratic = self._squares - 2 * vector[:, 3] + seconds[:, 9]
        information = _matrices(seconds, _SYMMETRIC[:3, :3])
        return information, vector[:, :3] - seconds[:, [3, 6, 8]], quadratic


def squared_error(by_frame: SparseObservations, cameras: Array, shape: Array) -> float:
    """Return the weighted squared error at given cameras and shape."""
    return float(by_frame.weight @ np.sum(by_frame.errors(cameras, shape) ** 2, axis=0))


def _summed(moments: Array, n: int) -> Array:
    """Moments of all, which each of `n` others sees with weight 1."""
    return np.broadcast_to(moments.sum(axis=0), (n, moments.shape[1]))


def _matrices(seconds: Array, places: NDArray[np.int64]) -> Array:
    """Symmetric matrices from ten numbers each; one that is repeated stays so."""
    if repeated(seconds):
        matrix = seconds[0, places]
        return np.broadcast_to(matrix, (len(seconds), *matrix.shape))
    return np.take(seconds, places, axis=1)


def repeated(matrices: Array) -> bool:
    """Return whether all matrices of an array are the same."""
    return matrices.strides[0] == 0 and len(matrices) > 1


def inverses(information: Array, prior: Array, scale: float) -> tuple[Array, Array]:
    """Invert `scale * information + diag(prior)`; also its log determinants."""
    if repeated(information):
        covariance, log_determinant = invert_information(information[:1].copy(), prior, scale)
        n = len(information)
        return np.broadcast_to(covariance, (n, *covariance.shape[1:])), np.broadcast_to(log_determinant, (n,))
    covariance, log_determinant = invert_information(information, prior, scale)
    return covariance, log_determinant


FINEST = 1e-15
"""Least variance of a coherent camera after a frame, as a share of that before: differences of them round."""

LEAST_NOISE = 1e-9
"""Standard deviation of the noise, in units of the spread of positions, below which rounding decides."""

ORDERS = 3
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """What is known of cameras before any observation; learned by EM.

    Variances `(1, 2)` of independent frames' numbers of M that multiply the shape, and of the translation;
    with coherence `(3, 2)`, the same of eps_1, eps_2 and eps_3 in eq. (19).
    """

    variance: Array
    coherent: bool

    @property
    def numbers(self) -> Array:
        """`(4,)` or `(12,)` variances, one for each number of a row (and its derivatives)."""
        linear_and_shift = self.variance.reshape(-1, 2)
        return np.repeat(linear_and_shift, (3, 1), axis=1).reshape(-1)


def first_prior(cameras: Array, coherent: bool) -> CameraPrior:
    """Return a prior for these cameras, with more noise of the motion than less: EM reduces it."""
    if not coherent:
        linear, shift = (max(float(np.mean(part**2)), LEAST_VARIANCE) for part in _parts(cameras))
        return CameraPrior(np.array([[linear, shift]]), coherent)
    changes = [np.diff(cameras, n=order, axis=0) for order in range(1, min(4, len(cameras)))]
    smallest = np.min([[np.mean(part**2) for part in _parts(change)] for change in changes], axis=0)
    return CameraPrior(np.tile(smallest + LEAST_VARIANCE, (3, 1)), coherent)


def _parts(cameras: Array) -> tuple[Array, Array]:
    return cameras[..., :3], cameras[..., 3]


@dataclass(frozen=True, eq=False)
class Posterior:
    """Means and covariances of cameras and points, noise, and the prior of cameras.

    Cameras `(n_frames, 2, 4)`, whose rows share a covariance `(n_frames, 4, 4)`; shape `(n_points, 3)` and
    its covariance `(n_points, 3, 3)`; `noise` is the variance at weight 1.
    """

    cameras: Array
    camera_covariance: Array
    shape: Array
    shape_covariance: Array
    noise: float
    prior: CameraPrior


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """Posterior of the cameras given the moments of the points.

    `log_evidence` is the log integral of p(M) exp(sum of (vector . m - m . information m / 2) / noise) dM,
    and `better` a prior of the cameras under which it is not less.
    """

    cameras: Array
    covariance: Array
    log_evidence: float
    better: CameraPrior


FIRST_SPREAD = (1e2, 0.1, 0.01)  # with coherence: variances of m, m', m'' in the first frame; broad
LEAST_JITTER = 1e-3  # with coherence: by what noise is expected to change rows over all frames, at the least
LONGEST_STEP = 1e3  # factor by which a variance of the motion may grow at once


def estimate_cameras(information: Array, vector: Array, noise: float, prior: CameraPrior) -> CameraEstimate:
    """Estimate the cameras (E-step) from information `(n_frames, 4, 4)` and vector `(n_frames, 4, 2)`.

    With coherence the noise of the motion is learned by the multiplicative step for variance components,
    q <- q sqrt(a / b), where a - b is twice the derivative of the log evidence by q: it never lowers the
    evidence, as EM, but does not slow down where the motion has hardly any noise.
    """
    n_frames = len(information)
    variance = prior.numbers
    if prior.coherent:
        first = np.repeat(FIRST_SPREAD, 4)
        noise = max(noise, FINEST * float(information.max() * max(first.max(), variance.max())))
        cameras, covariance, evidence, squares, counts = smooth_cameras(
            information, vector, 1 / noise, variance, np.zeros((12, 2)), first
        )
        old = prior.variance
        evidence -= float(np.sum(least_variance(n_frames) / old))
        above = old**2 * _pooled(squares) + 2 * least_variance(n_frames)
        # part of a step raises the evidence as well; where nothing was seen there is nothing to be learned
        longest = LONGEST_STEP * old
        learned = np.sqrt(above / np.maximum(_pooled(counts), above / longest**2))
    else:
        covariance, log_determinant = inverses(information, 1 / variance, 1 / noise)
        means = covariance @ vector / noise
        evidence = 0.5 * float(np.sum(means * vector)) / noise - float(log_determinant.sum())
        evidence -= n_frames * float(np.log(variance).sum())
        cameras = np.ascontiguousarray(means.transpose(0, 2, 1))
        second = np.sum(means**2, axis=(0, 2)) + 2 * np.einsum("tjj->j", covariance)
        learned = _pooled(second) / (2 * n_frames * np.array([[3, 1]]))
    return CameraEstimate(cameras, covariance, evidence, CameraPrior(learned, prior.coherent))


def least_variance(n_frames: int) -> Array:
    """Return the weight b of the prior exp(-b / q) on the variances q of eps_1, eps_2, eps_3 `(3, 1)`.

    Noise of order k changes rows over n frames by about sqrt(q n^(2k - 1)). Without a prior the likelihood
    of few frames may be highest where there is no noise at all.
    """
    order = 2.0 * np.arange(ORDERS)[:, None] + 1
    return np.asarray(LEAST_JITTER**2 / float(n_frames) ** order, np.float64)


def _pooled(values: Array) -> Array:
    """Sum over the three numbers of a row that multiply the shape; the translation apart: `(orders, 2)`."""
    rows = values.reshape(-1, 4)
    return np.stack([rows[:, :3].sum(axis=1), rows[:, 3]], axis=1)


WINDOW = 10  # iterations over which the rise of the bound is judged
LEARNING = 2  # iterations from one to the next in which the prior is learned; it costs another smoother
ROUNDING = 1e-9  # relative error of the bound, a sum of numbers that nearly cancel


def expectation_maximisation(
    observations: Observations,
    posterior: Posterior,
    *,
    iterations: int,
    tolerance: float,
    accelerate: bool = False,
) -> tuple[Posterior, list[float]]:
    """Improve a posterior until the bound of the log likelihood converges.

    At most so many iterations, and until they gain less than `tolerance` nats each. With `accelerate` the
    shape is extrapolated from the last ones, and steps that lower the bound are taken back. Also returns the
    bound at each iteration that counts, before its update of the points; it never falls.
    """
    by_frame = observations.by_frame
    sums = ObservationSums(by_frame, observations.n_points)
    log_weight = float(np.log(by_frame.weight).sum())
    count = 0.5 * observations.numbers  # what is filled in adds as much to the error as to what is divided by
    shape, covariance = posterior.shape, posterior.shape_covariance
    noise, prior = posterior.noise, posterior.prior
    log_determinant = np.linalg.slogdet(covariance)[1].sum()
    acceleration = Anderson()
    plain = shape
    history: list[float] = []
    for _ in range(max(iterations, 1)):
        information, vector = sums.of_frames(shape, shape_moments(shape, covariance))
        learn = len(history) % LEARNING == 0
        better = estimate_cameras(information, vector, noise, prior).better if learn else prior
        cameras = estimate_cameras(information, vector, noise, better)
        divergence = 0.5 * (
            float(np.einsum("ijj->", covariance) + np.sum(shape**2)) - shape.size - log_determinant
        )
        bound = log_weight - count * math.log(2 * math.pi * noise) - 0.5 * sums.total / noise
        bound += cameras.log_evidence - divergence
        if shape is not plain and history and bound < history[-1] - ROUNDING * abs(history[-1]):
            shape = plain
            acceleration.forget()
            continue
        history.append(bound)
        prior, start, kept = better, shape, cameras
        moments = camera_moments(cameras.cameras, cameras.covariance)
        information, vector, quadratic = sums.of_points(cameras.cameras, moments)
        covariance, determinants = inverses(information, np.ones(3), 1 / noise)
        log_determinant = -determinants.sum()
        shape = plain = np.einsum("ijk,ik->ij", covariance, vector) / noise
        second = covariance + shape[:, :, None] * shape[:, None, :]
        error = float(np.sum(quadratic) - 2 * np.sum(vector * shape) + np.sum(information * second))
        if error < 1e-6 * sums.total:  # a difference of numbers so much larger is rounding
            error = squared_error(by_frame, cameras.cameras, shape)
            error += float(np.sum(information * covariance)) + _camera_error(sums, cameras.covariance, shape)
        noise = max(error / (2 * count), LEAST_NOISE**2)
        if len(history) > WINDOW and history[-1] - history[-1 - WINDOW] < WINDOW * tolerance:
            break
        if accelerate:
            shape = acceleration.propose(start, shape)
    spread = np.array(kept.covariance), np.array(covariance)  # no longer one that is repeated
    return Posterior(kept.cameras, spread[0], plain, spread[1], noise, prior), history


def _camera_error(sums: ObservationSums, covariance: Array, shape: Array) -> float:
    """Expected squared error that comes of the cameras' covariances."""
    information, _ = sums.of_frames(shape, shape_moments(shape))
    return 2 * float(np.sum(information * covariance))

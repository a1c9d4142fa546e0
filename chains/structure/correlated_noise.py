"""What a tracker's errors are like: partly new in each frame, partly drift that stays for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array

from ...inference.sfm.factor_analysis.em import homogeneous
from ...inference.sfm.factor_analysis.factorisation import Factorisation
from ...inference.sfm.factor_analysis.observations import Listed, Observations
from .kernels import camera_coupling, track_information

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)
"""Of the variance, that may be drift."""
MEMORIES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0)
"""Frames in which drift may be forgotten: longer ones cannot be told from another position of the point."""

STEPS, PRECISION = 50, 1e-3
"""Of the variance of the noise: at most so many, and until it changes by no more than this share."""
MOST_RESIDUALS = 10_000
"""Of more, about so many are asked, those of every n-th point: they say variances to a hundredth or two."""
ROUNDING = 1e-12
"""Share of the squares of positions below which errors are rounding."""


@dataclass(frozen=True)
class CorrelatedNoise:
    """Errors of a track along one axis, as a sum of white noise and a first-order Gauss-Markov process.

    A template that has slipped off its point stays off it for some frames: the RSMCM paper (§4.3) emulates
    this as "consistent bias for five frames". Taken for white, such errors make a short track seem surer than
    it is.

    Parameters
    ----------
    white
        px^2, variance of what is new in each frame, at weight 1.
    drift
        px^2, variance of what stays.
    memory
        frames after which the correlation of what stays has fallen to 1/e.
    """

    white: float
    drift: float
    memory: float

    @property
    def decay(self) -> float:
        """Correlation of drift from one frame to the next."""
        return float(np.exp(-1 / self.memory))

    def scaled(self, factor: float) -> "CorrelatedNoise":
        """The same with variances times a factor."""
        return CorrelatedNoise(factor * self.white, factor * self.drift, self.memory)

    def information(self, tracks: Listed, cameras: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """What tracks say of their points where cameras are known.

        -2 log p(track | its point S) = quadratic - 2 vector . S + S . information S + determinant + constant.

        Parameters
        ----------
        tracks
            observations by track.
        cameras
            `(n_frames, 2, 4)`.

        Returns
        -------
        information, vector, quadratic, determinant
            `(n_tracks, 3, 3)`, `(n_tracks, 3)`, `(n_tracks,)`, `(n_tracks,)`.
        """
        terms: tuple[Numbers, Numbers, Numbers, Numbers] = track_information(
            tracks, np.ascontiguousarray(cameras), self.white, self.drift, self.decay
        )
        return terms


def estimate_correlated_noise(
    tracks: Listed, cameras: Numbers, point_of_track: NDArray[np.int64], prior: Numbers
) -> CorrelatedNoise:
    """Find the noise under which the tracks are likeliest, whatever the points are (restricted likelihood).

    The points are integrated out, so that what fitting them takes from the residuals is accounted for.

    Parameters
    ----------
    tracks
        observations by track.
    cameras
        `(n_frames, 2, 4)`.
    point_of_track
        `(n_tracks,)`.
    prior
        `(3, 3)`, covariance of the points about the origin.
    """
    every = int(np.ceil(2 * len(tracks.x) / MOST_RESIDUALS))
    if every > 1:
        tracks = tracks.only(point_of_track % every == 0, np.ones(len(cameras), np.bool_))
        point_of_track = point_of_track // every
    n_points = int(point_of_track.max()) + 1
    count = 2 * len(tracks.x)
    root = np.linalg.cholesky(prior)
    n_tracks = len(point_of_track)
    pool = csr_array((np.ones(n_tracks), (point_of_track, np.arange(n_tracks))), shape=(n_points, n_tracks))
    found: list[tuple[float, CorrelatedNoise]] = []
    for share in SHARES:
        for memory in MEMORIES if share else MEMORIES[:1]:
            noise = CorrelatedNoise(1 - share, share, memory)
            information, vector, quadratic, determinant = noise.information(tracks, cameras)
            whole = np.asarray(pool @ information.reshape(-1, 9), np.float64).reshape(-1, 3, 3)
            sums = np.asarray(pool @ vector, np.float64)
            # in the axes in which prior and observations of a point are diagonal
            values, axes = np.linalg.eigh(root.T @ whole @ root)
            squares = np.square(np.einsum("nji,kj,nk->ni", axes, root, sums))
            scale, left = _likeliest_scale(float(quadratic.sum()), values, squares, count)
            log_likelihood = -0.5 * (
                determinant.sum()
                + (count - values.size) * np.log(scale)
                + np.log(values + scale).sum()
                + left / scale
            )
            # of a drift, share and memory are found as well (BIC)
            found.append((float(log_likelihood) - (np.log(count) if share else 0.0), noise.scaled(scale)))
    return max(found, key=lambda each: each[0])[1]


def _likeliest_scale(total: float, values: Numbers, squares: Numbers, count: int) -> tuple[float, float]:
    """Variance at which a regression on points with a prior is likeliest, and the squares that are left then.

    Of y = A s + noise, s ~ N(0, I): `total` = y.y, `values` of A'A and `squares` of A'y along its axes.
    """
    scale = 1.0
    for _ in range(STEPS):
        before = scale
        explained = squares / (values + scale)
        left = total - float(explained.sum())
        errors = left - scale * float((explained / (values + scale)).sum())
        scale = max(errors / max(count - float((values / (values + scale)).sum()), 1.0), ROUNDING * total)
        if abs(scale - before) <= PRECISION * scale:
            break
    return scale, left


LEAST_CORRELATION = 1e-8
"""Of the noise of two frames, that counts."""

RIDGE = 1e-7
"""Added to the cameras' information, of unit diagonal, for what rounding takes away."""


def covariance_of_points(
    observations: Observations,
    fit: Factorisation,
    point_of_track: Indices,
    noise: CorrelatedNoise,
    chosen: Indices,
) -> Numbers:
    """Covariance `(n, 3, n, 3)` of chosen points `(n,)`, with cameras uncertain as well.

    Linear about a fit: Laplace's approximation.

    Parameters
    ----------
    observations
        in whose order of points `point_of_track` names the point `(n_tracks,)` of each track.
    fit
        of cameras and points, in px.
    noise
        of the tracks, in the units of the observations.
    """
    tracks, n_points, n_frames = observations.by_point, len(fit.shape), observations.n_frames
    cameras = observations.scaled(fit.cameras)
    own, cross = camera_coupling(
        tracks,
        point_of_track,
        homogeneous(fit.shape),
        cameras,
        noise.white,
        noise.drift,
        noise.decay,
        LEAST_CORRELATION,
    )
    information, _, _, _ = noise.information(tracks, cameras)
    whole = np.tile(np.eye(3), (n_points, 1, 1))
    np.add.at(whole, point_of_track, information)
    inverse = np.linalg.inv(whole)
    own += camera_precision(fit, n_frames) * observations.scale**2
    size = 4 * n_frames
    coupling = cross.reshape(2 * size, n_points, 3).transpose(1, 0, 2)
    halves = np.matmul(coupling, np.linalg.cholesky(inverse)).transpose(1, 0, 2).reshape(2 * size, -1)
    marginal = -(halves @ halves.T)
    marginal[:size, :size] += own
    marginal[size:, size:] += own
    # all cameras can move together with all points, which only the points' prior limits
    unit = 1 / np.sqrt(np.diag(marginal))
    marginal *= unit[:, None] * unit
    marginal[np.diag_indices(2 * size)] += RIDGE
    root = np.linalg.cholesky(marginal)
    through = np.matmul(coupling[chosen], inverse[chosen]).transpose(1, 0, 2).reshape(2 * size, -1)
    part = solve_triangular(root, unit[:, None] * through, lower=True)
    covariance = (part.T @ part).reshape(len(chosen), 3, len(chosen), 3)
    diagonal = np.arange(len(chosen))
    covariance[diagonal, :, diagonal] += inverse[chosen]
    return covariance


def camera_precision(fit: Factorisation, n_frames: int) -> Numbers:
    """Prior information `(4 n_frames, 4 n_frames)` 1/px^2 of a row of the cameras at all times."""
    if not fit.coherent:
        return np.diag(np.tile(1 / np.repeat(fit.motion_noise[0], (3, 1)), n_frames))
    linear, shift = (motion_precision(fit.motion_noise[:, k], n_frames) for k in range(2))
    precision = np.zeros((n_frames, 4, n_frames, 4))
    for number in range(3):
        precision[:, number, :, number] = linear
    precision[:, 3, :, 3] = shift
    return precision.reshape(4 * n_frames, 4 * n_frames)


def motion_precision(variances: Numbers, n_frames: int) -> Numbers:
    """Information `(n_frames, n_frames)` that eq. (19) holds of one number m at all times.

    `variances` are those of eps_1, eps_2 and eps_3; of the first frame nothing is known. Eq. (19) without its
    derivatives: the third difference of m is (eps_3 + its last value) / 2 plus the first difference of eps_2
    plus the second difference of eps_1.
    """
    count = n_frames - 3
    if count < 1:
        return np.zeros((n_frames, n_frames))
    noise = np.zeros((count, count))
    for weights, variance in (
        ((0.5, 0.5), variances[2]),
        ((-1, 1), variances[1]),
        ((1, -2, 1), variances[0]),
    ):
        band = np.zeros((count, count + len(weights) - 1))
        for k, weight in enumerate(weights):
            band += weight * np.eye(*band.shape, k)
        noise += variance * band @ band.T
    noise[np.diag_indices(count)] *= 1 + 1e-6
    rows = solve_triangular(np.linalg.cholesky(noise), np.diff(np.eye(n_frames), 3, axis=0), lower=True)
    precision: Numbers = rows.T @ rows
    return precision

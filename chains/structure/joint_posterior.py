"""Joint posterior of points and cameras, where errors of tracks are correlated over time."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ...inference.sfm.factor_analysis.factorisation import Factorisation
from ...inference.sfm.factor_analysis.moments import homogeneous
from ...inference.sfm.factor_analysis.observations import Observations
from .correlated_noise import CorrelatedNoise
from .kernels.track_association import camera_coupling

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

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

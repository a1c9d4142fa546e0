"""What is known of cameras and points around given values of them."""

import numpy as np

from .em import LEAST_VARIANCE, Posterior, first_prior
from .initialisation import RANK, Mask, freedom, regauged, whitened, whitening
from .kernels.moments import frame_moments, invert_information, point_leverages, point_moments, squared_error
from .moments import camera_moments, shape_moments
from .observations import Numbers, Observations
from .variable_projection import LeastSquares

LOOSEST = 100.0
"""Standard deviation, in spreads of the shape, of a direction in which observations leave a point open."""

HALF = 0.5
"""A point that is known to this share of the spread of all has its say in what that spread is."""


def around_start(
    observations: Observations,
    cameras: Numbers,
    shape: Numbers,
    frames: Mask,
    points: Mask,
    *,
    coherent: bool,
) -> Posterior:
    """A posterior from which EM can begin.

    Parameters
    ----------
    observations
        what was seen.
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`.
    frames, points
        of which this is more than a filler. Other frames lie between those, other points are draws of N(0,
        I).
    coherent
        which prior to begin with.
    """
    cameras, shape = whitened(cameras, shape, points)
    cameras = _bridged(cameras, frames)
    shape[~points] = 0
    part = observations.only(frames, points)
    error = float(squared_error(part.by_point, cameras, shape).sum())
    noise = max(error / max(freedom(part), 0.1 * part.count), LEAST_VARIANCE)
    covariance = np.tile(np.eye(RANK), (len(shape), 1, 1))
    covariance[points] *= min(noise, 1e-2)
    return Posterior(
        cameras, np.zeros((len(cameras), 4, 4)), shape, covariance, noise, first_prior(cameras, coherent)
    )


def _bridged(cameras: Numbers, known: Mask) -> Numbers:
    """Cameras of unknown frames, between those of the known ones before and after."""
    if known.all():
        return cameras
    times = np.flatnonzero(known)
    flat = cameras.reshape(len(cameras), 8)
    filled = [np.interp(np.arange(len(cameras)), times, flat[times, k]) for k in range(8)]
    return np.stack(filled, axis=1).reshape(-1, 2, 4)


def around_optimum(observations: Observations, part: Observations, found: LeastSquares) -> Posterior:
    """A posterior around the least squares optimum.

    Points: sigma^2 (sum of w R^T R)^-1, given the cameras. Cameras: sigma^2 (sum of w (1 - h) s s^T)^-1
    with h the share that an observation has in its own point, so that a point which a frame all but defines
    does not vouch for the frame's camera; given the other cameras.

    Parameters
    ----------
    observations
        what was seen.
    part
        of frames and points that least squares determines. Others get the prior's posterior given those.
    found
        from that part.
    """
    cameras, shape = found.cameras, found.shape
    noise = max(found.error / max(freedom(part), 1.0), LEAST_VARIANCE**2)
    points, frames = np.diff(part.by_point.edges) > 0, np.diff(part.by_frame.edges) > 0
    certain = np.zeros((len(cameras), 4, 4))
    information, _, _ = point_moments(part.by_point, cameras, camera_moments(cameras, certain))
    good = points
    for _ in range(2):  # the first spread is that of points which may be anywhere
        mean, change = whitening(shape[good])
        cameras, shape = regauged(cameras, shape, mean, change)
        information = change.T @ information @ change
        covariance, _ = invert_information(information, np.full(RANK, LOOSEST**-2), 1 / noise)
        worst = np.linalg.eigvalsh(covariance)[:, -1]
        good = points & (worst <= max(HALF**2, float(np.median(worst[points]))))
    shape[~points] = 0

    prior = first_prior(cameras[frames], coherent=False)
    leverages = point_leverages(part.by_frame, cameras, covariance / noise)
    others = part.by_frame._replace(weight=part.by_frame.weight * (1 - leverages))
    information, _ = frame_moments(others, shape, shape_moments(shape, np.zeros_like(covariance)))
    camera_covariance, _ = invert_information(information, np.full(4, LEAST_VARIANCE), 1 / noise)
    posterior = Posterior(cameras, camera_covariance, shape, covariance, noise, prior)
    return _completed(observations, posterior, frames, points)


def _completed(observations: Observations, posterior: Posterior, frames: Mask, points: Mask) -> Posterior:
    """The same with the frames and points that least squares left out, by the priors."""
    cameras, camera_covariance = posterior.cameras, posterior.camera_covariance
    shape, covariance = posterior.shape, posterior.shape_covariance
    noise = max(posterior.noise, LEAST_VARIANCE)  # or the prior would be lost in rounding
    if not frames.all():
        seen = observations.only(~frames, points).by_frame
        information, vector = frame_moments(seen, shape, shape_moments(shape, covariance))
        spread, _ = invert_information(information, 1 / posterior.prior.numbers, 1 / noise)
        camera_covariance[~frames] = spread[~frames]
        cameras[~frames] = (spread @ vector / noise)[~frames].transpose(0, 2, 1)
    if not points.all():
        seen = observations.only(frames, ~points).by_point
        moments = camera_moments(cameras, camera_covariance)
        information, pull, _ = point_moments(seen, cameras, moments)
        spread, _ = invert_information(information, np.ones(RANK), 1 / noise)
        covariance[~points] = spread[~points]
        shape[~points] = np.einsum("ijk,ik->ij", spread, pull)[~points] / noise
    return posterior

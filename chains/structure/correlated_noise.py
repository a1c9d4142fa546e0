"""What a tracker's errors are like: partly new in each frame, partly drift that stays for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...inference.sfm.factor_analysis.observations import Listed
from .kernels.track_association import track_information

Numbers = NDArray[np.float64]

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

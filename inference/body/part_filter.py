"""Position and velocity of a few parts: how they move, and what mixtures over their positions say of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from ...models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures
from ...models.core.mahalanobis import squared_distances
from ..filters.linear_motion import ornstein_uhlenbeck_velocity

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MovingParts:
    """Gaussians over position and velocity in the picture, one for each part.

    Parameters
    ----------
    means
        `(n_parts, 4)`: x, y px and their velocities px/s.
    covariances
        `(n_parts, 4, 4)`, in the same order, positive definite.
    """

    means: Array
    covariances: Array

    def moved(self, dt: float, speeds: ArrayLike, velocity_time: float) -> Self:
        """Parts `dt` s later, whose velocities are Ornstein-Uhlenbeck processes; exact for any `dt`.

        Parameters
        ----------
        dt
            s.
        speeds
            `(n_parts,)` px/s, standard deviation of a velocity's components in the long run.
        velocity_time
            s, time constant of velocities.
        """
        motion = ornstein_uhlenbeck_velocity(dt, velocity_time).along(2)
        return type(self)(*motion.moved(self.means, self.covariances, np.square(speeds)))

    def positions(self) -> GaussianMixtures:
        """Mixtures of one component each."""
        one = (len(self.means), 1)
        return GaussianMixtures(
            np.zeros(one),
            self.means[:, None, :2],
            self.covariances[:, None, :2, :2],
            np.zeros(one, np.bool_),
            np.full(one, NO_LABEL, np.int64),
        )

    def given(self, positions: Array, spreads: Array) -> tuple[Array, Array]:
        """Means `(n_parts, n, 4)` and covariances `(n_parts, n, 4, 4)` for posteriors of the positions.

        The velocity is a regression on the position and an independent rest, so that covariances are sums of
        positive ones: they stay positive definite however sure a position is.

        Parameters
        ----------
        positions, spreads
            `(n_parts, n, 2)` px and `(n_parts, n, 2, 2)` px^2.
        """
        spread, cross = self.covariances[:, :2, :2], self.covariances[:, 2:, :2]
        slope = cross @ np.linalg.inv(spread)
        rest = _symmetric(self.covariances[:, 2:, 2:] - slope @ cross.swapaxes(1, 2))
        lift = np.concatenate([np.broadcast_to(np.eye(2), slope.shape), slope], axis=1)[:, None]
        means = self.means[:, None] + (lift @ (positions - self.means[:, None, :2])[..., None])[..., 0]
        covariances = lift @ spreads @ lift.swapaxes(2, 3)
        covariances[..., 2:, 2:] += rest[:, None]
        return means, _symmetric(covariances)


@dataclass(frozen=True, eq=False)
class PartPosterior:
    """What is known of parts after a picture: components over position and velocity, which still have labels.

    Parameters
    ----------
    log_weights
        `(n_parts, n)`, minus infinity for fillers.
    means, covariances
        `(n_parts, n, 4)` and `(n_parts, n, 4, 4)`.
    labels
        `(n_parts, n)`: the detection that a component assigns to the part.
    located
        `(n_parts, n)`: all components but those of a part that was lost and that nothing has shown since.
    """

    log_weights: Array
    means: Array
    covariances: Array
    labels: NDArray[np.int64]
    located: NDArray[np.bool_]

    @classmethod
    def of(
        cls, predictions: Sequence[MovingParts], log_shares: Sequence[Array], detections: GaussianMixtures
    ) -> Self:
        """Predictions, the last of which is that of parts that are lost, times what is detected.

        Parameters
        ----------
        predictions
            each of all parts.
        log_shares
            `(n_parts,)` for each: log probability that it holds for a part.
        detections
            of all parts' positions.
        """
        # No more than a product keeps, so that the products below keep all of them, and their order.
        detections = detections * GaussianMixtures.uniform(detections.n_parts)
        weights, means, covariances = [], [], []
        for prediction, share in zip(predictions, log_shares, strict=True):
            positions = prediction.positions() * detections
            mean, covariance = prediction.given(positions.means, positions.covariances)
            weights.append(positions.log_weights + share[:, None])
            means.append(mean)
            covariances.append(covariance)
        found = np.ones_like(detections.flat)
        return cls(
            np.concatenate(weights, axis=1),
            np.concatenate(means, axis=1),
            np.concatenate(covariances, axis=1),
            np.concatenate([detections.labels] * len(predictions), axis=1),
            np.concatenate([found] * (len(predictions) - 1) + [~detections.flat], axis=1),
        )

    def weighed(self, others: GaussianMixtures) -> Self:
        """Components that fit other chains' messages weigh more; means and covariances stay as they are."""
        overlaps = others.log_overlaps(self.means[..., :2], self.covariances[..., :2, :2])
        return replace(self, log_weights=self.log_weights + overlaps)

    def log_within(self, centres: Array, radius: float) -> Array:
        """Log probability that a component's position is at a place: Gaussian windows with a peak of 1.

        Parameters
        ----------
        centres
            `(m, 2)` px.
        radius
            px, the windows' standard deviation.

        Returns
        -------
        log_within
            `(n_parts, m, n)`.
        """
        wide = self.covariances[:, None, :, :2, :2] + radius**2 * np.eye(2)
        distances = squared_distances(centres[:, None] - self.means[:, None, :, :2], wide)
        return np.asarray(2 * np.log(radius) - 0.5 * (np.log(np.linalg.det(wide)) + distances))

    def assigned(self, labels: NDArray[np.int64]) -> tuple[MovingParts, Array]:
        """Parts if each is assigned its label, `(n_parts,)`; by the moments of its mixture.

        The second result, `(n_parts,)`, is the probability that a part is located at all; not a number if it
        cannot have that label.
        """
        among = np.where(self.labels == labels[:, None], self.log_weights, -np.inf)
        counted = np.where(self.located, among, -np.inf)
        all_of_it = logsumexp(counted, axis=1, keepdims=True)
        share = np.exp(counted - np.where(np.isfinite(all_of_it), all_of_it, 0.0))
        mean = (share[..., None] * self.means).sum(axis=1)
        off = self.means - mean[:, None]
        scatter = self.covariances + off[..., :, None] * off[..., None, :]
        with np.errstate(invalid="ignore"):
            located = np.exp(all_of_it[:, 0] - logsumexp(among, axis=1))
        return MovingParts(mean, (share[..., None, None] * scatter).sum(axis=1)), located


def _symmetric(matrices: Array) -> Array:
    return 0.5 * (matrices + matrices.swapaxes(-1, -2))

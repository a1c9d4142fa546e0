"""Position and velocity of parts of a body in the picture."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference.kalman import ornstein_uhlenbeck_velocity

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MovingParts:
    """Gaussians over position and velocity in the picture, any number of them.

    Parameters
    ----------
    means
        `(..., 4)`: x, y px and their velocities px/s.
    covariances
        `(..., 4, 4)`, in the same order, positive definite.
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
            `(...)` px/s, standard deviation of a velocity's components in the long run.
        velocity_time
            s, time constant of velocities.
        """
        motion = ornstein_uhlenbeck_velocity(dt, velocity_time).along(2)
        return type(self)(*motion.moved(self.means, self.covariances, np.square(speeds)))

    def take(self, rows: NDArray[np.intp]) -> Self:
        """Some of them, along the first axis."""
        return type(self)(self.means[rows], self.covariances[rows])

    def given(self, positions: Array, spreads: Array) -> Self:
        """The same if the positions have these means `(..., 2)` px and covariances `(..., 2, 2)` px^2.

        The velocity is a regression on the position and an independent rest, so that covariances are sums of
        positive ones: they stay positive definite however sure a position is.
        """
        spread, cross = self.covariances[..., :2, :2], self.covariances[..., 2:, :2]
        slope = cross @ np.linalg.inv(spread)
        rest = _symmetric(self.covariances[..., 2:, 2:] - slope @ cross.swapaxes(-1, -2))
        lift = np.concatenate([np.broadcast_to(np.eye(2), slope.shape), slope], axis=-2)
        means = self.means + (lift @ (positions - self.means[..., :2])[..., None])[..., 0]
        covariances = lift @ spreads @ lift.swapaxes(-1, -2)
        covariances[..., 2:, 2:] += rest
        return type(self)(means, _symmetric(covariances))


def _symmetric(matrices: Array) -> Array:
    return 0.5 * (matrices + matrices.swapaxes(-1, -2))

"""Linear motions in continuous time: one exact step of any length, so that two short steps make a long one.

The closed forms agree with filterpy's `kinematic_state_transition` and `Q_continuous_white_noise`, as tests
show; importing filterpy takes 0.3 s (it loads scipy.stats), which no run should wait for.
"""

from math import factorial
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Numbers = NDArray[np.float64]

SHORT = 1e-2
"""Of a time constant: steps below it have the noise of a position as a series, which keeps its digits."""


class LinearMotion(NamedTuple):
    """One step of a state: x(t + dt) = transition x(t) + w, w ~ N(0, density noise).

    Parameters
    ----------
    transition
        `(n, n)`.
    noise
        `(n, n)`, symmetric: covariance that the step adds for a density of 1.
    """

    transition: Numbers
    noise: Numbers

    def along(self, axes: int) -> Self:
        """The same motion along several axes, state ordered as all positions, then all velocities, ..."""
        transition, noise = (np.kron(matrix, np.eye(axes)) for matrix in self)
        return type(self)(np.asarray(transition, np.float64), np.asarray(noise, np.float64))

    def moved(self, mean: Numbers, covariance: Numbers, density: ArrayLike) -> tuple[Numbers, Numbers]:
        """Mean and covariance of states after the step.

        Parameters
        ----------
        mean
            `(..., n)`.
        covariance
            `(..., n, n)`.
        density
            of the noise, `(...)` or what broadcasts to it.
        """
        grown = self.transition @ covariance @ self.transition.T
        grown += np.asarray(density, np.float64)[..., None, None] * self.noise
        return mean @ self.transition.T, 0.5 * (grown + grown.swapaxes(-1, -2))


def kinematic(order: int, dt: float) -> LinearMotion:
    """Position and derivatives, the last of which is driven by white noise: (x, x', ...) after `dt` s.

    Parameters
    ----------
    order
        how many numbers: 1 for a random walk, 2 for constant velocity but for white acceleration, 3 for
        constant acceleration but for white jerk.
    dt
        s, 0 or more.

    Returns
    -------
    motion
        Its noise is for a spectral density of 1 unit^2/s of the last derivative (px^2/s^3 at order 2): by so
        much the last one's variance grows in a second.

    Raises
    ------
    ValueError
        if `dt` is negative.
    """
    _check(dt)
    transition, noise = np.zeros((order, order)), np.empty((order, order))
    for i in range(order):
        for j in range(order):
            if j >= i:
                transition[i, j] = dt ** (j - i) / factorial(j - i)
            above, left = order - 1 - i, order - 1 - j  # integrals of w(s)^2 (dt - s)^(above + left)
            power = above + left + 1
            noise[i, j] = dt**power / (power * factorial(above) * factorial(left))
    return LinearMotion(transition, noise)


def ornstein_uhlenbeck_velocity(dt: float, time_constant: float) -> LinearMotion:
    """Position and velocity (x, x') after `dt` s, the velocity being an Ornstein-Uhlenbeck process.

    Parameters
    ----------
    dt
        s, 0 or more.
    time_constant
        s, in which a velocity is forgotten: its correlation falls to 1/e.

    Returns
    -------
    motion
        Its noise is for a variance of 1 of the velocity in the long run (density: px^2/s^2).

    Raises
    ------
    ValueError
        if `dt` is negative.
    """
    _check(dt)
    elapsed = dt / time_constant
    lag, fresh = -np.expm1(-elapsed), -np.expm1(-2 * elapsed)
    if elapsed < SHORT:
        series = 2 / 3 - elapsed * (1 / 2 - elapsed * (7 / 30 - elapsed * (1 / 12 - elapsed * 31 / 1260)))
        place = elapsed**3 * series
    else:
        place = 2 * elapsed - 4 * lag + fresh
    across = time_constant * lag**2
    return LinearMotion(
        np.array([[1.0, time_constant * lag], [0.0, np.exp(-elapsed)]]),
        np.array([[time_constant**2 * place, across], [across, fresh]]),
    )


def _check(dt: float) -> None:
    if not dt >= 0:
        raise ValueError(f"dt: got {dt} s, expected 0 or more")

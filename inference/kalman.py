"""Linear motions in continuous time, and the Kalman filter and smoother of many points in the plane.

A motion is one exact step of any length, so that two short steps make a long one. The closed forms agree
with filterpy's `kinematic_state_transition` and `Q_continuous_white_noise`, whose import takes 0.3 s.

Points move at constant velocity but for white acceleration noise (RSMCM paper, section 3.2), all in one
call. Measurements are Gaussian messages in information form: a point that is not seen is one with no
information.
"""

from dataclasses import dataclass
from math import factorial
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..models.core.checks import Count, NotNegative, checked
from ..models.core.short_repr import short_repr
from . import kernels as kalman_kernels
from .kernels import inverse

Array = NDArray[np.float64]

SHORT = 1e-2  # of a time constant: steps below it have the noise of a position as a series


class LinearMotion(NamedTuple):
    """One step of a state: x(t + dt) = transition x(t) + w, w ~ N(0, density noise), both `(n, n)`."""

    transition: Array
    noise: Array

    def along(self, axes: int) -> Self:
        """The same motion along several axes, state ordered as all positions, then all velocities, ..."""
        transition, noise = (np.kron(matrix, np.eye(axes)) for matrix in self)
        return type(self)(np.asarray(transition, np.float64), np.asarray(noise, np.float64))

    def moved(self, mean: Array, covariance: Array, density: ArrayLike) -> tuple[Array, Array]:
        """Mean `(..., n)` and covariance `(..., n, n)` of states after the step, for a noise of `density`."""
        grown = self.transition @ covariance @ self.transition.T
        grown += np.asarray(density, np.float64)[..., None, None] * self.noise
        return mean @ self.transition.T, 0.5 * (grown + grown.swapaxes(-1, -2))


@checked
def kinematic(order: Count, dt: NotNegative) -> LinearMotion:
    """Return the linear model of a position and derivatives (x, x', ...) over `dt` s, driven by white noise.

    Order 1 is a random walk, 2 constant velocity with white acceleration, 3 constant acceleration with white
    jerk. The noise has a spectral density of 1 (px^2/s^3 at order 2): the variance of the last derivative
    after a second. A negative `dt` is a `ValueError`.
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

    In `time_constant` s the velocity's correlation falls to 1/e. The noise is for a variance of 1 of the
    velocity in the long run (density: px^2/s^2). A negative `dt` is a `ValueError`.
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


STATE = 4
LEAST_SHARE = 1e-12  # of a position's information: what other frames add that is less is rounding


@short_repr
@dataclass(frozen=True, eq=False)
class PointStates:
    """Gaussians over position and velocity of points, each on its own; perhaps in many frames.

    Parameters
    ----------
    mean
        `(..., n_points, 4)`: x, y px, then their velocities px/s.
    covariance
        `(..., n_points, 4, 4)`, in the same order.
    """

    mean: Array
    covariance: Array

    @classmethod
    def at_rest(cls, positions: ArrayLike, variance: ArrayLike, speed: ArrayLike) -> Self:
        """Return new points, with unknown velocities.

        Positions `(n_points, 2)` px have this variance px^2, velocities the standard deviation `speed` px/s,
        along each coordinate; both are one for all, or `(n_points,)`.
        """
        places = np.asarray(positions, np.float64).reshape(-1, 2)
        mean, covariance = np.zeros((len(places), STATE)), np.zeros((len(places), STATE, STATE))
        mean[:, :2] = places
        covariance[:, 0, 0] = covariance[:, 1, 1] = variance
        covariance[:, 2, 2] = covariance[:, 3, 3] = np.square(speed)
        return cls(mean, covariance)

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Mean and covariance as loops take them."""
        return _plain(self.mean), _plain(self.covariance)

    @property
    def position(self) -> Array:
        """`(..., n_points, 2)` px."""
        return self.mean[..., :2]

    @property
    def position_covariance(self) -> Array:
        """`(..., n_points, 2, 2)` px^2."""
        return self.covariance[..., :2, :2]

    def __len__(self) -> int:
        """Return the number of points, or of frames where there are many."""
        return len(self.mean)


def predict(states: PointStates, dt: float, acceleration: ArrayLike) -> PointStates:
    """States of `n_points` after `dt` s more.

    `acceleration` is the spectral density px^2/s^3 of the white acceleration along each coordinate, one for
    all points or `(n_points,)`: by so much a velocity's variance grows in a second. A negative `dt`, or
    shapes that do not fit, are a `ValueError`.
    """
    _check(dt)
    n_points = _checked_states(states, 1)
    moved = _empty_like(states)
    noise = _per_point(acceleration, n_points)
    kalman_kernels.predict_states(*states.arrays, np.full(n_points, float(dt)), noise, *moved.arrays)
    return moved


def update(states: PointStates, information: ArrayLike, vector: ArrayLike) -> PointStates:
    """States after measurements exp(vector . z - z . information z / 2) of their positions z.

    Covariances stay positive definite however sure or unsure states and measurements are. `information`
    `(n_points, 2, 2)` 1/px^2 is symmetric and need not determine both coordinates (zeros leave a state
    exactly as it is), `vector` `(n_points, 2)` 1/px is information times measured position. Shapes that do
    not fit are a `ValueError`.
    """
    _checked_states(states, 1)
    measured = _checked_measurements(information, vector, states.mean.shape[:-1])
    after = _empty_like(states)
    kalman_kernels.update_states(*states.arrays, *measured, *after.arrays)
    return after


def filter_tracks(
    prior: PointStates, times: ArrayLike, information: ArrayLike, vector: ArrayLike, acceleration: ArrayLike
) -> PointStates:
    """States in all frames, each given the measurements up to it: `predict` and `update` from frame to frame.

    A point that begins later, or is lost in between, has no information in the frames before. Its prior (in
    the first frame, before its measurement) should be so broad that it does not matter when the point
    begins. `times` are s, `(n_frames,)` or, if each point has its own, `(n_frames, n_points)`; information
    and vector have the frames in front. Times that decrease and shapes that do not fit are a `ValueError`.
    """
    n_points = _checked_states(prior, 1)
    steps = _checked_steps(times, n_points)
    measured = _checked_measurements(information, vector, (len(steps), n_points))
    filtered = PointStates(
        np.empty((len(steps), n_points, STATE)), np.empty((len(steps), n_points, STATE, STATE))
    )
    noise = _per_point(acceleration, n_points)
    kalman_kernels.filter_states(*prior.arrays, steps, *measured, noise, *filtered.arrays)
    return filtered


def smooth(filtered: PointStates, times: ArrayLike, acceleration: ArrayLike) -> PointStates:
    """States in all frames given all measurements, by Rauch, Tung and Striebel's recursion.

    It keeps two digits of the covariances, or more, as long as a point is not expected to move by more than
    1e5 standard deviations of its measurements in a step. Arguments are those of `filter_tracks`, whose
    result `filtered` is; times that decrease and shapes that do not fit are a `ValueError`.
    """
    n_points = _checked_states(filtered, 2)
    steps = _checked_steps(times, n_points)
    if len(steps) != len(filtered):
        raise ValueError(f"times: got {len(steps)} for states in {len(filtered)} frames, expected as many")
    smoothed = _empty_like(filtered)
    noise = _per_point(acceleration, n_points)
    kalman_kernels.smooth_states(*filtered.arrays, steps, noise, *smoothed.arrays)
    return smoothed


def _inverse(matrices: Array) -> Array:
    """Inverses of symmetric, positive definite matrices `(..., 2, 2)`."""
    xx, xy, yx, yy = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    return np.stack(inverse((xx, xy, yx, yy)), axis=-1).reshape(matrices.shape)


def cavity(smoothed: PointStates, information: ArrayLike, vector: ArrayLike) -> tuple[Array, Array]:
    """Return the information of all other frames and the prior about each position.

    The smoothed state divided by its own measurement is a chain's message to the feature node (mu_{X -> F},
    RSMCM Algorithm 2). Where the others add less than rounding, it is 0. Given the measurements of
    `filter_tracks`, it is information `(n_frames, n_points, 2, 2)` 1/px^2, vector `(n_frames, n_points, 2)`
    1/px; shapes that do not fit are a `ValueError`.
    """
    _checked_states(smoothed, 2)
    own_information, own_vector = _checked_measurements(information, vector, smoothed.mean.shape[:-1])
    whole = _inverse(smoothed.position_covariance)
    others = whole - own_information
    # smallest eigenvalue with the whole information's diagonal scaled to 1
    size = np.sqrt(whole[..., range(2), range(2)])
    scaled = others / (size[..., :, None] * size[..., None, :])
    xx, xy, yy = scaled[..., 0, 0], scaled[..., 0, 1], scaled[..., 1, 1]
    sure = xx + yy - np.hypot(xx - yy, 2 * xy) > 2 * LEAST_SHARE
    others_vector = (whole @ smoothed.position[..., None])[..., 0] - own_vector
    return np.where(sure[..., None, None], others, 0.0), np.where(sure[..., None], others_vector, 0.0)


def _plain(array: ArrayLike) -> Array:
    return np.ascontiguousarray(array, np.float64)


def _empty_like(states: PointStates) -> PointStates:
    return PointStates(np.empty(states.mean.shape), np.empty(states.covariance.shape))


def _per_point(acceleration: ArrayLike, n_points: int) -> Array:
    given = np.asarray(acceleration, np.float64)
    if given.shape not in ((), (n_points,)):
        raise ValueError(f"acceleration: got {given.shape}, expected a number or ({n_points},)")
    return _plain(np.broadcast_to(given, n_points))


def _checked_states(states: PointStates, axes: int) -> int:
    """Number of points of states that have `axes` axes: points, or frames and points."""
    shape = states.mean.shape
    if len(shape) != axes + 1 or shape[-1] != STATE or states.covariance.shape != (*shape, STATE):
        points = "(n_points" if axes == 1 else "(n_frames, n_points"
        raise ValueError(
            f"states: got mean {shape} and covariance {states.covariance.shape}, "
            f"expected {points}, {STATE}) and {points}, {STATE}, {STATE})"
        )
    return int(shape[-2])


def _checked_steps(times: ArrayLike, n_points: int) -> Array:
    """s from the frame before, 0 in the first, `(n_frames, n_points)`."""
    seconds = np.asarray(times, np.float64)
    columns = seconds[:, None] if seconds.ndim == 1 else seconds
    fits = columns.ndim == 2 and len(columns) and columns.shape[1] in (1, n_points)
    steps = np.diff(columns, axis=0, prepend=columns[:1]) if fits else np.full(1, np.nan)
    if not (steps >= 0).all():
        raise ValueError(
            f"times: got {seconds.shape}, expected seconds (n_frames,) or (n_frames, {n_points}) "
            "of one or more frames, in order"
        )
    return _plain(np.broadcast_to(steps, (len(steps), n_points)))


def _checked_measurements(
    information: ArrayLike, vector: ArrayLike, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    precision, weighted = _plain(information), _plain(vector)
    if precision.shape != (*shape, 2, 2) or weighted.shape != (*shape, 2):
        raise ValueError(
            f"measurements: got information {precision.shape} and vector {weighted.shape}, "
            f"expected {(*shape, 2, 2)} and {(*shape, 2)}"
        )
    return precision, weighted

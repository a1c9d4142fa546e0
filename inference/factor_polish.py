"""Weighted least squares to the optimum: variable projection with Levenberg-Marquardt damping.

The points that are best for given cameras have a closed form, so the squared error is a function of the cameras
alone. It has far fewer poor valleys than the error as a function of both (Hong and Fitzgibbon, "Secrets of
matrix factorization", 2015), and is reached from nearly everywhere, where alternation stalls.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .factor_data import Numbers, Observations
from .factor_kernels import frame_moments, invert_information
from .factor_moments import shape_moments
from .factor_start import RANK
from .polish_kernels import camera_gradient, eliminate_points, reduced_step

ACCURACY = 1e-3
"""Relative, of the solution of the normal equations."""
MOST_PRODUCTS = 500
FIRST_DAMPING = 1e-2
"""Of the mean of the diagonal."""
LEAST_DAMPING = 1e-12
BOLDNESS = 10.0
"""Factor by which damping falls after a step that lowered the error, and rises after one that did not. Bold
steps get past poor valleys: with gentler rules half of the random starts end in one."""
MOST_REJECTED = 20
"""Steps in a row; then there is no better place in reach."""
STILL = 3
"""Steps in a row that hardly lower the error: one may be short because it was damped."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Cameras and shape where the weighted squared error is least.

    Parameters
    ----------
    cameras, shape
        in the units of the observations.
    error
        weighted squared error.
    steps
        that were tried.
    """

    cameras: Numbers
    shape: Numbers
    error: float
    steps: int


def least_squares(
    observations: Observations,
    cameras: Numbers,
    *,
    tolerance: float = 1e-9,
    most_steps: int = 600,
    rank: int = RANK,
    enough: float = 0.0,
) -> LeastSquares:
    """Lower the squared error as far as it goes.

    Parameters
    ----------
    observations
        of points that are seen twice or more, in frames that show four or more; others are left alone.
    cameras
        `(n_frames, 2, 4)`, the start.
    tolerance
        share of the error by which the last steps still lowered it.
    most_steps
        to be tried.
    rank
        2 for a flat shape, whose third axis is 0.
    enough
        stop as soon as the error is not above this.
    """
    by_point = observations.by_point.columns
    edges, other, _, _, weight = by_point
    points = np.diff(edges) > 0
    certain = np.zeros((len(points), 3, 3))
    cameras, shape, factors, error = _eliminated(observations, cameras, points, rank)
    damping, rejected, small, better = FIRST_DAMPING, 0, 0, True
    for steps in range(1, most_steps + 1):  # noqa: B007
        if better:
            gradient = camera_gradient(*by_point, cameras, shape)
            information, _ = frame_moments(*observations.by_frame.columns, shape, shape_moments(shape, certain))
            scale = float(np.einsum("tjj->", information)) / (4 * len(cameras))
        added = damping * scale
        inverse, _ = invert_information(information, np.full(4, added), 1.0)
        system = (cameras, shape, factors, information, inverse, gradient, added)
        step = reduced_step(edges, other, weight, *system, ACCURACY, MOST_PRODUCTS)
        if damping <= FIRST_DAMPING and -float(np.sum(step * gradient)) <= tolerance * error:
            break  # even an undamped step would hardly gain
        *_, reached = eliminate_points(*by_point, cameras + step)
        better = reached < error
        if better:
            damping, rejected = max(damping / BOLDNESS, LEAST_DAMPING), 0
            small = small + 1 if error - reached <= tolerance * error else 0
            cameras, shape, factors, error = _eliminated(observations, cameras + step, points, rank)
            if small == STILL or error <= enough:
                break
        else:
            damping, rejected = damping * BOLDNESS, rejected + 1
            if rejected == MOST_REJECTED:
                break
    return LeastSquares(cameras, shape, error, steps)


def _eliminated(
    observations: Observations, cameras: Numbers, points: NDArray[np.bool_], rank: int
) -> tuple[Numbers, Numbers, Numbers, float]:
    """Cameras in a gauge of similar numbers everywhere, their best points, those' factors, and the error.

    Orthogonal columns, and a shape about the origin of size 1: the damping is then the same for all numbers.
    Medians, because points that two or three frames hardly determine may be anywhere.
    """
    columns, _ = np.linalg.qr(cameras[..., :3].reshape(-1, 3))
    moved = cameras.copy()
    columns[:, rank:] = 0
    moved[..., :3] = columns.reshape(-1, 2, 3)
    shape, _, _ = eliminate_points(*observations.by_point.columns, moved)
    middle = np.median(shape[points], axis=0)
    size = float(np.median(np.abs(shape[points, :rank] - middle[:rank]))) or 1.0
    moved[..., 3] += moved[..., :3] @ middle
    moved[..., :3] *= size
    shape, factors, error = eliminate_points(*observations.by_point.columns, moved)
    return moved, shape, factors, error

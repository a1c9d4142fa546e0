"""Weighted least squares to the optimum: variable projection with Levenberg-Marquardt damping.

The points that are best for given cameras have a closed form, so the squared error is a function of the
cameras alone. It has far fewer poor valleys than the error as a function of both (Hong and Fitzgibbon,
"Secrets of matrix factorization", 2015), and is reached from nearly everywhere, where alternation stalls.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .em import shape_moments
from .initialisation import RANK
from .kernels import camera_gradient, eliminate_points, frame_moments, invert_information, reduced_step
from .observations import Numbers, Observations

ACCURACY = 1e-3
"""Relative, of the solution of the normal equations."""
MOST_PRODUCTS = 500
FAR, NEAR = 1.0, 1e-2
"""First damping, of the mean of the diagonal, from anywhere and from near the optimum."""
LEAST_DAMPING = 1e-12
BOLDNESS = 10.0
"""Factor by which damping falls after a step that lowered the error, and rises after one that did not. Bold
steps get past poor valleys: with gentler rules half of the random starts end in one."""
MOST_REJECTED = 20
"""Steps in a row; then there is no better place in reach."""
STILL = 3
"""Steps in a row that hardly lower the error: one may be short because it was damped."""


class System(NamedTuple):
    """Normal equations of the cameras, with points eliminated.

    Parameters
    ----------
    cameras, shape, inverses
        cameras `(n_frames, 2, 4)`, the points `(n_points, 3)` that `eliminate_points` gives for them, and the
        inverses `(n_points, 3, 3)` of these points' information.
    information, preconditioner
        `(n_frames, 4, 4)` of the cameras at fixed points, and the inverse of it plus `damping`.
    gradient
        `(n_frames, 2, 4)`, of `camera_gradient`.
    damping
        added to the diagonal.
    """

    cameras: Numbers
    shape: Numbers
    inverses: Numbers
    information: Numbers
    preconditioner: Numbers
    gradient: Numbers
    damping: float


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
    damping: float = FAR,
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
    damping
        `FAR` or `NEAR`: how far that is from the optimum.
    tolerance
        share of the error by which the last steps still lowered it.
    most_steps
        to be tried.
    rank
        2 for a flat shape, whose third axis is 0.
    enough
        stop as soon as the error is not above this.
    """
    by_point, by_frame = observations.by_point, observations.by_frame
    points = np.diff(by_point.edges) > 0
    certain = np.zeros((len(points), RANK, RANK))
    cameras = cameras.copy()
    cameras[..., rank:RANK] = 0
    shape, inverses, error = eliminate_points(by_point, cameras)
    cameras, shape, inverses = _in_gauge(cameras, shape, inverses, points, rank)
    rejected, small, better = 0, 0, True
    for steps in range(1, most_steps + 1):  # noqa: B007
        if better:
            gradient = camera_gradient(by_point, cameras, shape)
            information, _ = frame_moments(by_frame, shape, shape_moments(shape, certain))
            scale = float(np.einsum("tjj->", information)) / (4 * len(cameras))
        added = damping * scale
        inverse, _ = invert_information(information, np.full(4, added), 1.0)
        system = System(cameras, shape, inverses, information, inverse, gradient, added)
        step = reduced_step(by_point, by_frame, system, ACCURACY, MOST_PRODUCTS)
        with np.errstate(over="ignore", invalid="ignore"):  # steps may run away where damping is too small
            promised = -float(np.sum(step * gradient))
        if damping <= NEAR and promised <= tolerance * error:
            break  # even an undamped step would hardly gain
        reached, spreads, left = eliminate_points(by_point, cameras + step)
        better = left < error
        if better:
            damping, rejected = max(damping / BOLDNESS, LEAST_DAMPING), 0
            small = small + 1 if error - left <= tolerance * error else 0
            error = left
            cameras, shape, inverses = _in_gauge(cameras + step, reached, spreads, points, rank)
            if small == STILL or error <= enough:
                break
        else:
            damping, rejected = damping * BOLDNESS, rejected + 1
            if rejected == MOST_REJECTED:
                break
    return LeastSquares(cameras, shape, error, steps)


def _in_gauge(
    cameras: Numbers, shape: Numbers, inverses: Numbers, points: NDArray[np.bool_], rank: int
) -> tuple[Numbers, Numbers, Numbers]:
    """Cameras, points and inverses of the points' information in a gauge of similar numbers everywhere.

    Orthogonal columns, and a shape about the origin of size 1: the damping is then the same for all numbers.
    Medians, because points that two or three frames hardly determine may be anywhere.
    """
    columns, triangle = np.linalg.qr(cameras[..., :rank].reshape(-1, rank))
    turn = np.zeros((RANK, RANK))
    turn[:rank, :rank] = triangle
    turned = shape @ turn.T
    middle = np.median(turned[points], axis=0)
    size = float(np.median(np.abs(turned[points, :rank] - middle[:rank]))) or 1.0
    moved = np.zeros_like(cameras)
    moved[..., :rank] = columns.reshape(-1, 2, rank) * size
    moved[..., 3] = cameras[..., 3] + columns.reshape(-1, 2, rank) @ middle[:rank]
    turn /= size
    return moved, turned / size - middle / size, turn @ inverses @ turn.T

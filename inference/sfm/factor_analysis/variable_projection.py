"""Weighted least squares to the optimum: variable projection with Levenberg-Marquardt damping.

The points that are best for given cameras have a closed form, so the squared error is a function of the
cameras alone. It has far fewer poor valleys than the error as a function of both (Hong and Fitzgibbon,
"Secrets of matrix factorization", 2015), and is reached from nearly everywhere, where alternation stalls.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...least_squares import Damping, levenberg_marquardt
from .em import shape_moments
from .initialisation import RANK
from .kernels import camera_gradient, eliminate_points, frame_moments, invert_information, reduced_step
from .observations import Numbers, Observations

ACCURACY = 1e-3
"""Relative, of the solution of the normal equations."""
MOST_PRODUCTS = 500
FAR, NEAR = 1.0, 1e-2
"""First damping, of the mean of the diagonal, from anywhere and from near the optimum. It changes by bold
factors of ten, which get past poor valleys: with gentler ones half of the random starts end in one."""
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e12
STILL = 3
"""Steps in a row that hardly lower the error: one may be short because it was damped."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Cameras and shape, and the weighted squared error that they leave.

    Parameters
    ----------
    cameras, shape
        in the units of the observations.
    inverses
        `(n_points, 3, 3)` of the points' information.
    error
        weighted squared error.
    """

    cameras: Numbers
    shape: Numbers
    inverses: Numbers
    error: float


def variable_projection(
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

    def linearised(at: LeastSquares) -> Callable[[float], LeastSquares | None]:
        if at.error <= enough:
            return lambda damping: at
        gradient = camera_gradient(by_point, at.cameras, at.shape)
        information, _ = frame_moments(by_frame, at.shape, shape_moments(at.shape, certain))
        scale = float(np.einsum("tjj->", information)) / (4 * len(at.cameras))

        def step(damping: float) -> LeastSquares | None:
            added = damping * scale
            preconditioner, _ = invert_information(information, np.full(4, added), 1.0)
            moved = reduced_step(
                by_point, by_frame, at.cameras, at.shape, at.inverses, information, preconditioner, gradient,
                added, ACCURACY, MOST_PRODUCTS,
            )  # fmt: skip
            with np.errstate(over="ignore", invalid="ignore"):  # where damping is too small it may run away
                promised = -float(np.sum(moved * gradient))
            if damping <= NEAR and promised <= tolerance * at.error:
                return at  # even an undamped step would hardly gain
            shape, inverses, error = eliminate_points(by_point, at.cameras + moved)
            if not error < at.error:
                return None
            return LeastSquares(*_in_gauge(at.cameras + moved, shape, inverses, points, rank), error)

        return step

    cameras = cameras.copy()
    cameras[..., rank:RANK] = 0
    shape, inverses, error = eliminate_points(by_point, cameras)
    return levenberg_marquardt(
        LeastSquares(*_in_gauge(cameras, shape, inverses, points, rank), error),
        linearised,
        lambda before, after: before.error - after.error <= tolerance * before.error,
        Damping(damping, least=LEAST_DAMPING, most=MOST_DAMPING),
        most_steps=most_steps,
        patience=STILL,
    ).place


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

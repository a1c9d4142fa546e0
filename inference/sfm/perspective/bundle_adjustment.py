"""Bundle adjustment: cameras, focal length and points to the likeliest at once, whatever is missing.

Levenberg-Marquardt on the log likelihood under Student's noise, each step weighted least squares
(iteratively reweighted); the points are eliminated from the normal equations (Schur complement; Triggs,
McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from ....models.camera.perspective_camera import NEAREST, PerspectiveCameras
from ....models.numerics.rotations import exponential
from ..factor_analysis.observations import Listed, Numbers
from .kernels.bundle_adjustment import CAMERA, eliminated, normal_equations, put_in, squared_distances
from .kernels.triangulation import triangulate
from .student_noise import StudentNoise

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e8
"""Share of the diagonal that is added to it."""

BEHIND = 1e6
"""px^2: the squared distance that stands for a point behind a camera, and the largest that is told apart."""

GAUGE = 7
"""Numbers of a shape's place, turn and size, which no film shows."""


class Sums(NamedTuple):
    """What `normal_equations` gives; see there."""

    cameras: Numbers
    camera_vector: Numbers
    border: Numbers
    corner: float
    corner_vector: float
    points: Numbers
    point_vector: Numbers
    mixed: Numbers
    mixed_border: Numbers


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras and points, the noise about what they predict, and how likely that is.

    Parameters
    ----------
    cameras
        of all frames.
    shape
        `(n_points, 3)`.
    noise
        px^2 at weight 1.
    log_likelihood
        of all observations, nats.
    steps
        that were tried.
    """

    cameras: PerspectiveCameras
    shape: Numbers
    noise: StudentNoise
    log_likelihood: float
    steps: int


def about(by_point: Listed, principal: Numbers) -> Listed:
    """Observations in px from the principal point `(2,)`, as everything in here takes them."""
    return by_point._replace(x=by_point.x - principal[0], y=by_point.y - principal[1])


def freedom(listed: Listed, *, focal_known: bool) -> int:
    """How many numbers are fitted: of frames and points with observations, and of the focal length."""
    n_frames = len(np.unique(listed.other))
    n_points = np.count_nonzero(np.diff(listed.edges))
    return int(CAMERA * n_frames + 3 * n_points - GAUGE + (not focal_known))


def squares_of(listed: Listed, cameras: PerspectiveCameras, shape: Numbers) -> Numbers:
    """Squared distances `(n,)` px^2 between observations and where they should be."""
    squares: Numbers = squared_distances(
        listed, cameras.rotations, cameras.scales, cameras.shifts, cameras.curvature, shape, NEAREST, BEHIND
    )
    return squares


def adjust(
    listed: Listed,
    cameras: PerspectiveCameras,
    shape: Numbers,
    *,
    focal_known: bool,
    most_steps: int = 100,
    tolerance: float = 0.1,
) -> Bundle:
    """Go to the optimum from a start.

    Parameters
    ----------
    listed
        observations by point, of `about`, those of a point in the order of their frames.
    cameras, shape
        the start; `shape` is `(n_points, 3)`.
    focal_known
        keep the focal length as it is.
    most_steps, tolerance
        at most so many, and until three in a row gain less than so many nats each.
    """
    squares = squares_of(listed, cameras, shape)
    noise = StudentNoise.of_errors(squares, listed.weight)
    likelihood = noise.log_likelihood(squares, listed.weight)
    damping, small, sums, steps = FIRST_DAMPING, 0, None, 0
    for steps in range(1, most_steps + 1):  # noqa: B007
        if sums is None:
            sums = sums_of(listed, noise.weights(squares, listed.weight), cameras, shape)
        moved = _step(listed, sums, damping, cameras, shape, focal_known)
        reached = None if moved is None else squares_of(listed, *moved)
        if moved is None or reached is None or noise.log_likelihood(reached, listed.weight) <= likelihood:
            damping *= 10
            if damping > MOST_DAMPING:
                break
            continue
        (cameras, shape), squares, sums = moved, reached, None
        noise = noise.rescaled(squares, listed.weight)
        better = noise.log_likelihood(squares, listed.weight)
        small = small + 1 if better - likelihood < tolerance else 0
        likelihood, damping = better, max(damping / 10, LEAST_DAMPING)
        if small == 3:
            break
    return Bundle(cameras, shape, noise, likelihood, steps)


def retriangulated(listed: Listed, found: Bundle) -> Numbers:
    """Points `(n_points, 3)` for the cameras of a bundle, none of them less likely than its own.

    A step moves all points at once, and leaves behind what has gone to the wrong side of a camera.
    """
    cameras, noise, shape = found.cameras, found.noise, found.shape.copy()
    views = cameras.rotations, cameras.scales, cameras.shifts, cameras.curvature
    triangulate(listed, views, shape, (noise.variance, noise.freedom, NEAREST, BEHIND))
    return shape


def sums_of(listed: Listed, weights: Numbers, cameras: PerspectiveCameras, shape: Numbers) -> Sums:
    """Normal equations at the weights `(n,)` of observations."""
    return Sums(
        *normal_equations(
            listed,
            weights,
            cameras.rotations,
            cameras.scales,
            cameras.shifts,
            cameras.curvature,
            shape,
            NEAREST,
        )
    )


def reduced(
    listed: Listed, sums: Sums, damping: float, *, focal_known: bool
) -> tuple[Numbers, Numbers, Numbers]:
    """Normal equations of cameras and q `(6 n_frames + 1, ...)`, and inverse blocks `(n_points, 3, 3)`."""
    n_frames = len(sums.cameras)
    matrix, vector = np.zeros((CAMERA * n_frames + 1,) * 2), np.zeros(CAMERA * n_frames + 1)
    blocks = matrix[:-1, :-1].reshape(n_frames, CAMERA, n_frames, CAMERA)
    blocks[np.arange(n_frames), :, np.arange(n_frames)] = sums.cameras
    matrix[-1, :-1] = sums.border.reshape(-1)
    matrix[-1, -1] = sums.corner
    vector[:-1], vector[-1] = sums.camera_vector.reshape(-1), sums.corner_vector
    matrix[np.diag_indices_from(matrix)] *= 1 + damping
    points = sums.points.copy()
    size = np.einsum("ijj->i", points)
    # a point of one frame has no depth: rounding must not decide on it
    points[:, range(3), range(3)] += damping * points[:, range(3), range(3)] + 1e-12 * size[:, None] + 1e-30
    inverses = np.ascontiguousarray(np.linalg.inv(points))
    mixed_border = sums.mixed_border
    if focal_known:
        mixed_border = np.zeros_like(mixed_border)
        matrix[-1, :] = 0
        matrix[-1, -1], vector[-1] = 1, 0
    eliminated(listed, inverses, sums.mixed, mixed_border, sums.point_vector, matrix, vector)
    return matrix, vector, inverses


def _step(
    listed: Listed,
    sums: Sums,
    damping: float,
    cameras: PerspectiveCameras,
    shape: Numbers,
    focal_known: bool,
) -> tuple[PerspectiveCameras, Numbers] | None:
    """Cameras and shape after a step; `None` if the normal equations are not positive definite."""
    matrix, vector, inverses = reduced(listed, sums, damping, focal_known=focal_known)
    diagonal = np.diag(matrix)
    if diagonal.min() <= 0:
        return None
    size = np.sqrt(diagonal)
    matrix = matrix / size[:, None] / size
    try:
        step = cho_solve(cho_factor(matrix, lower=True), vector / size) / size
    except LinAlgError:
        return None
    if not np.isfinite(step).all():
        return None
    by_camera = step[:-1].reshape(-1, CAMERA)
    moved = replace(
        cameras,
        rotations=exponential(by_camera[:, :3]) @ cameras.rotations,
        scales=cameras.scales * np.exp(np.clip(by_camera[:, 3], -1, 1)),
        shifts=cameras.shifts + by_camera[:, 4:],
        curvature=cameras.curvature + float(step[-1]),
    )
    return moved, shape + put_in(listed, inverses, sums.mixed, sums.mixed_border, sums.point_vector, step)

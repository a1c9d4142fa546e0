"""Bundle adjustment: cameras, focal length and points to the likeliest at once, whatever is missing.

Levenberg-Marquardt on the log likelihood under Student's noise, each step weighted least squares
(iteratively reweighted); the points are eliminated from the normal equations (Schur complement; Triggs,
McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_array

from ....models.camera.perspective_camera import NEAREST, PerspectiveCameras
from ....models.numerics.rotations import exponential
from ...least_squares import Damping, levenberg_marquardt
from ..factor_analysis.observations import Listed, Numbers
from .kernels import (
    CAMERA,
    eliminated,
    normal_equations,
    prediction_covariances,
    put_in,
    squared_distances,
    triangulate,
)
from .student_noise import StudentNoise

DAMPING = Damping(1e-3, least=1e-9, most=1e9)
STILL = 3
"""Steps in a row that hardly gain: one may be short because it was damped."""

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
    """

    cameras: PerspectiveCameras
    shape: Numbers
    noise: StudentNoise
    log_likelihood: float


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

    def linearised(at: Bundle) -> Callable[[float], Bundle | None]:
        squares = squares_of(listed, at.cameras, at.shape)
        sums = sums_of(listed, at.noise.weights(squares, listed.weight), at.cameras, at.shape)

        def step(damping: float) -> Bundle | None:
            moved = _moved(listed, sums, damping, at, focal_known)
            if moved is None:
                return None
            squares = squares_of(listed, *moved)
            if at.noise.log_likelihood(squares, listed.weight) <= at.log_likelihood:
                return None
            noise = at.noise.rescaled(squares, listed.weight)
            return Bundle(*moved, noise, noise.log_likelihood(squares, listed.weight))

        return step

    return levenberg_marquardt(
        Bundle(cameras, shape, noise, noise.log_likelihood(squares, listed.weight)),
        linearised,
        lambda before, after: after.log_likelihood - before.log_likelihood < tolerance,
        DAMPING,
        most_steps=most_steps,
        patience=STILL,
    ).place


def retriangulated(listed: Listed, found: Bundle) -> Numbers:
    """Points `(n_points, 3)` for the cameras of a bundle, none of them less likely than its own.

    A step moves all points at once, and leaves behind what has gone to the wrong side of a camera.
    """
    cameras, noise, shape = found.cameras, found.noise, found.shape.copy()
    triangulate(
        listed, cameras.rotations, cameras.scales, cameras.shifts, cameras.curvature, shape,
        noise.variance, noise.freedom, NEAREST, BEHIND,
    )  # fmt: skip
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


def _moved(
    listed: Listed, sums: Sums, damping: float, at: Bundle, focal_known: bool
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
    by_camera, cameras = step[:-1].reshape(-1, CAMERA), at.cameras
    moved = replace(
        cameras,
        rotations=exponential(by_camera[:, :3]) @ cameras.rotations,
        scales=cameras.scales * np.exp(np.clip(by_camera[:, 3], -1, 1)),
        shifts=cameras.shifts + by_camera[:, 4:],
        curvature=cameras.curvature + float(step[-1]),
    )
    return moved, at.shape + put_in(listed, inverses, sums.mixed, sums.mixed_border, sums.point_vector, step)


HELD = 1e6
"""Information on the gauge, in that on a number of a camera: so much that it does not vary."""
OPEN = 1e-10
"""Information, in that on a number of a camera if all points were known, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class BundleCovariance:
    """To first order, in the gauge (place, turn and size of the shape) in which cameras vary least.

    Parameters
    ----------
    cameras
        `(n_frames, 7, 7)`: of turn, log scale and shift of each frame, and of 1 / focal length.
    points
        `(n_points, 3, 3)`.
    points_and_cameras
        `(n_points, 3, 6 n_frames + 1)`, the last number 1 / focal length.
    """

    cameras: Numbers
    points: Numbers
    points_and_cameras: Numbers

    @property
    def curvature_deviation(self) -> float:
        """Standard deviation of 1 / focal length, 1/px; 0 where that was given."""
        return float(np.sqrt(self.cameras[0, -1, -1]))


def covariance_of(listed: Listed, found: Bundle, prior: Numbers, *, focal_known: bool) -> BundleCovariance:
    """Uncertainty at the optimum, from the information of all observations (Laplace).

    Parameters
    ----------
    listed
        observations by point, of `about`; each frame has some.
    found
        the optimum.
    prior
        `(3, 3)`, covariance of points before anything is seen: what is known of one of a single frame.
    focal_known
        whether the focal length was given.
    """
    squares = squares_of(listed, found.cameras, found.shape)
    precision = found.noise.precision(squares, listed.weight, freedom(listed, focal_known=focal_known))
    # on the whole as Huber has it; an outlier, whose place depends on nothing, says nothing of cameras
    counted = found.noise.weights(squares, listed.weight)
    counted *= precision * listed.weight.mean() / counted.mean()
    sums = sums_of(listed, counted, found.cameras, found.shape)
    sums = sums._replace(points=sums.points + np.linalg.inv(prior))
    whole, inverses = _of_cameras(listed, sums, found.cameras, focal_known=focal_known)

    n_frames, n_points = len(found.cameras.scales), len(found.shape)
    columns = CAMERA * listed.other[:, None] + np.arange(CAMERA)
    rows = 3 * listed.own[:, None] + np.arange(3)
    where = (
        np.broadcast_to(rows[:, :, None], sums.mixed.shape).reshape(-1),
        np.broadcast_to(columns[:, None, :], sums.mixed.shape).reshape(-1),
    )
    mixed = csr_array((sums.mixed.reshape(-1), where), shape=(3 * n_points, CAMERA * n_frames))
    reach = (mixed @ whole[:-1] + sums.mixed_border.reshape(-1, 1) * whole[-1]).reshape(n_points, 3, -1)
    inside = np.zeros((n_points, 3, 3))
    np.add.at(
        inside, listed.own, np.einsum("kim,kmj->kij", sums.mixed, reach[listed.own[:, None], :, columns])
    )
    inside += sums.mixed_border[:, :, None] * reach[:, None, :, -1]
    points = inverses + inverses @ inside @ inverses

    frames = CAMERA * np.arange(n_frames)[:, None] + np.arange(CAMERA)
    frames = np.concatenate([frames, np.full((n_frames, 1), CAMERA * n_frames)], axis=1)
    return BundleCovariance(
        whole[frames[:, :, None], frames[:, None, :]],
        0.5 * (points + points.transpose(0, 2, 1)),
        -inverses @ reach,
    )


def _of_cameras(
    listed: Listed, sums: Sums, cameras: PerspectiveCameras, *, focal_known: bool
) -> tuple[Numbers, Numbers]:
    """Covariance of all cameras and 1 / focal length, and of points given those."""
    matrix, _, inverses = reduced(listed, sums, 0.0, focal_known=focal_known)
    matrix = np.tril(matrix) + np.tril(matrix, -1).T
    of_points_known = np.append(np.einsum("tjj->tj", sums.cameras), 1.0 if focal_known else sums.corner)
    size = np.sqrt(of_points_known)
    gauge, _ = np.linalg.qr(size[:, None] * gauge_of(cameras))
    values, axes = np.linalg.eigh(matrix / size[:, None] / size + HELD * gauge @ gauge.T)
    axes /= size[:, None]
    whole: Numbers = (axes / np.maximum(values, OPEN)) @ axes.T
    if focal_known:
        whole[-1, :] = whole[:, -1] = 0
    return whole, inverses


def gauge_of(cameras: PerspectiveCameras) -> Numbers:
    """By which changes of cameras and q `(6 n_frames + 1, 7)` the shape may turn, grow and move unseen."""
    n_frames, rotations = len(cameras.scales), cameras.rotations
    changes = np.zeros((n_frames, CAMERA, GAUGE))
    changes[:, :3, :3] = -rotations
    changes[:, 3, 3] = -1
    deeper = cameras.curvature * cameras.scales[:, None] * rotations[:, 2]
    changes[:, 3, 4:] = deeper
    changes[:, 4:, 4:] = (
        cameras.shifts[:, :, None] * deeper[:, None] - cameras.scales[:, None, None] * rotations[:, :2]
    )
    return np.concatenate([changes.reshape(-1, GAUGE), np.zeros((1, GAUGE))])


def predicted(found: Bundle, covariance: BundleCovariance) -> tuple[Numbers, Numbers]:
    """Positions of all points in all frames, and how uncertain cameras and shape leave them.

    Returns
    -------
    positions
        `(n_frames, n_points, 2)` px.
    covariances
        `(n_frames, n_points, 2, 2)` px^2, without the noise of observations.
    """
    cameras = found.cameras
    positions, _ = cameras.seen(found.shape)
    covariances: Numbers = prediction_covariances(
        cameras.rotations, cameras.scales, cameras.shifts, cameras.curvature, found.shape,
        covariance.cameras, covariance.points, covariance.points_and_cameras,
    )  # fmt: skip
    return positions, covariances

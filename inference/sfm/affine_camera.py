"""Affine cameras: what makes them cameras of a rigid world, and shapes that are alike up to a transformation.

A factorisation knows shape and cameras up to an affine change of space. Under scaled orthography the rows of
a camera are of equal length and orthogonal, which fixes that up to a similarity and a reflection - if the
motion is rich enough.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..optimisation import Damping, levenberg_marquardt

Array = NDArray[np.float64]

LEAST_VIEWS = 3  # two views of a rigid shape leave its depth open (bas-relief)
DETERMINED = 0.1  # standard deviation of the log of stretches of space with which a metric is one
CLEAR = 4.0  # by what factor a direction must stand out of what noise alone would make of one (in squares)
FLAT = 1e-10  # share of the cameras' squares that is rounding
OPEN = 1e-12  # share of the information on stretches that is rounding
MOST_STEPS = 100
DAMPING = Damping(1e-3, most=1e13)
SHORT = 1e-12  # step, a change of the logarithm of a stretch, that is the last
FLATTISH = "no depth is visible: the camera does not rotate out of the image plane, or the scene is flat"
HARDLY = "the camera hardly rotates out of the image plane"

_BASIS = np.array(
    [
        np.diag([1, -1, 0]) / np.sqrt(2),
        np.diag([1, 1, -2]) / np.sqrt(6),
        np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]) / np.sqrt(2),
        np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0]]) / np.sqrt(2),
        np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]]) / np.sqrt(2),
    ]
)
"""Of symmetric matrices without trace: stretches of space that are no mere scaling."""


@dataclass(frozen=True, eq=False)
class Euclidean:
    """Shape and cameras in a space with right angles, or why they are not known in one.

    Parameters
    ----------
    determined, reason
        whether the motion determines it, and one line with the reason if not. Then `shape` and `cameras` are
        those given, `transform` is the identity, and scales and rotations are NaN.
    transform
        `(3, 3)`: shape = given shape @ transform.T.
    shape
        `(n_points, 3)`, axes as in the first view (x right, y down), in px as they are seen on average. Only
        up to reflection: z may as well be -z.
    cameras
        `(n_frames, 2, 4)`; together with `shape` they predict what the given ones did.
    scales, rotations
        `(n_frames,)` and `(n_frames, 3, 3)`: scale * the first two rows of the rotation come nearest to a
        camera's first three columns.
    uncertainty
        standard deviation of the log stretch that is known least; infinite if none are.
    """

    determined: bool
    reason: str
    transform: Array
    shape: Array
    cameras: Array
    scales: Array
    rotations: Array
    uncertainty: float


def euclidean(cameras: ArrayLike, shape: ArrayLike, camera_covariance: ArrayLike | None = None) -> Euclidean:
    """Find the Euclidean upgrade, in which rows of affine cameras are orthogonal and of equal length.

    Scaled orthography: each camera may have its own scale. The symmetric matrix Q = G G^T with u Q v = 0 and
    u Q u = v Q v for the rows u, v of all frames is found by linear least squares, made positive definite,
    then refined so that relative errors are weighted by the cameras' uncertainty.

    Parameters
    ----------
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`.
    camera_covariance
        `(n_frames, 4, 4)` of the rows of u and of v. Default: the variance of the rows' deviations, equal in
        all frames.

    Raises
    ------
    ValueError
        if shapes do not fit, or cameras are not finite.
    """
    matrices, points = np.asarray(cameras, np.float64), np.asarray(shape, np.float64)
    if matrices.ndim != 3 or matrices.shape[1:] != (2, 4) or not np.isfinite(matrices).all():
        raise ValueError(f"cameras: got {matrices.shape}, expected finite (n_frames, 2, 4)")
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"shape: got {points.shape}, expected (n_points, 3)")
    spread = None
    if camera_covariance is not None:
        spread = np.asarray(camera_covariance, np.float64)
        if spread.shape != (len(matrices), 4, 4):
            raise ValueError(f"camera_covariance: got {spread.shape}, expected {(len(matrices), 4, 4)}")
        spread = spread[:, :3, :3]
    if len(matrices) < LEAST_VIEWS:
        return _undetermined(matrices, points, f"{len(matrices)} views do not fix depth, {LEAST_VIEWS} may")
    rows = matrices[..., :3]
    values, axes = np.linalg.eigh(np.einsum("tcj,tck->jk", rows, rows))
    if values[0] <= FLAT * values[-1]:
        return _undetermined(matrices, points, FLATTISH)
    if spread is not None and not _stands_out(rows, spread, len(points)):
        return _undetermined(matrices, points, FLATTISH)
    white = axes / np.sqrt(values / len(rows))
    try:
        upgrade, uncertainty = _refined(rows, spread, white @ _linear_metric(rows @ white))
    except np.linalg.LinAlgError:
        return _undetermined(matrices, points, HARDLY)
    if not uncertainty < DETERMINED:
        reason = (
            HARDLY if np.isinf(uncertainty) else f"{HARDLY}: stretches are known to {uncertainty:.0%} only"
        )
        return _undetermined(matrices, points, reason, uncertainty)
    scales, rotations = scaled_rotations(rows @ upgrade)
    size = float(np.exp(np.mean(np.log(scales))))
    first = rotations[0]
    transform = size * first @ np.linalg.inv(upgrade)
    back = np.linalg.inv(transform)
    return Euclidean(
        determined=True,
        reason="",
        transform=transform,
        shape=points @ transform.T,
        cameras=np.concatenate([rows @ back, matrices[..., 3:]], axis=2),
        scales=scales / size,
        rotations=rotations @ first.T,
        uncertainty=uncertainty,
    )


def _undetermined(cameras: Array, shape: Array, reason: str, uncertainty: float = np.inf) -> Euclidean:
    nothing = np.full((len(cameras), 3, 3), np.nan)
    return Euclidean(False, reason, np.eye(3), shape, cameras, nothing[:, 0, 0], nothing, uncertainty)


def _stands_out(rows: Array, spread: Array, n_points: int) -> bool:
    """Whether all three directions are more than noise: singular values of a random matrix are known."""
    noise = 2 * spread.sum(axis=0)
    values, axes = np.linalg.eigh(noise)
    if values[0] <= 0:
        return True
    white = axes / np.sqrt(values)
    ratio = np.linalg.eigvalsh(white.T @ np.einsum("tcj,tck->jk", rows, rows) @ white)[0]
    by_chance = (1 + np.sqrt(n_points / (2 * len(rows)))) ** 2
    return bool(ratio > CLEAR * by_chance)


def _linear_metric(rows: Array) -> Array:
    """Square root `(3, 3)` of the positive definite matrix nearest to the linear solution."""
    first, second = np.triu_indices(3)
    double = np.where(first == second, 1.0, 2.0)

    def product(one: Array, other: Array) -> Array:
        """Return coefficients of one . Q other."""
        return 0.5 * (one[:, first] * other[:, second] + one[:, second] * other[:, first]) * double

    u, v = rows[:, 0], rows[:, 1]
    size = np.sum(rows**2, axis=(1, 2))[:, None]
    system = np.concatenate([(product(u, u) - product(v, v)) / size, 2 * product(u, v) / size])
    metric = np.zeros((3, 3))
    metric[first, second] = np.linalg.svd(system)[2][-1] / np.sqrt(double)  # norm of Q, not of its upper half
    metric = metric + np.triu(metric, 1).T
    metric *= np.sign(np.trace(metric)) or 1.0
    values, axes = np.linalg.eigh(metric)
    root: Array = axes * np.sqrt(np.maximum(values, 1e-2 * values[-1]))
    return root


@dataclass(frozen=True, eq=False)
class _Metric:
    """A root G of the metric, and errors `(2 n_frames,)` of rows in it with weights and derivatives by E.

    Errors are (|u|^2 - |v|^2) / (|u|^2 + |v|^2) and 2 u . v / (|u|^2 + |v|^2); `step` is the largest number
    of the E of the last step G <- G exp(E).
    """

    root: Array
    errors: Array
    jacobian: Array
    weight: Array
    step: float

    @property
    def normal(self) -> Array:
        """`(5, 5)`."""
        return self.jacobian.T @ (self.weight[:, None] * self.jacobian)

    def squares(self, errors: Array) -> float:
        """Sum of squared errors, weighted as they are here: weights depend on G."""
        return float(np.sum(self.weight * errors**2))


def _refined(rows: Array, spread: Array | None, root: Array) -> tuple[Array, float]:
    """Improve G by steps G <- G exp(E); and give the largest standard deviation of E."""

    def linearised(at: _Metric) -> Callable[[float], _Metric | None]:
        normal, pull = at.normal, at.jacobian.T @ (at.weight * at.errors)

        def step(damping: float) -> _Metric | None:
            change = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), pull)
            values, axes = np.linalg.eigh(np.tensordot(change, _BASIS, 1))
            moved = at.root @ (axes * np.exp(np.clip(values, -1, 1))) @ axes.T
            reached = _metric(rows, spread, moved, float(np.abs(change).max()))
            return reached if at.squares(reached.errors) <= at.squares(at.errors) else None

        return step

    found = levenberg_marquardt(
        _metric(rows, spread, root, np.inf),
        linearised,
        lambda before, after: after.step < SHORT,
        DAMPING,
        most_steps=MOST_STEPS,
    )[0]
    known = np.linalg.eigvalsh(found.normal)
    if known[0] <= OPEN * known[-1]:
        return found.root, np.inf
    deviation = found.squares(found.errors) / max(len(found.errors) - len(_BASIS), 1)
    inflation = deviation if spread is None else max(deviation, 1.0)
    return found.root, float(np.sqrt(inflation / known[0]))


def _metric(rows: Array, spread: Array | None, root: Array, step: float) -> _Metric:
    moved = rows @ root
    u, v = moved[:, 0], moved[:, 1]
    size = np.sum(moved**2, axis=(1, 2))
    uu, vv, uv = (np.einsum("tj,njk,tk->tn", a, _BASIS, b) for a, b in ((u, u), (v, v), (u, v)))
    difference = (np.sum(u**2, axis=1) - np.sum(v**2, axis=1)) / size
    product = 2 * np.sum(u * v, axis=1) / size
    grown = 2 * (uu + vv) / size[:, None]
    jacobian = np.concatenate(
        [
            2 * (uu - vv) / size[:, None] - difference[:, None] * grown,
            4 * uv / size[:, None] - product[:, None] * grown,
        ]
    )
    if spread is None:
        weight = np.ones(len(rows))
    else:
        # first order: both errors have 4 (u C u + v C v) / size^2, uncorrelated
        inside = root.T @ spread @ root
        weight = size**2 / (4 * np.einsum("tcj,tjk,tck->t", moved, inside, moved) + 1e-300)
    errors = np.concatenate([difference, product])
    return _Metric(root, errors, jacobian, np.concatenate([weight, weight]), step)


def scaled_rotations(matrices: ArrayLike) -> tuple[Array, Array]:
    """Return scales `(n,)` and rotations `(n, 3, 3)` whose scaled first rows are nearest to `(n, 2, 3)`."""
    left, values, right = np.linalg.svd(np.asarray(matrices, np.float64), full_matrices=False)
    rows = left @ right
    third = np.cross(rows[:, 0], rows[:, 1])
    return values.mean(axis=1), np.concatenate([rows, third[:, None]], axis=1)


# --- shapes that are alike ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Alignment:
    """A shape brought onto another: aligned `(n_points, 3)` = shape @ matrix.T + translation.

    `error` is the root mean square distance that is left, in the target's unit.
    """

    matrix: Array
    translation: Array
    aligned: Array
    error: float


def affine_alignment(shape: ArrayLike, target: ArrayLike) -> Alignment:
    """Return the affine map of a shape `(n_points, 3)` onto another, by least squares."""
    points, goal = np.asarray(shape, np.float64), np.asarray(target, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != goal.shape or not len(points):
        raise ValueError(
            f"shape, target: got {points.shape} and {goal.shape}, expected the same (n_points, 3)"
        )
    middle, goal_middle = points.mean(axis=0), goal.mean(axis=0)
    matrix = np.asarray(np.linalg.lstsq(points - middle, goal - goal_middle)[0].T, np.float64)
    aligned = (points - middle) @ matrix.T
    error = float(np.sqrt(np.mean(np.sum((aligned - (goal - goal_middle)) ** 2, axis=1))))
    return Alignment(matrix, goal_middle - matrix @ middle, aligned + goal_middle, error)

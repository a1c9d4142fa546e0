"""Poses from landmarks: closed forms for a rigid object, then Gauss-Newton with all morphs."""

import numpy as np
from numpy.typing import NDArray

from ...models.face.morphable_model import RIGID, MorphableModel, Poses, SurfacePoints

Array = NDArray[np.float64]

LANDMARK_NOISE = 0.03  # standard deviation of a landmark in units of c_1: about 2 % of a face's width
MIN_LANDMARKS = 4  # of a frame: three determine a rigid object, but leave its depth ambiguous
_BATCH = 256  # frames fitted at once, which bounds the memory of their Jacobians

_MOST_STEPS = 60  # Levenberg-Marquardt steps
_SMALL_STEP = 1e-6  # step (rad, and share of the object's size) that ends a fit
_DEPTH_DOUBT = 0.05  # standard deviation of points from the typical shape at the start, in units of c_1


def fit_landmarks(
    model: MorphableModel,
    landmarks: Array,
    points: SurfacePoints | None = None,
    start: Poses | None = None,
    noise: float = LANDMARK_NOISE,
) -> Poses:
    """Return the most probable poses in which points of the object are seen at landmarks.

    Landmarks have Gaussian noise, and shapes are as probable as c_j / c_1 being standard normal for
    j > 1; nothing is known of where and how turned the object is. All frames are fitted at once, each
    for itself.

    Parameters
    ----------
    model
        of the object.
    landmarks
        `(n_landmarks, 2)` or `(n_frames, n_landmarks, 2)` px, NaN where missing; at least four a frame,
        with fewer than six or seven an object may come out turned as its mirror image in depth would be.
    points
        of the object at the landmarks. By default the model's own landmarks, if there are as many (those
        without a vertex are passed over), or else its vertices.
    start
        poses to start from, one a frame or one for all. By default each frame starts from closed forms.
    noise
        standard deviation of a landmark, each coordinate, in units of c_1.

    Returns
    -------
    Poses
        one a frame.

    Raises
    ------
    ValueError
        if landmarks are not as many as points, are infinite or too few in a frame, or lie all at one
        place; if start or noise do not fit.
    """
    given = np.asarray(landmarks, np.float64)
    if given.ndim not in (2, 3) or given.shape[-1] != 2:
        raise ValueError(
            f"landmarks: got {given.shape}, expected (n_landmarks, 2) or (n_frames, n_landmarks, 2) px"
        )
    given = given.reshape(-1, *given.shape[-2:])
    if points is None:
        try:
            chosen, points = own_points(model, given.shape[1])
        except ValueError as error:
            raise ValueError(f"{error}: say which points of it they are") from None
        given = given[:, chosen]
    if len(points) != given.shape[1]:
        raise ValueError(f"landmarks: got {given.shape[1]}, expected one for each of {len(points)} points")
    if not noise > 0:
        raise ValueError(f"noise: got {noise}, expected a positive share of the object's size")
    shape = model.of_points(points)
    given, seen = _validate(given)
    if start is not None:
        if len(start) not in (1, len(given)) or start.morphs.shape[1] != shape.n_bases:
            raise ValueError(
                f"start: got {len(start)} poses of {start.morphs.shape[1]} bases, expected one or "
                f"{len(given)} of {shape.n_bases}"
            )
        if not (start.sizes > 0).all():
            raise ValueError("start: got a first morph coefficient that is not positive")
        start = start[np.arange(len(given)) % len(start)]
    parts = []
    for begin in range(0, len(given), _BATCH):
        batch = slice(begin, begin + _BATCH)
        poses = _rigid_poses(shape, given[batch], seen[batch], noise) if start is None else start[batch]
        # twice: noise is relative to the size, which the first fit estimates
        for _ in range(2):
            poses, _ = _maximise(shape, given[batch], seen[batch], poses, noise)
        parts.append(poses)
    return Poses.concatenated(parts)


def own_points(model: MorphableModel, n_given: int) -> tuple[NDArray[np.int64], SurfacePoints]:
    """Return which of `n_given` landmarks, its own or its vertices, the model has, and its points there.

    Raises `ValueError` if it has neither in that number.
    """
    own = model.landmarks
    if own is not None and len(own) == n_given:
        chosen = np.flatnonzero(own >= 0)
        return chosen, SurfacePoints.of_vertices(own[chosen])
    if n_given == model.n_vertices:
        return np.arange(n_given), SurfacePoints.of_vertices(np.arange(n_given))
    has = "no landmarks" if own is None else f"{len(own)} landmarks"
    raise ValueError(
        f"landmarks: got {n_given}, but the model has {has} of its own and {model.n_vertices} vertices"
    )


def _validate(landmarks: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return landmarks with zeros for missing ones, and which are present."""
    if np.isinf(landmarks).any():
        frame, point = np.argwhere(np.isinf(landmarks))[0, :2]
        raise ValueError(f"landmark {point} of frame {frame}: got infinity, expected px, NaN where missing")
    seen: NDArray[np.bool_] = np.logical_not(np.isnan(landmarks).any(axis=2))
    counts = seen.sum(axis=1)
    if (counts < MIN_LANDMARKS).any():
        frame = int(np.argmax(counts < MIN_LANDMARKS))
        raise ValueError(f"frame {frame}: got {counts[frame]} landmarks, expected at least {MIN_LANDMARKS}")
    landmarks = np.where(seen[..., None], landmarks, 0.0)
    middle = landmarks.sum(axis=1, keepdims=True) / counts[:, None, None]
    apart = np.where(seen[..., None], np.abs(landmarks - middle), 0.0).max(axis=(1, 2))
    if (apart < 1e-6).any():
        raise ValueError(f"frame {int(apart.argmin())}: got all landmarks at one place")
    return landmarks, seen


def _rigid_poses(points: MorphableModel, landmarks: Array, seen: NDArray[np.bool_], noise: float) -> Poses:
    """Return poses of the typical shape: the best of Gauss-Newton from three closed forms.

    These are the rotation nearest to the best affine camera, its mirror image in depth, and a rotation in the
    picture's plane.
    """
    typical = type(points)(points.bases[:1], points.triangles)
    shape = np.append(typical.bases[0], np.ones((points.n_vertices, 1)), axis=1)
    normal = np.einsum("fp,pi,pj->fij", seen.astype(np.float64), shape, shape)
    counts = seen.sum(axis=1)
    # regularised, for errors of the typical shape would determine the rotation of a nearly flat object
    normal[:, [0, 1, 2], [0, 1, 2]] += _DEPTH_DOUBT**2 * counts[:, None]
    cameras = np.linalg.solve(normal, np.einsum("fp,pi,fpc->fic", seen, shape, landmarks))
    rows = np.swapaxes(cameras[:, :3], 1, 2)
    left, scales, right = np.linalg.svd(rows, full_matrices=False)
    pair = left @ right
    turned = np.concatenate([pair, np.cross(pair[:, 0], pair[:, 1])[:, None]], axis=1)
    # the mirror image in depth: the same for a flat object
    mirror = np.diag([1.0, 1.0, -1.0])
    # in the picture's plane only: the part of the camera without depth and reflection
    angle = np.arctan2(rows[:, 1, 0] - rows[:, 0, 1], rows[:, 0, 0] + rows[:, 1, 1])
    flat = np.tile(np.eye(3), (len(rows), 1, 1))
    flat[:, 0, 0] = flat[:, 1, 1] = np.cos(angle)
    flat[:, 1, 0], flat[:, 0, 1] = np.sin(angle), -np.sin(angle)
    size = np.maximum(scales[:, :1], 1e-6)  # where nothing agrees with the shape
    modes = [
        _maximise(typical, landmarks, seen, Poses(rotations, cameras[:, 3], size), noise)
        for rotations in (turned, mirror @ turned @ mirror, flat)
    ]
    chosen = np.argmin([cost for _, cost in modes], axis=0)
    best = Poses.concatenated([found for found, _ in modes])[chosen * len(rows) + np.arange(len(rows))]
    morphs = np.zeros((len(best), points.n_bases))
    morphs[:, 0] = best.sizes
    return Poses(best.rotations, best.translations, morphs)


def _maximise(
    points: MorphableModel, landmarks: Array, seen: NDArray[np.bool_], poses: Poses, noise: float
) -> tuple[Poses, Array]:
    """Maximise the posterior of poses by Levenberg-Marquardt; return them and their costs, -2 log p."""
    units = np.ones((len(poses), poses.dimension))
    units[:, 3:] = poses.sizes[:, None]
    sigma = noise * poses.sizes  # px; held, or it would reward large objects
    damping = np.full(len(poses), 1e-3)
    cost = _cost(points, landmarks, seen, poses, sigma)
    moving = np.arange(len(poses))
    for _ in range(_MOST_STEPS):
        some = poses[moving]
        gradient, normal = _normal_equations(points, landmarks[moving], seen[moving], some, sigma[moving])
        unit = units[moving]
        normal *= unit[:, :, None] * unit[:, None, :]
        diagonal = np.einsum("fii->fi", normal)  # a view
        diagonal += damping[moving, None] * (diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True))
        steps = np.linalg.solve(normal, (gradient * unit)[..., None])[..., 0]
        trial = some.moved(steps * unit)
        trial_cost = _cost(points, landmarks[moving], seen[moving], trial, sigma[moving])
        better = trial_cost <= cost[moving]
        taken = moving[better]
        poses = poses.replaced(taken, trial[better])
        cost[taken] = trial_cost[better]
        damping[moving] *= np.where(better, 0.2, 8.0)
        moving = moving[(np.abs(steps).max(axis=1) > _SMALL_STEP) & (damping[moving] < 1e9)]
        if moving.size == 0:
            break
    return poses, cost


def _cost(
    points: MorphableModel, landmarks: Array, seen: NDArray[np.bool_], poses: Poses, sigma: Array
) -> Array:
    """Return squared residuals of landmarks and c_j / c_1 in their standard deviations, `(n_frames,)`."""
    away = ((landmarks - points.project(poses)) ** 2).sum(axis=2)
    shares = poses.morphs[:, 1:] / poses.sizes[:, None]
    total = (away * seen).sum(axis=1) / sigma**2 + (shares**2).sum(axis=1)
    cost: Array = np.where(poses.sizes > 0, total, np.inf)
    return cost


def _normal_equations(
    points: MorphableModel, landmarks: Array, seen: NDArray[np.bool_], poses: Poses, sigma: Array
) -> tuple[Array, Array]:
    """Return J^T e `(n_frames, dimension)` and J^T J of the residuals of `_cost`."""
    n = len(poses)
    rows = points.jacobian(poses) * (seen / sigma[:, None])[..., None, None]
    rows = rows.reshape(n, -1, poses.dimension)
    errors = (landmarks - points.project(poses)) / sigma[:, None, None]
    across = np.swapaxes(rows, 1, 2)
    gradient, normal = (across @ errors.reshape(n, -1, 1))[..., 0], across @ rows
    # the prior's residuals c_j / c_1, each a function of c_j and c_1
    size = poses.sizes[:, None]
    shares = poses.morphs[:, 1:] / size
    gradient[:, RIGID] += (shares**2).sum(axis=1) / poses.sizes
    gradient[:, RIGID + 1 :] -= shares / size
    normal[:, RIGID, RIGID] += (shares**2).sum(axis=1) / poses.sizes**2
    normal[:, RIGID, RIGID + 1 :] -= shares / size**2
    normal[:, RIGID + 1 :, RIGID] -= shares / size**2
    others = np.arange(RIGID + 1, poses.dimension)
    normal[:, others, others] += 1 / size**2
    return gradient, normal

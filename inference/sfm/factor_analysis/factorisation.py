"""Structure from motion as factor analysis: shape and affine cameras from point tracks with gaps.

RSMCM eq. (18): position of point i in frame t = M_t (S_i, 1) + noise, M_t (2, 4), S_i (3,). Least squares
goes by variable projection: the points that are best for given cameras have a closed form, so the squared
error is a function of the cameras alone, with far fewer poor valleys than as a function of both (Hong and
Fitzgibbon, "Secrets of matrix factorization", 2015).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from ....models.core.checks import Shape
from ....models.core.short_repr import short_repr
from ...optimisation import Anderson, Damping, levenberg_marquardt
from .em import (
    LEAST_VARIANCE,
    CameraPrior,
    ObservationSums,
    Posterior,
    camera_moments,
    expectation_maximisation,
    first_prior,
    homogeneous,
    shape_moments,
    squared_error,
)
from .initialisation import RANK, Mask, freedom, grown, mean_filled, regauged, whitened, whitening
from .kernels import invert_information
from .observations import Array, Indices, Observations, SparseObservations, as_arrays, determined

ACCURACY = 1e-3  # relative, of the solution of the normal equations
MOST_PRODUCTS = 500
FAR, NEAR = 1.0, 1e-2
"""First damping, of the mean of the diagonal; it changes by ten: else half of the random starts end badly."""
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e12
STILL = 3  # steps in a row that hardly lower the error: one may be short because it was damped


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Cameras and shape, inverses of the points' information, and the weighted squared error."""

    cameras: Array
    shape: Array
    inverses: Array
    error: float


def variable_projection(
    observations: Observations,
    cameras: Array,
    *,
    damping: float = FAR,
    tolerance: float = 1e-9,
    most_steps: int = 600,
    rank: int = RANK,
    enough: float = 0.0,
) -> LeastSquares:
    """Minimise the squared error, from cameras `(n_frames, 2, 4)`.

    Parameters
    ----------
    observations
        of points that are seen twice or more, in frames that show four or more; others are left alone.
    damping
        `FAR` or `NEAR`: how far the start is from the optimum.
    tolerance, most_steps, enough
        share of the error by which the last steps still lowered it; steps to be tried; error to stop at.
    rank
        2 for a flat shape, whose third axis is 0.
    """
    by_frame = observations.by_frame
    sums = ObservationSums(by_frame, observations.n_points)
    points = np.diff(observations.by_point.edges) > 0

    def linearised(at: LeastSquares) -> Callable[[float], LeastSquares | None]:
        if at.error <= enough:
            return lambda damping: at
        gradient = _camera_gradient(by_frame, at.cameras, at.shape)
        information, _ = sums.of_frames(at.shape, shape_moments(at.shape))
        scale = float(np.einsum("tjj->", information)) / (4 * len(at.cameras))

        def step(damping: float) -> LeastSquares | None:
            added = damping * scale
            preconditioner, _ = invert_information(information, np.full(4, added), 1.0)
            with np.errstate(over="ignore", invalid="ignore"):  # where damping is too small it may run away
                moved = _reduced_step(sums, at, information, preconditioner, gradient, added)
                if damping <= NEAR and -float(np.sum(moved * gradient)) <= tolerance * at.error:
                    return at  # even an undamped step would hardly gain
                shape, inverses, error = eliminate_points(by_frame, sums, at.cameras + moved)
            if not error < at.error:
                return None
            return LeastSquares(*_in_gauge(at.cameras + moved, shape, inverses, points, rank), error)

        return step

    cameras = cameras.copy()
    cameras[..., rank:RANK] = 0
    shape, inverses, error = eliminate_points(by_frame, sums, cameras)
    return levenberg_marquardt(
        LeastSquares(*_in_gauge(cameras, shape, inverses, points, rank), error),
        linearised,
        lambda before, after: before.error - after.error <= tolerance * before.error,
        Damping(damping, least=LEAST_DAMPING, most=MOST_DAMPING),
        most_steps=most_steps,
        settled_steps=STILL,
    )[0]


ROUNDING = 1e-13  # share of a point's information below which a direction of it is rounding


def eliminate_points(
    by_frame: SparseObservations, sums: ObservationSums, cameras: Array
) -> tuple[Array, Array, float]:
    """Return the best points for given cameras, inverses of their information, and the squared error.

    `(n_points, 3)` and `(n_points, 3, 3)`. Directions that only rounding determines stay at 0.
    """
    information, vector, _ = sums.of_points(cameras, camera_moments(cameras))
    least = ROUNDING * np.trace(information, axis1=1, axis2=2) + 1e-300
    root = np.zeros((len(vector), RANK, RANK))  # of the inverse, lower triangular: root^T root
    rows = np.zeros((len(vector), RANK, RANK))  # Cholesky factor, with no row for what is left open
    for j in range(RANK):
        rows[:, j, :j] = np.einsum("ik,ijk->ij", information[:, j, :], root)[:, :j]
        pivot = information[:, j, j] - np.sum(rows[:, j, :j] ** 2, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.where(pivot > least, 1 / np.sqrt(pivot), 0.0)
        root[:, j, j] = scale
        root[:, j, :j] = -scale[:, None] * np.einsum("ik,ikj->ij", rows[:, j, :j], root[:, :j, :j])
    inverses = np.einsum("ikj,ikl->ijl", root, root)
    shape = np.einsum("ijk,ik->ij", inverses, vector)
    return shape, inverses, squared_error(by_frame, cameras, shape)


def _camera_gradient(by_frame: SparseObservations, cameras: Array, shape: Array) -> Array:
    """Half the derivative of the squared error by cameras, `(n_frames, 2, 4)`."""
    points, errors = homogeneous(shape), by_frame.weight * by_frame.errors(cameras, shape)
    return -np.stack([by_frame.matrix(each, len(shape)) @ points for each in errors], axis=1)


def _reduced_step(
    sums: ObservationSums,
    at: LeastSquares,
    information: Array,
    preconditioner: Array,
    gradient: Array,
    damping: float,
) -> Array:
    """The Gauss-Newton step of cameras `(n_frames, 2, 4)`, points eliminated, by conjugate gradients.

    The matrix is never formed: a product with it goes through all observations twice. It leaves out how the
    eliminated points' own directions turn (Kaufman). `information` `(n_frames, 4, 4)` is that of cameras at
    fixed points and `preconditioner` the inverse of it plus `damping`.
    """
    n_frames, points = len(gradient), homogeneous(at.shape)
    rows = at.cameras[..., :RANK]
    turned = np.ascontiguousarray(rows.transpose(0, 2, 1))
    step, residual = np.zeros(gradient.shape), -gradient
    direction = residual @ preconditioner
    length = first = float(np.sum(direction * residual))
    for _ in range(MOST_PRODUCTS):
        if not length > ACCURACY**2 * first:  # NaN as well
            break
        of_points = (sums.transposed @ (turned @ direction).reshape(n_frames, -1)).reshape(-1, RANK, 4)
        solutions = np.einsum("ijk,ikl,il->ij", at.inverses, of_points, points, optimize=True)
        pulls = (solutions[:, :, None] * points[:, None, :]).reshape(len(points), -1)
        of_frames = (sums.weight @ pulls).reshape(n_frames, RANK, 4)
        product = damping * direction + direction @ information - rows @ of_frames
        curvature = float(np.sum(product * direction))
        if not curvature > 0:  # by rounding
            break
        stride = length / curvature
        step += stride * direction
        residual -= stride * product
        solved = residual @ preconditioner
        before, length = length, float(np.sum(solved * residual))
        direction = solved + length / before * direction
    return step


def _in_gauge(
    cameras: Array, shape: Array, inverses: Array, points: NDArray[np.bool_], rank: int
) -> tuple[Array, Array, Array]:
    """Cameras, points and inverses of their information with orthogonal columns, about the origin, of size 1.

    So the damping is the same for all numbers. Medians, because points that are hardly determined may be
    anywhere.
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


LOOSEST = 100.0  # standard deviation, in spreads of the shape, of a direction that is left open
HALF = 0.5  # points known to this share of the spread of all count in that spread


def around_start(
    observations: Observations,
    cameras: Array,
    shape: Array,
    frames: Mask,
    points: Mask,
    *,
    coherent: bool,
) -> Posterior:
    """Return a posterior from which EM can begin.

    `frames` and `points` are those of which cameras `(n_frames, 2, 4)` and shape `(n_points, 3)` are more
    than a filler: other frames lie between them, other points are draws of N(0, I).
    """
    cameras, shape = whitened(cameras, shape, points)
    cameras = _bridged(cameras, frames)
    shape[~points] = 0
    part = observations.only(frames, points)
    error = squared_error(part.by_frame, cameras, shape)
    noise = max(error / max(freedom(part), 0.1 * part.count), LEAST_VARIANCE)
    covariance = np.tile(np.eye(RANK), (len(shape), 1, 1))
    covariance[points] *= min(noise, 1e-2)
    return Posterior(
        cameras, np.zeros((len(cameras), 4, 4)), shape, covariance, noise, first_prior(cameras, coherent)
    )


def _bridged(cameras: Array, observed: Mask) -> Array:
    """Cameras of unknown frames, between those of the known ones before and after."""
    if observed.all():
        return cameras
    times = np.flatnonzero(observed)
    flat = cameras.reshape(len(cameras), 8)
    filled = [np.interp(np.arange(len(cameras)), times, flat[times, k]) for k in range(8)]
    return np.stack(filled, axis=1).reshape(-1, 2, 4)


def around_optimum(observations: Observations, part: Observations, optimum: LeastSquares) -> Posterior:
    """Return a posterior around the least squares optimum of the frames and points of `part`.

    Points: sigma^2 (sum of w R^T R)^-1, given the cameras. Cameras: sigma^2 (sum of w (1 - h) s s^T)^-1
    with h the share that an observation has in its own point, so that a point which a frame all but defines
    does not vouch for the frame's camera. Other frames and points get the prior's posterior given those.
    """
    cameras, shape = optimum.cameras, optimum.shape
    noise = max(optimum.error / max(freedom(part), 1.0), LEAST_VARIANCE**2)
    points, frames = np.diff(part.by_point.edges) > 0, np.diff(part.by_frame.edges) > 0
    information, _, _ = ObservationSums(part.by_frame, part.n_points).of_points(
        cameras, camera_moments(cameras)
    )
    good = points
    for _ in range(2):  # the first spread is that of points which may be anywhere
        mean, change = whitening(shape[good])
        cameras, shape = regauged(cameras, shape, mean, change)
        information = change.T @ information @ change
        covariance, _ = invert_information(information, np.full(RANK, LOOSEST**-2), 1 / noise)
        worst = np.linalg.eigvalsh(covariance)[:, -1]
        good = points & (worst <= max(HALF**2, float(np.median(worst[points]))))
    shape[~points] = 0

    prior = first_prior(cameras[frames], coherent=False)
    by_frame, rows = part.by_frame, cameras[..., :RANK]
    # leverage of each observation on its own point, 0 to 1
    turned = np.einsum("tcj,tck->tjk", rows, rows)[by_frame.own]
    leverages = by_frame.weight * np.einsum("njk,njk->n", turned, covariance[by_frame.other]) / (2 * noise)
    others = by_frame._replace(weight=by_frame.weight * (1 - np.minimum(leverages, 1.0)))
    information, _ = ObservationSums(others, part.n_points).of_frames(shape, shape_moments(shape))
    camera_covariance, _ = invert_information(information, np.full(4, LEAST_VARIANCE), 1 / noise)
    posterior = Posterior(cameras, camera_covariance, shape, covariance, noise, prior)
    return _completed(observations, posterior, frames, points)


def _completed(observations: Observations, posterior: Posterior, frames: Mask, points: Mask) -> Posterior:
    """The same with the frames and points that least squares left out, by the priors."""
    cameras, camera_covariance = posterior.cameras, posterior.camera_covariance
    shape, covariance = posterior.shape, posterior.shape_covariance
    noise = max(posterior.noise, LEAST_VARIANCE)  # or the prior would be lost in rounding
    if not frames.all():
        seen = observations.only(~frames, points).by_frame
        information, vector = ObservationSums(seen, len(shape)).of_frames(
            shape, shape_moments(shape, covariance)
        )
        spread, _ = invert_information(information, 1 / posterior.prior.numbers, 1 / noise)
        camera_covariance[~frames] = spread[~frames]
        cameras[~frames] = (spread @ vector / noise)[~frames].transpose(0, 2, 1)
    if not points.all():
        seen = observations.only(frames, ~points).by_frame
        moments = camera_moments(cameras, camera_covariance)
        information, pull, _ = ObservationSums(seen, len(shape)).of_points(cameras, moments)
        spread, _ = invert_information(information, np.ones(RANK), 1 / noise)
        covariance[~points] = spread[~points]
        shape[~points] = np.einsum("ijk,ik->ij", spread, pull)[~points] / noise
    return posterior


Start = Literal["grow", "svd"]

FILLED = 1e-3  # mean change of filled coordinates, in the noise's standard deviation, that ends filling
MOST_FILLINGS = 50


@short_repr
@dataclass(frozen=True, eq=False)
class Factorisation:
    """Cameras and shape that explain positions of points, up to an affine change of the shape.

    Parameters
    ----------
    cameras, camera_covariance
        `(n_frames, 2, 4)`: position in px = cameras[..., :3] @ shape + cameras[..., 3]; and `(n_frames, 4,
        4)`, of the row of u and of that of v alike.
    shape, shape_covariance
        `(n_points, 3)`, whitened (mean 0, covariance I), the third axis the one with the smallest image
        motion; and `(n_points, 3, 3)`.
    noise_variance, rmse
        px^2, of a position of weight 1; px, weighted, over the coordinates of all observations, at the
        means.
    coherent, motion_noise
        whether cameras follow eq. (19); and px^2: `(3, 2)` variances of eps_1, eps_2, eps_3 for the numbers
        that multiply the shape and for the translation, or else `(1, 2)` variances of those numbers
        themselves.
    frame_determined
        `(n_frames,)` bool: the frame shows four points or more that other frames show too. Other cameras are
        predicted by the prior.
    history
        bound of the log likelihood at each iteration of EM; empty for least squares.
    """

    cameras: Annotated[Array, Shape("n_frames", 2, 4)]
    camera_covariance: Annotated[Array, Shape("n_frames", 4, 4)]
    shape: Annotated[Array, Shape("n_points", 3)]
    shape_covariance: Annotated[Array, Shape("n_points", 3, 3)]
    noise_variance: float
    rmse: float
    coherent: bool
    motion_noise: Annotated[Array, Shape(None, 2)]
    frame_determined: Annotated[Mask, Shape("n_frames")]
    history: tuple[float, ...]

    def of_points(self, kept: Mask) -> "Factorisation":
        """Return the factorisation of some points, `(n_points,)` bool."""
        return replace(self, shape=self.shape[kept], shape_covariance=self.shape_covariance[kept])


def factorise(
    positions: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    coherence: bool = False,
    start: Start | Factorisation | NDArray[np.float64] = "grow",
    polish: bool = True,
    iterations: int = 500,
    tolerance: float = 0.003,
) -> Factorisation:
    """Estimate affine cameras and shape from positions of points.

    Parameters
    ----------
    positions
        `(n_frames, n_points, 2)` px; NaN for an unknown single coordinate; any value where the weight is 0.
    weights
        `(n_frames, n_points)`, 1 / relative variance, 0 without an observation; default: 1 wherever there is
        a coordinate.
    coherence
        whether cameras move by eq. (19), or are independent.
    start
        `"grow"` from the window that shows a rigid motion best; `"svd"` of the mean-filled matrix (the
        published start); an earlier result for the same frames and points; or cameras `(n_frames, 2, 4)`,
        in px.
    polish
        continue to the optimum: of weighted least squares without coherence, of the likelihood bound with it,
        by accelerated EM. If not, only plain EM.
    iterations, tolerance
        of EM: at most so many, and until it gains less than so many nats in each.

    Raises
    ------
    ValueError
        if shapes do not fit; numbers are not finite; fewer than 3 frames share 4 points of which both
        coordinates are known; or, without coherence, frames fall into sets that share fewer than 4 points.
    """
    where, given = as_arrays(positions, weights)
    known = ~np.isnan(where)
    half = known.any(axis=2) & ~known.all(axis=2) & (given > 0)
    settings = coherence, polish, iterations, tolerance
    if not half.any():
        return _factorised(Observations.from_arrays(where, given), start, *settings)
    if not isinstance(start, Factorisation):
        whole = Observations.from_arrays(where, np.where(half, 0.0, given))
        start = _factorised(whole, start, *settings)
    # EM over the coordinates that are missing: they are expected where cameras and shape have them
    share = 1 - 0.5 * float(np.count_nonzero(half) / np.count_nonzero(given > 0))
    missing = np.isnan(where) & half[..., None]
    filled, fit = where.copy(), start
    filled[missing] = projected(fit.cameras, fit.shape)[missing]
    acceleration, nearest = Anderson(), np.inf
    for _ in range(MOST_FILLINGS):
        fit = _factorised(Observations.from_arrays(filled, given, observed_share=share), fit, *settings)
        before, expected = filled[missing], projected(fit.cameras, fit.shape)[missing]
        off = float(np.sqrt(np.mean((expected - before) ** 2)))
        if off <= FILLED * np.sqrt(fit.noise_variance):
            break
        if off > nearest:  # the last proposal went too far
            acceleration.forget()
            filled[missing] = expected
        else:
            filled[missing] = acceleration.propose(before, expected)
        nearest = off
    return _without_filled(fit, given, half, missing)


def _without_filled(fit: Factorisation, weights: Array, half: Mask, missing: Mask) -> Factorisation:
    """The same with covariances that do not count coordinates which were filled in."""
    points = half.any(axis=0)
    rows = fit.cameras[..., :RANK]
    second = rows[..., :, None] * rows[..., None, :] + fit.camera_covariance[:, None, :RANK, :RANK]
    counted = np.where(missing, weights[..., None], 0.0)[:, points] / fit.noise_variance
    information = np.linalg.inv(fit.shape_covariance[points])
    information -= np.einsum("tic,tcjk->ijk", counted, second, optimize=True)
    shape_covariance = fit.shape_covariance.copy()
    # it is the posterior given the prior and all observations, but for rounding
    values, axes = np.linalg.eigh(0.5 * (information + information.transpose(0, 2, 1)))
    values = np.maximum(values, 1 / LOOSEST**2)
    shape_covariance[points] = (axes / values[:, None, :]) @ axes.transpose(0, 2, 1)
    # rows of u and v share theirs: as if each frame had seen so much less of both
    total = weights.sum(axis=1)
    seen = 1 - 0.5 * np.where(half, weights, 0.0).sum(axis=1) / np.where(total > 0, total, 1.0)
    return replace(
        fit, shape_covariance=shape_covariance, camera_covariance=fit.camera_covariance / seen[:, None, None]
    )


def _factorised(
    observations: Observations,
    start: Start | Factorisation | Array,
    coherence: bool,
    polish: bool,
    iterations: int,
    tolerance: float,
) -> Factorisation:
    frames, points = determined(observations, apart=coherence)
    part = observations.only(frames, points)
    beginning = _beginning(observations, part, start, coherence)
    if polish and not coherence:
        near = isinstance(start, str | Factorisation)
        found = variable_projection(part, beginning.cameras, damping=NEAR if near else FAR)
        posterior, history = around_optimum(observations, part, found), list[float]()
    else:
        posterior, history = expectation_maximisation(
            observations, beginning, iterations=iterations, tolerance=tolerance, accelerate=polish
        )
    return _in_pixels(observations, posterior, frames, history)


def _beginning(
    observations: Observations, part: Observations, start: Start | Factorisation | Array, coherent: bool
) -> Posterior:
    n_frames = observations.n_frames
    frames, points = np.diff(part.by_frame.edges) > 0, np.diff(part.by_point.edges) > 0
    if isinstance(start, Factorisation):
        return _in_units(observations, start, coherent)
    if isinstance(start, str):
        if start == "grow":
            cameras, shape, frames, points = grown(part, coherent=coherent)
        elif start == "svd":
            cameras, shape = mean_filled(observations)
        else:
            raise ValueError(f'start: got {start!r}, expected "grow", "svd", cameras or a Factorisation')
    else:
        given = np.asarray(start, np.float64)
        if given.shape != (n_frames, 2, 4) or not np.isfinite(given).all():
            raise ValueError(f"start: got {given.shape} cameras, expected finite {(n_frames, 2, 4)}")
        cameras, shape = _best_points(part, observations.scaled(given))
    return around_start(observations, cameras, shape, frames, points, coherent=coherent)


def _best_points(part: Observations, cameras: Array) -> tuple[Array, Array]:
    """Given cameras with the points that fit them best; translations may become frames' middles."""
    listed = part.by_frame
    sums = ObservationSums(listed, part.n_points)
    counts = np.maximum(np.diff(listed.edges), 1)
    middles = [np.bincount(listed.own, values, part.n_frames) / counts for values in (listed.x, listed.y)]
    centred = np.concatenate([cameras[..., :3], np.stack(middles, axis=1)[..., None]], axis=2)
    tried = [(each, *eliminate_points(listed, sums, each)) for each in (cameras, centred)]
    best, shape, _, _ = min(tried, key=lambda each: each[3])
    return best, shape


def _in_units(observations: Observations, start: Factorisation, coherent: bool) -> Posterior:
    """An earlier result as a start, in the units of the observations."""
    n_frames, n_points = observations.n_frames, observations.n_points
    if len(start.cameras) != n_frames or len(start.shape) != n_points:
        raise ValueError(
            f"start: got a Factorisation of {len(start.cameras)} frames and {len(start.shape)} points, "
            f"expected {n_frames} and {n_points}"
        )
    square = observations.scale**2
    cameras = observations.scaled(start.cameras)
    same = start.coherent == coherent
    return Posterior(
        cameras,
        start.camera_covariance / square,
        start.shape.copy(),
        start.shape_covariance.copy(),
        start.noise_variance / (square * observations.weight_unit),
        CameraPrior(start.motion_noise / square, coherent) if same else first_prior(cameras, coherent),
    )


def _in_pixels(
    observations: Observations, posterior: Posterior, frames: Mask, history: list[float]
) -> Factorisation:
    """The result in px, with the axes of the shape in the order in which they move points."""
    scale, square = observations.scale, observations.scale**2
    error = squared_error(observations.by_frame, posterior.cameras, posterior.shape)
    turn = np.eye(4)
    turn[:RANK, :RANK] = _axes(posterior.cameras, np.diff(observations.by_frame.edges))
    axes = turn[:RANK, :RANK]
    cameras = posterior.cameras @ turn * scale
    cameras[..., 3] += observations.centre
    return Factorisation(
        cameras=cameras,
        camera_covariance=turn.T @ posterior.camera_covariance @ turn * square,
        shape=posterior.shape @ axes,
        shape_covariance=axes.T @ posterior.shape_covariance @ axes,
        noise_variance=posterior.noise * square * observations.weight_unit,
        rmse=scale
        * float(np.sqrt(error / (2 * observations.observed_share * observations.by_point.weight.sum()))),
        coherent=posterior.prior.coherent,
        motion_noise=posterior.prior.variance * square,
        frame_determined=frames,
        history=tuple(history),
    )


def _axes(cameras: Array, counts: NDArray[np.int64]) -> Array:
    """Turn of the shape `(3, 3)` after which cameras have orthogonal columns, the longest first."""
    rows = cameras[..., :RANK]
    _, axes = np.linalg.eigh(np.einsum("t,tcj,tck->jk", counts, rows, rows))
    axes = axes[:, ::-1]
    turned = rows.reshape(-1, RANK) @ axes
    largest = turned[np.abs(turned).argmax(axis=0), np.arange(RANK)]
    return axes * np.where(largest < 0, -1.0, 1.0)


def projected(cameras: Array, shape: Array) -> Array:
    """Project points `(n_points, 3)` by cameras `(n_frames, 2, 4)`: `(n_frames, n_points, 2)` px."""
    positions: Array = np.einsum("tcj,ij->tic", cameras[..., :3], shape) + cameras[:, None, :, 3]
    return positions


def predicted(factorisation: Factorisation) -> tuple[Array, Array]:
    """Return positions `(n_frames, n_points, 2)` px of all points, and their covariances px^2.

    These are `(n_frames, n_points, 2, 2)`: how uncertain cameras and shape leave them, without observations'
    noise.
    """
    cameras, shape = factorisation.cameras, factorisation.shape
    camera_covariance, shape_covariance = factorisation.camera_covariance, factorisation.shape_covariance
    covariances = np.einsum(
        "tcj,ijk,tdk->ticd", cameras[..., :3], shape_covariance, cameras[..., :3], optimize=True
    )
    points = homogeneous(shape)
    second = points[:, :, None] * points[:, None, :]
    second[:, :3, :3] += shape_covariance
    isotropic = camera_covariance.reshape(-1, 16) @ second.reshape(-1, 16).T
    covariances[..., 0, 0] += isotropic
    covariances[..., 1, 1] += isotropic
    return projected(cameras, shape), covariances


MOST_ROUNDS = 20
SETTLED = 0.002  # mean change of the probabilities of being right with which the rounds end
ITERATIONS = 50  # of EM in a round: the next one goes on from there
FAREST = 25.0  # variance of outliers over that of right positions, at the least: closer ones are needed
LEAST_FREE = 0.02  # share of an observation that its own point leaves free, at the least
FIRST_ROUNDS = 3  # in which the variance of right positions is that of their median

FIRST_SHARE, LEAST_SHARE, MOST_SHARE = 0.05, 1e-4, 0.2
"""Of outliers. Where more do not fit, the camera is not affine, and nothing is an outlier."""

LEAST_SHARE_OF_LARGEST, TINY = 1e-12, 1e-300  # of the largest square, and absolutely: the least variance
MEDIAN = 2 * float(np.log(2))  # of the squared length of a vector of two standard normal numbers
TRUSTED = 0.5  # probability from which a position is taken to be right


@dataclass(frozen=True, eq=False)
class RobustFactorisation:
    """Cameras and shape, and which positions they were found from.

    `weights` `(n_frames, n_points)` are those that were given, less where a position is likely wrong, and
    `right` the probability that it is not; 0 where nothing was seen.
    """

    factorisation: Factorisation
    weights: Array
    right: Array

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """`(n_frames, n_points)`: positions that are more likely right than not."""
        return np.asarray(self.right > TRUSTED)

    @property
    def consistent(self) -> NDArray[np.bool_]:
        """`(n_points,)`: points of which more positions are right than wrong."""
        return np.asarray(2 * self.trusted.sum(axis=0) > (self.weights > 0).sum(axis=0))


def factorise_robustly(
    positions: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    coherence: bool = False,
    outliers: bool = True,
    start: Factorisation | None = None,
) -> RobustFactorisation:
    """Estimate cameras and shape with outliers among the positions; arguments and errors as of `factorise`.

    Without `outliers` all positions are right: least squares. Only the cameras of `start` count, whatever its
    points.

    A position is an inlier with noise of its weight, or an outlier with a larger variance: a contaminated
    normal (Tukey, "A survey of sampling from contaminated distributions", 1960), fitted by EM with learned
    probability and variance. Probabilities follow from the residuals of `factorise`, relative to the
    uncertainty given the other positions of the point, and weight the next `factorise`. Without outliers they
    are near 1, and the result is that of `factorise`.
    """
    where, given = as_arrays(positions, weights)
    if not outliers:
        fit = factorise(where, given, coherence=coherence)
        return RobustFactorisation(fit, given, np.sign(given))
    if start is None:
        fit = _roughly(where, given, coherence, "grow")
    else:
        fit = _roughly(where, given, coherence, _with_points(start, where, given))
    frames, points = np.nonzero(given > 0)
    seen: tuple[Indices, Indices] = frames.astype(np.int64), points.astype(np.int64)
    numbers = np.count_nonzero(~np.isnan(where[seen]), axis=1)
    right, weight = np.where(given > 0, 1.0, 0.0), given.copy()
    share, renewed = FIRST_SHARE, start is not None
    for number in range(MOST_ROUNDS):
        squares: Array = given[seen] * _free_squares(fit, where[seen], weight[seen], seen)
        before = right[seen]
        noise = _noise(squares, before, numbers, first=number < FIRST_ROUNDS)
        wrong = 1 - before
        learned = (
            float(wrong @ squares) / float((wrong * numbers).sum())
            if wrong.any()
            else float(squares.mean() / numbers.mean())
        )
        outlying = max(learned, FAREST * noise)
        odds = (
            np.log(1 / min(share, 0.5) - 1)
            + numbers / 2 * np.log(outlying / noise)
            - squares / 2 * (1 / noise - 1 / outlying)
        )
        right[seen] = expit(odds)
        weight[seen] = given[seen] * (right[seen] + (1 - right[seen]) * noise / outlying)
        share = max(float(1 - right[seen].mean()), LEAST_SHARE)
        settled = bool(np.abs(right[seen] - before).mean() < SETTLED)
        fit = _roughly(where, weight, coherence, fit)
        if settled and renewed:
            break
        if start is None and (settled or number == FIRST_ROUNDS):
            # where to begin was chosen among outliers, which may have led astray
            fit, renewed = _renewed(where, np.where(right > TRUSTED, weight, 0.0), coherence, fit), True
    if share > MOST_SHARE:
        right[seen], weight = 1.0, given
    return RobustFactorisation(factorise(where, weight, coherence=coherence, start=fit), weight, right)


def _roughly(
    where: Array, weights: Array, coherence: bool, start: Literal["grow"] | Factorisation
) -> Factorisation:
    """A few steps of EM: variable projection would follow outliers to far places."""
    return factorise(
        where, weights, coherence=coherence, start=start, polish=coherence, iterations=ITERATIONS
    )


def _with_points(fit: Factorisation, where: Array, weights: Array) -> Factorisation:
    """The same cameras with other points: those that positions make likeliest."""
    whole = np.asarray(~np.isnan(where).any(axis=2))
    observations = Observations.from_arrays(np.where(whole[..., None], where, 0.0), weights * whole)
    cameras, square = observations.scaled(fit.cameras), observations.scale**2
    noise = fit.noise_variance / (square * observations.weight_unit)
    sums = ObservationSums(observations.by_frame, observations.n_points)
    information, vector, _ = sums.of_points(cameras, camera_moments(cameras, fit.camera_covariance / square))
    spread, _ = invert_information(np.array(information), np.ones(RANK), 1 / noise)
    return replace(fit, shape=np.einsum("ijk,ik->ij", spread, vector) / noise, shape_covariance=spread)


def _renewed(where: Array, weights: Array, coherence: bool, fit: Factorisation) -> Factorisation:
    """The better one of a fit and of that which is grown from positions that are trusted."""
    try:
        regrown = _roughly(where, weights, coherence, "grow")
    except ValueError:  # they are too few, or fall apart
        return fit
    return min(fit, regrown, key=lambda each: each.noise_variance)


def _noise(squares: Array, right: Array, numbers: Indices, *, first: bool) -> float:
    """Variance of right positions, in the unit of the squares, of each the sum over so many numbers."""
    if first:
        variance = float(np.median(squares[(right > TRUSTED) & (numbers == numbers.max())])) / MEDIAN
    else:
        variance = float(right @ squares) / float((right * numbers).sum())
    return max(variance, LEAST_SHARE_OF_LARGEST * float(squares.max()), TINY)


def _free_squares(fit: Factorisation, where: Array, weights: Array, seen: tuple[Indices, Indices]) -> Array:
    """Squared distances `(n,)` px^2 of positions from the fit, over what their points leave free."""
    frames, points = seen
    cameras = fit.cameras[frames]
    rows = cameras[..., :3]
    known = ~np.isnan(where)
    off = np.where(known, where - np.einsum("ncj,nj->nc", rows, fit.shape[points]) - cameras[..., 3], 0)
    rows = rows * known[..., None]
    spread = np.einsum("ncj,njk,nck->n", rows, fit.shape_covariance[points], rows, optimize=True)
    free = 1 - weights * spread / (np.count_nonzero(known, axis=1) * fit.noise_variance)
    squares: Array = np.square(off).sum(axis=1) / np.maximum(free, LEAST_FREE)
    return squares

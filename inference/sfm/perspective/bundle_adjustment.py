"""Bundle adjustment: cameras, focal length and points to the likeliest at once, whatever is missing.

Levenberg-Marquardt on the log likelihood under Student's noise, each step weighted least squares
(iteratively reweighted); the points are eliminated from the normal equations (Schur complement; Triggs,
McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

from ....models.camera.perspective_camera import NEAREST, PerspectiveCameras
from ....models.core.short_repr import short_repr
from ....models.numerics.rotations import exponential
from ...optimisation import Damping, levenberg_marquardt
from ..factor_analysis.observations import Array, SparseObservations
from .kernels import CAMERA, eliminate_points, sum_products

HEAVIEST, LIGHTEST = 3.0, 100.0  # degrees of freedom: Cauchy's distribution, and as good as normal
HARDLY = 0.1  # share of its weight that is left to an outlier: at 5 deviations with the heaviest tails
LEAST_VARIANCE = 1e-8  # px^2, below which rounding decides
MOST_ROUNDS = 50
ACCURACY = 1e-4  # of the logarithm of the variance


@short_repr
@dataclass(frozen=True)
class StudentNoise:
    """Errors of positions in two coordinates, with heavy tails, by which outliers lose their weight.

    With d the distance in px, g the weight of the observation, s^2 the variance and nu the freedom, the
    density is

        g / (2 pi s^2) (1 + g d^2 / (nu s^2))^(-(nu + 2) / 2).
    """

    variance: float
    freedom: float

    @classmethod
    def of_errors(cls, squares: Array, weight: Array, *, outliers: bool = True) -> "StudentNoise":
        """Return the noise under which squared distances `(n,)` px^2 of such weights are likeliest.

        Without `outliers` it is as good as normal.
        """
        middle = float(np.median(weight * squares))

        def of_freedom(log_freedom: float) -> "StudentNoise":
            freedom = float(np.exp(log_freedom))
            # the median of d^2 is nu s^2 (2^(2 / nu) - 1)
            start = cls(max(middle / (freedom * (2 ** (2 / freedom) - 1)), LEAST_VARIANCE), freedom)
            return start.rescaled(squares, weight)

        if not outliers:
            return of_freedom(math.log(LIGHTEST))
        found = minimize_scalar(
            lambda at: -of_freedom(at).log_likelihood(squares, weight),
            bounds=(np.log(HEAVIEST), np.log(LIGHTEST)),
            method="bounded",
            options={"xatol": 0.05},
        )
        return of_freedom(float(found.x))

    def rescaled(self, squares: Array, weight: Array) -> "StudentNoise":
        """Return the likeliest variance for these degrees of freedom, by EM; arguments as of `of_errors`."""
        weighted, variance = weight * squares, self.variance
        for _ in range(MOST_ROUNDS):
            shares = (self.freedom + 2) / (self.freedom + weighted / variance)
            better = max(float(np.mean(shares * weighted)) / 2, LEAST_VARIANCE)
            change, variance = abs(math.log(better / variance)), better
            if change < ACCURACY:
                break
        return replace(self, variance=variance)

    def weights(self, squares: Array, weight: Array) -> Array:
        """Return the weights `(n,)` of observations in iteratively reweighted least squares."""
        return weight * (self.freedom + 2) / (self.freedom + weight * squares / self.variance)

    @property
    def reach(self) -> float:
        """Distance px from which an observation of weight 1 is an outlier."""
        return math.sqrt((1 / HARDLY - 1) * self.freedom * self.variance)

    def agrees(self, squares: Array, weight: Array) -> NDArray[np.bool_]:
        """Return which observations are inliers: of `HARDLY` or more of the weight of a perfect fit."""
        return weight * squares <= self.reach**2

    def log_likelihood(self, squares: Array, weight: Array) -> float:
        """Return log density of errors `(n,)` px^2."""
        unlikely = np.log1p(weight * squares / (self.freedom * self.variance)).sum()
        scale = len(squares) * np.log(2 * np.pi * self.variance) - np.log(weight).sum()
        return -float(scale + 0.5 * (self.freedom + 2) * unlikely)

    def precision(self, squares: Array, weight: Array, parameters: float) -> float:
        """Return the information, 1/px^2, of a coordinate of weight 1 about its mean.

        By Huber's formula for M-estimators ("Robust Statistics", 1981, section 7.6): with psi the derivative
        of minus the log density by a coordinate it is mean(psi')^2 / mean(psi^2), here times what is left of
        the observations when `parameters` numbers have been fitted to them.
        """
        ratio = weight * squares / self.variance
        share = (self.freedom + 2) / (self.freedom + ratio)
        pull = share**2 * ratio / 2
        slope = share - (self.freedom + 2) * ratio / (self.freedom + ratio) ** 2
        left = max(1 - parameters / (2 * len(squares)), 1 / (2 * len(squares)))
        return float(np.mean(slope)) ** 2 / max(float(np.mean(pull)), 1e-300) * left / self.variance


ROUNDS = 12  # reweighted linear solutions of each start of a point
OPEN = 1e-9  # share of a point's information below which a direction of it is rounding; there the point stays
DAMPING = Damping(1e-3, least=1e-9, most=1e9)
STILL = 3  # steps in a row that hardly gain: one may be short because it was damped
BEHIND = 1e6  # px^2, that stands for a point behind a camera, and the largest that is distinguished
GAUGE = 7  # numbers of a shape's place, turn and size, which no film shows


class NormalEquations(NamedTuple):
    """Normal equations at given weights: sums of w J^T J and of w J^T r, by blocks.

    The unknowns of a camera are a turn w (R <- exp([w]x) R), log a, and u of `PerspectiveCameras`; of all
    frames q = 1 / f; of a point X. Blocks of cameras `(n_frames, 6, 6)` and `(n_frames, 6)`; of q with them
    `(n_frames, 6)`, with itself, and its sum; of points `(n_points, 3, 3)` and `(n_points, 3)`; of the point
    and the camera of each observation `(n, 3, 6)`; of q and a point `(n_points, 3)`.
    """

    cameras: Array
    camera_vector: Array
    border: Array
    corner: float
    corner_vector: float
    points: Array
    point_vector: Array
    mixed: Array
    mixed_border: Array


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras and points `(n_points, 3)`, the noise about what they predict, and log likelihood."""

    cameras: PerspectiveCameras
    shape: Array
    noise: StudentNoise
    log_likelihood: float


def about(by_point: SparseObservations, principal: Array) -> SparseObservations:
    """Return observations in px from the principal point `(2,)`."""
    return by_point._replace(x=by_point.x - principal[0], y=by_point.y - principal[1])


def freedom(listed: SparseObservations, *, focal_known: bool) -> int:
    """Return the number of fitted parameters of frames, points and the focal length."""
    n_frames = len(np.unique(listed.other))
    n_points = np.count_nonzero(np.diff(listed.edges))
    return int(CAMERA * n_frames + 3 * n_points - GAUGE + (not focal_known))


def squares_of(listed: SparseObservations, cameras: PerspectiveCameras, shape: Array) -> Array:
    """Return squared residuals `(n,)` px^2."""
    _, depths, seen = _seen(cameras.of(listed.other), shape[listed.own])
    squares = np.sum((np.array([listed.x, listed.y]) - seen.T) ** 2, axis=0)
    return np.where(depths < NEAREST, BEHIND, np.minimum(squares, BEHIND))


def _seen(cameras: PerspectiveCameras, places: Array) -> tuple[Array, Array, Array]:
    """Return points `(n, 3)`, each turned by a camera of its own, their depths, and px where seen."""
    turned = np.einsum("nij,nj->ni", cameras.rotations, places)
    depths = 1 + cameras.curvature * cameras.scales * turned[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        seen = (cameras.scales[:, None] * turned[:, :2] + cameras.shifts) / depths[:, None]
    return turned, depths, seen


def _jacobians(cameras: PerspectiveCameras, places: Array) -> tuple[Array, Array, Array, Array]:
    """Derivatives of where points are seen by camera `(n, 2, 6)`, place `(n, 2, 3)` and q `(n, 2)`.

    Also where they are seen. All are 0 for a point that is not in front of its camera.
    """
    turned, depths, seen = _seen(cameras, places)
    front = depths >= NEAREST
    inverse, seen = np.where(front, 1 / np.where(front, depths, 1), 0), np.where(front[:, None], seen, 0)
    by_turned = cameras.scales * inverse  # of x by p_x; by p_z it is -x q times that
    bend = cameras.curvature * by_turned[:, None] * seen
    px, py, pz = turned.T
    by_camera = np.zeros((len(places), 2, CAMERA))
    by_camera[:, :, 0], by_camera[:, :, 1] = -bend * py[:, None], bend * px[:, None]
    by_camera[:, 0, 1] += by_turned * pz
    by_camera[:, 1, 0] -= by_turned * pz
    by_camera[:, 0, 2], by_camera[:, 1, 2] = -by_turned * py, by_turned * px
    by_camera[:, :, 3] = by_turned[:, None] * turned[:, :2] - bend * pz[:, None]
    by_camera[:, 0, 4] = by_camera[:, 1, 5] = inverse
    rotations = cameras.rotations
    by_place = by_turned[:, None, None] * rotations[:, :2] - bend[:, :, None] * rotations[:, 2:]
    return by_camera, by_place, -seen * (by_turned * pz)[:, None], seen


def adjust(
    listed: SparseObservations,
    cameras: PerspectiveCameras,
    shape: Array,
    *,
    focal_known: bool,
    outliers: bool = True,
    most_steps: int = 100,
    tolerance: float = 0.1,
) -> Bundle:
    """Go to the optimum from cameras and shape `(n_points, 3)`.

    Observations are by point, of `about`, in the order of frames. At most so many steps, and until three in
    a row gain less than `tolerance` nats each.
    """
    squares = squares_of(listed, cameras, shape)
    noise = StudentNoise.of_errors(squares, listed.weight, outliers=outliers)

    def linearised(at: Bundle) -> Callable[[float], Bundle | None]:
        squares = squares_of(listed, at.cameras, at.shape)
        equations = normal_equations(listed, at.noise.weights(squares, listed.weight), at.cameras, at.shape)

        def step(damping: float) -> Bundle | None:
            moved = _moved(listed, equations, damping, at, focal_known)
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
        settled_steps=STILL,
    )[0]


def retriangulated(listed: SparseObservations, bundle: Bundle) -> Array:
    """Triangulate points `(n_points, 3)` again, where that makes them likelier.

    From where they are, from all observations of each alike, and from its first and its last one alone: an
    outlier spoils one of the starts.
    """
    noise, shape = bundle.noise, bundle.shape.copy()
    cameras, own = bundle.cameras.of(listed.other), listed.own
    seen = np.array([listed.x, listed.y]).T
    sums = _sums_of_points(listed)

    def costs(places: Array) -> tuple[Array, Array]:
        """Minus the log likelihood of each point, and what each observation counts in the next solution."""
        _, depths, predicted = _seen(cameras, places[own])
        squares = np.sum((seen - predicted) ** 2, axis=1)
        squares = np.where(depths < NEAREST, BEHIND, np.minimum(squares, BEHIND))
        ratio = listed.weight * squares / (noise.freedom * noise.variance)
        counts = listed.weight / ((1 + ratio) * np.maximum(depths, NEAREST) ** 2)
        return sums @ np.log1p(ratio), counts

    # equations are linear in the point once its depths are divided out
    rows = cameras.rotations[:, :2] - (cameras.curvature * seen)[:, :, None] * cameras.rotations[:, 2:]
    rows *= cameras.scales[:, None, None]
    aims = seen - cameras.shifts
    first, last = np.zeros(len(own), bool), np.zeros(len(own), bool)
    some = np.diff(listed.edges) > 0
    first[listed.edges[:-1][some]] = last[listed.edges[1:][some] - 1] = True
    best, counts = costs(shape)
    starts = counts, listed.weight, np.where(first | last, listed.weight, 0.0)
    beginning = shape.copy()
    for counts in starts:
        tried = beginning
        for _ in range(ROUNDS):
            counted = counts[:, None, None] * rows
            information = (sums @ (counted.mT @ rows).reshape(-1, 9)).reshape(-1, 3, 3)
            vector = sums @ np.einsum("nci,nc->ni", counted, aims)
            ridge = OPEN * np.trace(information, axis1=1, axis2=2) + 1e-30
            information += ridge[:, None, None] * np.eye(3)
            tried = np.linalg.solve(information, (vector + ridge[:, None] * tried)[..., None])[..., 0]
            cost, counts = costs(tried)
            better = cost < best
            best[better], shape[better] = cost[better], tried[better]
    return shape


def _sums_of_points(listed: SparseObservations) -> csr_array:
    """Matrix whose product with numbers of the observations is their sums over those of each point."""
    n = len(listed.x)
    return csr_array((np.ones(n), np.arange(n), listed.edges), shape=(len(listed.edges) - 1, n))


def normal_equations(
    listed: SparseObservations, weights: Array, cameras: PerspectiveCameras, shape: Array
) -> NormalEquations:
    """Return normal equations at the weights `(n,)` of observations."""
    *jacobians, seen = _jacobians(cameras.of(listed.other), shape[listed.own])
    errors = np.stack([listed.x, listed.y], axis=1) - seen
    n, n_frames, last = len(weights), len(cameras.scales), CAMERA
    blocks, vectors = np.zeros((n_frames, last + 1, last + 1)), np.zeros((n_frames, last + 1))
    points, point_vector = np.zeros((len(shape), 3, 3)), np.zeros((len(shape), 3))
    mixed, mixed_border = np.zeros((n, 3, last)), np.zeros((len(shape), 3))
    sum_products(
        listed, weights, *jacobians, errors, blocks, vectors, points, point_vector, mixed, mixed_border
    )
    return NormalEquations(
        cameras=blocks[:, :last, :last],
        camera_vector=vectors[:, :last],
        border=blocks[:, :last, last],
        corner=float(blocks[:, last, last].sum()),
        corner_vector=float(vectors[:, last].sum()),
        points=points,
        point_vector=point_vector,
        mixed=mixed,
        mixed_border=mixed_border,
    )


def reduced(
    listed: SparseObservations, equations: NormalEquations, damping: float, *, focal_known: bool
) -> tuple[Array, Array, Array]:
    """Return the reduced normal equations of cameras and q `(6 n_frames + 1, ...)`, points eliminated."""
    n_frames = len(equations.cameras)
    matrix, vector = np.zeros((CAMERA * n_frames + 1,) * 2), np.zeros(CAMERA * n_frames + 1)
    blocks = matrix[:-1, :-1].reshape(n_frames, CAMERA, n_frames, CAMERA)
    blocks[np.arange(n_frames), :, np.arange(n_frames)] = equations.cameras
    matrix[-1, :-1] = equations.border.reshape(-1)
    matrix[-1, -1] = equations.corner
    vector[:-1], vector[-1] = equations.camera_vector.reshape(-1), equations.corner_vector
    matrix[np.diag_indices_from(matrix)] *= 1 + damping
    points = equations.points.copy()
    size = np.einsum("ijj->i", points)
    # a point of one frame has no depth: rounding must not decide on it
    points[:, range(3), range(3)] += damping * points[:, range(3), range(3)] + 1e-12 * size[:, None] + 1e-30
    inverses = np.ascontiguousarray(np.linalg.inv(points))
    mixed_border = equations.mixed_border
    if focal_known:
        mixed_border = np.zeros_like(mixed_border)
        matrix[-1, :] = 0
        matrix[-1, -1], vector[-1] = 1, 0
    eliminate_points(listed, inverses, equations.mixed, mixed_border, equations.point_vector, matrix, vector)
    return matrix, vector, inverses


def _moved(
    listed: SparseObservations, equations: NormalEquations, damping: float, at: Bundle, focal_known: bool
) -> tuple[PerspectiveCameras, Array] | None:
    """Cameras and shape after a step; `None` if the normal equations are not positive definite."""
    matrix, vector, inverses = reduced(listed, equations, damping, focal_known=focal_known)
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
    pull = np.einsum("kim,km->ki", equations.mixed, by_camera[listed.other])
    left = equations.point_vector - step[-1] * equations.mixed_border - _sums_of_points(listed) @ pull
    return moved, at.shape + np.einsum("ijk,ik->ij", inverses, left)


HELD = 1e6  # information on the gauge, in that on a number of a camera: so much that it does not vary
LEAST_INFORMATION = 1e-10  # in that if all points were known, below which it is rounding


@dataclass(frozen=True, eq=False)
class BundleCovariance:
    """To first order, in the gauge (place, turn and size of the shape) in which cameras vary least.

    Cameras `(n_frames, 7, 7)` are turn, log scale and shift of each frame, and 1 / focal length; points
    `(n_points, 3, 3)`; both `(n_points, 3, 6 n_frames + 1)`, the last number 1 / focal length.
    """

    cameras: Array
    points: Array
    points_and_cameras: Array
    # 1/px: standard deviation of 1 / focal length by `systematic_fields`; 0 where that was given
    systematic_curvature: float

    @property
    def curvature_deviation(self) -> float:
        """Standard deviation of 1 / focal length by noise, 1/px; 0 where that was given."""
        return float(np.sqrt(self.cameras[0, -1, -1]))


def covariance_of(
    listed: SparseObservations, bundle: Bundle, prior: Array, *, focal_known: bool
) -> BundleCovariance:
    """Return the covariance at the optimum, from the information of all observations (Laplace).

    `prior` is the covariance `(3, 3)` of points before anything is seen: what is known of one of a single
    frame.
    """
    squares = squares_of(listed, bundle.cameras, bundle.shape)
    precision = bundle.noise.precision(squares, listed.weight, freedom(listed, focal_known=focal_known))
    # on the whole as Huber has it; an outlier, whose position depends on nothing, does not inform cameras
    counted = bundle.noise.weights(squares, listed.weight)
    counted *= precision * listed.weight.mean() / counted.mean()
    equations = normal_equations(listed, counted, bundle.cameras, bundle.shape)
    equations = equations._replace(points=equations.points + np.linalg.inv(prior))
    whole, inverses = _of_cameras(listed, equations, bundle.cameras, focal_known=focal_known)
    systematic = 0.0
    if not focal_known:
        fields = systematic_fields(listed, bundle.noise)
        systematic = float(
            np.linalg.norm(whole[-1] @ _pulled(listed, counted, equations, inverses, bundle, fields))
        )

    n_frames, n_points = len(bundle.cameras.scales), len(bundle.shape)
    columns = CAMERA * listed.other[:, None] + np.arange(CAMERA)
    rows = 3 * listed.own[:, None] + np.arange(3)
    where = (
        np.broadcast_to(rows[:, :, None], equations.mixed.shape).reshape(-1),
        np.broadcast_to(columns[:, None, :], equations.mixed.shape).reshape(-1),
    )
    mixed = csr_array((equations.mixed.reshape(-1), where), shape=(3 * n_points, CAMERA * n_frames))
    reach = (mixed @ whole[:-1] + equations.mixed_border.reshape(-1, 1) * whole[-1]).reshape(n_points, 3, -1)
    inside = np.zeros((n_points, 3, 3))
    np.add.at(
        inside, listed.own, np.einsum("kim,kmj->kij", equations.mixed, reach[listed.own[:, None], :, columns])
    )
    inside += equations.mixed_border[:, :, None] * reach[:, None, :, -1]
    points = inverses + inverses @ inside @ inverses

    frames = CAMERA * np.arange(n_frames)[:, None] + np.arange(CAMERA)
    frames = np.concatenate([frames, np.full((n_frames, 1), CAMERA * n_frames)], axis=1)
    return BundleCovariance(
        whole[frames[:, :, None], frames[:, None, :]],
        0.5 * (points + points.transpose(0, 2, 1)),
        -inverses @ reach,
        systematic,
    )


PRINCIPAL, DISTORTION = 0.06, 0.003
"""Of half the larger extent of what is seen: standard deviations of the principal point, and of the radial
displacement at its edge, of lenses that nobody has calibrated."""
SMOOTH = 3  # degree of the polynomials over the picture that systematic errors of positions are


def systematic_fields(listed: SparseObservations, noise: StudentNoise) -> Array:
    """Return errors `(k, 2, n)` px that all observations may have in common, each of one deviation.

    A principal point and a radial distortion that are not as assumed; and errors of tracks that are smooth
    over the picture, by the light and the slant of surfaces, as large as their random ones.
    """
    x, y = listed.x, listed.y
    extent = max(np.abs(x).max(), np.abs(y).max())
    off = np.full_like(x, PRINCIPAL * extent)
    nothing, cubic = np.zeros_like(x), DISTORTION * (x**2 + y**2) / extent**2
    powers = [(i, j) for i in range(SMOOTH + 1) for j in range(SMOOTH + 1 - i)]
    smooth, _ = np.linalg.qr(np.stack([(x / extent) ** i * (y / extent) ** j for i, j in powers], axis=1))
    smooth *= math.sqrt(noise.variance * len(x))
    lens = [(off, nothing), (nothing, off), (cubic * x, cubic * y)]
    tracks = [pair for each in smooth.T for pair in ((each, nothing), (nothing, each))]
    return np.array([*lens, *tracks])


def _pulled(
    listed: SparseObservations,
    weights: Array,
    equations: NormalEquations,
    inverses: Array,
    bundle: Bundle,
    fields: Array,
) -> Array:
    """Return how errors `(k, 2, n)` px of observations change the reduced vector: `(6 n_frames + 1, k)`."""
    by_camera, by_place, by_focal, _ = _jacobians(bundle.cameras.of(listed.other), bundle.shape[listed.own])
    by_camera = weights[:, None, None] * np.concatenate([by_camera, by_focal[:, :, None]], axis=2)
    by_place = weights[:, None, None] * by_place
    n, n_frames = len(weights), len(bundle.cameras.scales)
    of_points = _sums_of_points(listed)
    of_frames = csr_array((np.ones(n), (listed.other, np.arange(n))), shape=(n_frames, n))
    pulls = []
    for field in fields:
        vectors = of_frames @ np.einsum("nci,cn->ni", by_camera, field)
        moved = of_points @ np.einsum("nci,cn->ni", by_place, field)
        moved = np.einsum("ijk,ik->ij", inverses, moved)  # points, by which cameras are pulled back
        back = of_frames @ np.einsum("nim,ni->nm", equations.mixed, moved[listed.own])
        of_focal = vectors[:, -1].sum() - np.sum(equations.mixed_border * moved)
        pulls.append(np.append((vectors[:, :-1] - back).reshape(-1), of_focal))
    return np.stack(pulls, axis=1)


def _of_cameras(
    listed: SparseObservations, equations: NormalEquations, cameras: PerspectiveCameras, *, focal_known: bool
) -> tuple[Array, Array]:
    """Covariance of all cameras and 1 / focal length, and of points given those."""
    matrix, _, inverses = reduced(listed, equations, 0.0, focal_known=focal_known)
    matrix = np.tril(matrix) + np.tril(matrix, -1).T
    of_points_known = np.append(
        np.einsum("tjj->tj", equations.cameras), 1.0 if focal_known else equations.corner
    )
    size = np.sqrt(np.where(of_points_known > 0, of_points_known, 1.0))  # of nothing, nothing is known
    gauge, _ = np.linalg.qr(size[:, None] * gauge_of(cameras))
    values, axes = np.linalg.eigh(matrix / size[:, None] / size + HELD * gauge @ gauge.T)
    axes /= size[:, None]
    whole: Array = (axes / np.maximum(values, LEAST_INFORMATION)) @ axes.T
    if focal_known:
        whole[-1, :] = whole[:, -1] = 0
    return whole, inverses


def gauge_of(cameras: PerspectiveCameras) -> Array:
    """Return the gauge directions `(6 n_frames + 1, 7)` of cameras and q: turn, growth and shift."""
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


def predicted(bundle: Bundle, covariance: BundleCovariance) -> tuple[Array, Array]:
    """Return positions `(n_frames, n_points, 2)` px of all points, and their covariances px^2."""
    positions, depths = bundle.cameras.seen(bundle.shape)
    covariances = np.empty((*positions.shape, 2))
    for t, of_camera in enumerate(covariance.cameras):
        frames = np.full(len(bundle.shape), t)
        by_camera, by_place, by_focal, _ = _jacobians(bundle.cameras.of(frames), bundle.shape)
        by_both = np.concatenate([by_camera, by_focal[:, :, None]], axis=2)
        columns = [*range(CAMERA * t, CAMERA * (t + 1)), -1]
        mixed = by_place @ covariance.points_and_cameras[:, :, columns] @ by_both.mT
        covariances[t] = by_both @ of_camera @ by_both.mT + by_place @ covariance.points @ by_place.mT
        covariances[t] += mixed + mixed.mT
    covariances[depths < NEAREST] = BEHIND * np.eye(2)
    return positions, covariances

"""Structure from motion as a filtering chain: points of a rigid shape before a moving affine camera (§4.3).

The conclusion of the RSMCM paper claims this filter without giving it; what is here is ours, in constant
time per frame: eq. (18) to (20), position of point i = M (S_i, 1) + noise, the shape S constant, the rows of
M moving by eq. (19) with time in seconds. Points and camera have a covariance each (the camera's rows of u
and v share one) and are updated in turn. A point learns from the camera that the *other* points of the frame
show, whose errors are not its own: so covariances stay consistent.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...inference.kalman import kinematic
from ...inference.sfm.factor_analysis.em import CameraPrior, estimate_cameras, homogeneous
from ...inference.sfm.factor_analysis.factorisation import factorise_robustly, projected
from ...models.core.checks import Count, CountFrom0, NotNegative, Positive, Shape, at_least, checked
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage, squared_distances
from ...models.core.identities import Turnover, common, find, union
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import NO_POINTS, PointMessage, PointTracks

Array = NDArray[np.float64]
Identities = NDArray[np.int64]
Mask = NDArray[np.bool_]

ROW = 4
ORDERS = 3
VAGUE = 1e2  # standard deviation of a vague prior, in extents of the shape's picture (and a second)
UNSTEADY = 1e-2  # noise of a motion before it is learned, in extents a frame


@short_repr
@dataclass(frozen=True, eq=False)
class CameraMotion:
    """Gaussian state of the camera at one time.

    Parameters
    ----------
    mean, covariance
        of the rows of u and v: m, m' (1/s) and m'' (1/s^2), four numbers each; of either row.
    noise
        by how much the variances of m, m' and m'' grow in a second of themselves; of the numbers
        that multiply the shape, and of the translation.
    """

    mean: Annotated[Array, Shape(2, 12)]
    covariance: Annotated[Array, Shape(12, 12)]
    noise: Annotated[Array, Shape(3, 2)]

    @property
    def camera(self) -> Array:
        """`(2, 4)`: position in px = camera[:, :3] @ shape + camera[:, 3]."""
        return self.mean[:, :ROW]

    @property
    def camera_covariance(self) -> Array:
        """`(4, 4)`, of either row."""
        return self.covariance[:ROW, :ROW]

    @classmethod
    def vague(cls, extent: float, noise: Array) -> Self:
        """Return a camera with a vague prior, for a shape of about `extent` px."""
        return cls(np.zeros((2, ORDERS * ROW)), (VAGUE * extent) ** 2 * np.eye(ORDERS * ROW), noise)

    def predict(self, dt: float) -> Self:
        """Return the camera `dt` seconds on; a negative `dt` is a `ValueError`.

        Eq. (19), with noise that acts all the time: two steps do the same as one of their length.
        """
        steps = kinematic(ORDERS, dt).along(ROW).transition
        covariance = steps @ self.covariance @ steps.T
        added = np.zeros((ORDERS, ORDERS, ROW))
        for order in range(1, ORDERS + 1):  # noise of a derivative moves those below it
            density = self.noise[order - 1, [0, 0, 0, 1]]
            added[:order, :order] += kinematic(order, dt).noise[:, :, None] * density
        for number in range(ROW):
            covariance[number::ROW, number::ROW] += added[:, :, number]
        return replace(self, mean=self.mean @ steps.T, covariance=0.5 * (covariance + covariance.T))

    def shaken(self, variance: float) -> Self:
        """Return the camera after a jerk that adds `variance` (px^2) to each number of its rows."""
        covariance = self.covariance.copy()
        covariance[range(ROW), range(ROW)] += variance
        return replace(self, covariance=covariance)

    def update(self, information: Array, vector: Array) -> Self:
        """Return the camera updated with information `(4, 4)` of either row, vector `(2, 4)` of u and v."""
        seen = self.covariance[:, :ROW]
        shrink = np.linalg.inv(np.eye(ROW) + information @ seen[:ROW])
        mean = self.mean + (vector - self.camera @ information) @ shrink.T @ seen.T
        covariance = self.covariance - seen @ (shrink @ information) @ seen.T
        # the block that is seen as a product: a difference of large numbers would lose sharp information
        covariance[:ROW] = (seen @ shrink).T
        covariance[:, :ROW] = covariance[:ROW].T
        return replace(self, mean=mean, covariance=0.5 * (covariance + covariance.T))


def learned_noise(noise: Array | None, evidence: "CameraEvidence", extent: float, rounds: int = 1) -> Array:
    """Return the noise `(3, 2)` of `CameraMotion` after EM rounds over the last frames.

    `noise` is what to begin with, or `None`. `evidence` is of two frames or more; their times are brought
    onto a grid of their median distance. `extent` px is about how large the shape appears. No round of the
    smoother makes the likelihood less.
    """
    information, vector, times = evidence.information, evidence.vector, evidence.times
    step = float(np.median(np.diff(times)))
    back = np.round((times[-1] - times) / step).astype(np.int64)
    recent = back < 2 * len(times)  # a long gap ends the stretch
    place = back[recent][0] - back[recent]
    n_steps = int(place[-1]) + 1
    of_grid, vector_of_grid = np.zeros((n_steps, ROW, ROW)), np.zeros((n_steps, ROW, 2))
    np.add.at(of_grid, place, extent**2 * information[recent])
    np.add.at(vector_of_grid, place, extent * vector[recent].transpose(0, 2, 1))
    per_step = step ** (2 * np.arange(ORDERS)[:, None] + 1) / extent**2
    first = np.full((ORDERS, 2), UNSTEADY**2) if noise is None else noise * per_step
    prior = CameraPrior(first, coherent=True)
    for _ in range(rounds):
        prior = estimate_cameras(of_grid, vector_of_grid, 1.0, prior).better
    return prior.variance / per_step


GATE = 9.21  # squared Mahalanobis distance of a position (two numbers) that one inlier in a hundred exceeds
MEDIAN = 2 * np.log(2)  # of squared Mahalanobis distances of positions
REGISTRATIONS = 5  # rounds in which the camera and the choice of inliers settle, at most
PRIOR_DEVIATION = 3.0  # standard deviation of a new point's place, in units of the first shape's spread
MOTION_FRAMES = 48  # last frames from which the noise of the camera's motion is learned
LEARNING_RATE = 0.05  # share by which a frame with many points changes what is known of the noise
LEAST_SCALE = 1e-4  # of `noise_scale`, at least: a hundredth of the standard deviation that is stated
MOST_CORRELATION = 0.9  # of a point's errors from one frame to the next; then 19 observations are worth one
MANY = 10  # points of a frame from which on it counts as one with many
OUTLIER_TIME = 0.2  # s in which the covariance of a point grows by e while it is an outlier


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """Points of a frame: identities `(k,)` increasing, positions `(k, 2)` px, variances px^2 as stated."""

    identities: Identities
    positions: Array
    variances: Array

    def __len__(self) -> int:
        return len(self.identities)


@short_repr
@dataclass(frozen=True, eq=False)
class CameraEvidence:
    """Evidence of the last frames about the camera: information and vector of Gaussians, times s."""

    information: Annotated[Array, Shape("n", 4, 4)]
    vector: Annotated[Array, Shape("n", 2, 4)]
    times: Annotated[Array, Shape("n")]

    def require_fit(self) -> None:
        """Raise a `ValueError` if frames do not follow each other."""
        if not (np.diff(self.times) > 0).all():
            raise ValueError("times: got numbers that do not increase, expected those of frames")


PER_POINT = ("identities", "shape", "shape_covariance", "unseen", "innovations")


@short_repr
@dataclass(frozen=True, eq=False)
class Structure:
    """Shape and camera; they are determined up to an affine change of both.

    Parameters
    ----------
    identities
        increasing.
    shape, shape_covariance
        in units of the first shape's spread.
    unseen
        s since a point was last an inlier.
    motion, evidence
        of the camera, and of it in the last frames.
    extent
        px, about how large the shape appeared at first.
    noise_scale
        how much larger the variances of positions are than stated.
    innovations, autocorrelation
        px: position less prediction of each point when it was last an inlier; from one frame to the
        next.
    wander
        px^2/s, in u and in v: how fast what a point is off by changes (see `offsets`).
    """

    identities: Annotated[Identities, Shape("n")]
    shape: Annotated[Array, Shape("n", 3)]
    shape_covariance: Annotated[Array, Shape("n", 3, 3)]
    unseen: Annotated[Array, Shape("n")]
    motion: CameraMotion
    evidence: CameraEvidence
    extent: Positive
    noise_scale: Positive
    innovations: Annotated[Array, Shape("n", 2)]
    autocorrelation: float
    wander: NotNegative

    @property
    def offsets(self) -> Array:
        """`(n, 2)` px: what each point is taken to be off by, since what it was off by lasts.

        The camera is not quite affine, the thing not quite rigid, and a tracker's patch drifts. With e = a +
        white noise and autocorrelation rho, the mean of a given e is rho e, and its variance rho (1 - rho)
        that of e.
        """
        return self.autocorrelation * self.innovations

    def __len__(self) -> int:
        return len(self.identities)

    def only(self, kept: NDArray[np.intp]) -> "Structure":
        """Return the structure of some of the points, by row."""
        return replace(self, **{name: getattr(self, name)[kept] for name in PER_POINT})


@dataclass(frozen=True, eq=False)
class Registration:
    """A frame's camera, as all points show it and as all but one do.

    Parameters
    ----------
    motion, information, vector
        updated with the frame, and the frame's information, as `CameraMotion.update` takes it.
    cameras, leverages, means, covariances
        for every known point the camera that the others show `(n, 2, 4)`, the variance (px^2, in u and in v)
        that its uncertainty gives the point, and where the point should be therefore: `(n, 2)` px and `(n,
        2, 2)` px^2.
    places, positions, variances, inliers
        `(k,)` of the seen points among the known ones, where they were seen, the noise of that, and whether
        it is not too far from where they should be.
    """

    motion: CameraMotion
    information: Array
    vector: Array
    cameras: Array
    leverages: Array
    means: Array
    covariances: Array
    places: NDArray[np.intp]
    positions: Array
    variances: Array
    inliers: Mask


def register(structure: Structure, seen: ObservedPoints) -> Registration:
    """Register a frame: the camera that fits its points, without outliers, and without each point."""
    places, known = find(structure.identities, seen.identities)
    places = places[known]
    positions, variances = seen.positions[known], structure.noise_scale * seen.variances[known]
    before, all_points, spreads = structure.motion, homogeneous(structure.shape), structure.shape_covariance
    points = all_points[places]
    of_shape = _seen_through(before.camera[None, :, :3], spreads[places])
    of_both = _joint(before, spreads[places])
    # The rows of the camera share one covariance, so to them noise is the same in all directions.
    noise = variances + np.trace(of_shape, axis1=1, axis2=2) + of_both

    def distances(motion: CameraMotion, used: Mask) -> Array:
        """Return squared Mahalanobis distances of points from predictions by the used ones without them.
        are."""
        leverage = _leverage(motion, points)
        left = np.where(used, 1 - leverage / noise, 1.0)
        off = (positions - points @ motion.camera.T) / left[:, None]
        covariances = of_shape + isotropic(variances + of_both + leverage / left)
        return squared_distances(off, covariances)

    off = ((positions - points @ before.camera.T) ** 2).sum(axis=1)
    inliers = distances(before, np.zeros(len(points), bool)) <= GATE
    if 2 * inliers.sum() < len(inliers):
        # A jerk: of the camera next to nothing is known from before, by as much as the points are off.
        before = before.shaken(float(np.median(off)))
        inliers = distances(before, np.zeros(len(points), bool)) <= GATE
    for _ in range(REGISTRATIONS):
        information, vector = camera_information(points, positions, np.where(inliers, 1 / noise, 0.0))
        motion = before.update(information, vector)
        settled, inliers = inliers, distances(motion, inliers) <= GATE
        if np.array_equal(inliers, settled):
            break
    inliers = settled

    cameras, leverages = np.tile(motion.camera, (len(structure), 1, 1)), _leverage(motion, all_points)
    used, others = places[inliers], noise[inliers] - leverages[places[inliers]]
    off = positions[inliers] - points[inliers] @ motion.camera.T
    pull = points[inliers] @ motion.camera_covariance / others[:, None]
    cameras[used] -= off[:, :, None] * pull[:, None, :]
    leverages[used] *= noise[inliers] / others
    leverages += _joint(motion, spreads)
    wandered = structure.wander * structure.unseen
    return Registration(
        motion=motion,
        information=information,
        vector=vector,
        cameras=cameras,
        leverages=leverages,
        means=(cameras @ all_points[:, :, None])[:, :, 0] + structure.offsets,
        covariances=_seen_through(cameras[:, :, :3], spreads) + isotropic(leverages + wandered),
        places=places,
        positions=positions,
        variances=variances,
        inliers=inliers,
    )


def updated(structure: Structure, registration: Registration, elapsed: float, time: float) -> Structure:
    """Return the structure updated with a registered frame, `elapsed` s after the last one."""
    shape, covariance = structure.shape.copy(), structure.shape_covariance.copy()
    unseen = structure.unseen.copy()
    inliers, outliers = registration.places[registration.inliers], registration.places[~registration.inliers]
    noise = correlation_time(structure.autocorrelation) * registration.variances[registration.inliers]
    noise += registration.leverages[inliers]
    shape[inliers], covariance[inliers] = intersect(
        shape[inliers],
        covariance[inliers],
        registration.cameras[inliers],
        registration.positions[registration.inliers],
        noise,
    )
    covariance[outliers] *= np.exp(elapsed / OUTLIER_TIME)
    unseen[inliers] = 0.0
    if len(registration.places):
        structure = _with_learned_noise(structure, registration, elapsed, time)
    return replace(structure, shape=shape, shape_covariance=covariance, unseen=unseen)


def add_points(structure: Structure, seen: ObservedPoints) -> Structure:
    """Return the structure with the points that are new in a frame, whose camera is known."""
    new = ~find(structure.identities, seen.identities)[1]
    count, motion = int(new.sum()), structure.motion
    if not count:
        return structure
    shape, covariance = np.zeros((count, 3)), np.tile(PRIOR_DEVIATION**2 * np.eye(3), (count, 1, 1))
    noise = structure.noise_scale * seen.variances[new] + _joint(motion, covariance)
    noise += _leverage(motion, homogeneous(shape))
    cameras = np.tile(motion.camera, (count, 1, 1))
    shape, covariance = intersect(shape, covariance, cameras, seen.positions[new], noise)
    added = seen.identities[new], shape, covariance, np.zeros(count), np.zeros((count, 2))
    turnover = Turnover.between(structure.identities, np.ones(len(structure), np.bool_), added[0])
    parts = zip(PER_POINT, added, strict=True)
    return replace(structure, **{name: turnover.rows(getattr(structure, name), new) for name, new in parts})


def intersect(
    shape: Array, covariance: Array, cameras: Array, positions: Array, noise: Array
) -> tuple[Array, Array]:
    """Return points after each was seen by a camera of its own (Kalman update in Joseph's form).

    Points `(k, 3)` with covariances, cameras `(k, 2, 4)`, positions `(k, 2)` px, noise `(k,)` px^2 of u and
    of v.
    """
    linear = cameras[:, :, :3]
    off = positions - cameras[:, :, 3] - (linear @ shape[:, :, None])[:, :, 0]
    gain = covariance @ linear.transpose(0, 2, 1)
    gain = gain @ np.linalg.inv(linear @ gain + isotropic(noise))
    left = np.eye(3) - gain @ linear
    after = left @ covariance @ left.transpose(0, 2, 1)
    after += noise[:, None, None] * (gain @ gain.transpose(0, 2, 1))
    return shape + (gain @ off[:, :, None])[:, :, 0], after


def correlation_time(autocorrelation: float) -> float:
    """Return the integrated autocorrelation time of a point's errors, in frames."""
    correlation = min(max(autocorrelation, 0.0), MOST_CORRELATION)
    return (1 + correlation) / (1 - correlation)


def wandering(autocorrelation: float, variances: Array, elapsed: float) -> float:
    """Return `Structure.wander` of errors with these variances, `elapsed` s apart."""
    return autocorrelation * (1 - autocorrelation) * float(np.median(variances)) / elapsed


def camera_information(points: Array, positions: Array, precisions: Array) -> tuple[Array, Array]:
    """Return information `(4, 4)` and vector `(2, 4)` of a camera, from homogeneous points `(k, 4)`."""
    weighted = points.T * precisions
    return weighted @ points, (weighted @ positions).T


def isotropic(variances: Array) -> Array:
    """Return `(n, 2, 2)` covariances, the same in all directions."""
    return variances[:, None, None] * np.eye(2)


def _leverage(motion: CameraMotion, points: Array) -> Array:
    """px^2 by which the camera's uncertainty moves points `(n, 4)`, in u and in v."""
    moved: Array = ((points @ motion.camera_covariance) * points).sum(axis=1)
    return moved


def _seen_through(linear: Array, spreads: Array) -> Array:
    """`(n, 2, 2)` px^2: covariances of points `(n, 3, 3)` as they show in the picture."""
    return linear @ spreads @ linear.swapaxes(-1, -2)


def _joint(motion: CameraMotion, spreads: Array) -> Array:
    """px^2, in u and in v, of the product of both errors, the camera's and the point's."""
    moved: Array = (motion.camera_covariance[:3, :3] * spreads).sum(axis=(1, 2))
    return moved


def _with_learned_noise(
    structure: Structure, registration: Registration, elapsed: float, time: float
) -> Structure:
    """The structure with noise of positions and of the camera's motion updated by a frame."""
    places, count = registration.places, len(registration.places)
    off = registration.positions - registration.means[places] + structure.offsets[places]
    total = registration.covariances[places] + isotropic(
        registration.variances - structure.wander * structure.unseen[places]
    )
    trust = (
        2 * registration.variances / np.trace(total, axis1=1, axis2=2)
    )  # else points are off by their own error
    rate = LEARNING_RATE * count / (count + MANY)
    # A Newton step towards the scale at which half of the points are farther off than the median should be:
    # those that are far off for another reason count as little as can be.
    far = squared_distances(off, total) > MEDIAN
    step = float((trust * (far - 0.5)).sum() / trust.sum()) / (0.25 * MEDIAN)
    scale = max(structure.noise_scale * float(np.exp(rate * step)), LEAST_SCALE)

    innovations = structure.innovations.copy()
    again = registration.inliers & (structure.unseen[places] <= 1.01 * elapsed)
    before, now = innovations[places[again]], off[again]
    products = float((trust[again] * (before * now).sum(axis=1)).sum())
    squares = float((trust[again] * 0.5 * (before**2 + now**2).sum(axis=1)).sum())
    correlation = products / squares if squares > 0 else structure.autocorrelation
    autocorrelation = max(0.0, structure.autocorrelation + rate * (correlation - structure.autocorrelation))
    innovations[places[registration.inliers]] = off[registration.inliers]

    evidence = CameraEvidence(
        np.concatenate([structure.evidence.information, registration.information[None]])[-MOTION_FRAMES:],
        np.concatenate([structure.evidence.vector, registration.vector[None]])[-MOTION_FRAMES:],
        np.append(structure.evidence.times, time)[-MOTION_FRAMES:],
    )
    noise = structure.motion.noise
    if len(evidence.times) > 1:
        noise = learned_noise(noise, evidence, structure.extent)
    return replace(
        structure,
        noise_scale=scale,
        evidence=evidence,
        motion=replace(registration.motion, noise=noise),
        innovations=innovations,
        autocorrelation=autocorrelation,
        wander=wandering(autocorrelation, registration.variances, elapsed),
    )


LEAST_SEEN = 6  # points that a frame has to show to be kept
LEAST_FRAMES = 3  # frames that have to show a point for it to be part of the first shape
FIRST_FRAMES, MOST_FRAMES, STEP = 8, 32, 4  # frames that are kept at first, at most, and between attempts
CLEAR = 4.0  # how far the shape's third direction must stand out of what noise alone would give for one
UNEVEN = 3.0  # mean over usual squared error from which on a fit is led by outliers
ROUNDS = 100  # of learning the noise of the camera's motion


@short_repr
@dataclass(frozen=True, eq=False)
class Window:
    """Frames and what they show; when there are too many, every other one is dropped.

    Of the points `identities`, increasing, positions px and variances px^2 are 0 where not seen. One of
    `stride` frames is kept, and `skipped` were left out since the last.
    """

    identities: Annotated[Identities, Shape("n")]
    positions: Annotated[Array, Shape("n_frames", "n", 2)]
    variances: Annotated[Array, Shape("n_frames", "n")]
    times: Annotated[Array, Shape("n_frames")]
    stride: Count = 1
    skipped: CountFrom0 = 0

    @classmethod
    def empty(cls) -> "Window":
        """Return a window without frames."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 0, 2)), np.zeros((0, 0)), np.zeros(0))

    def lengthened(self, seen: ObservedPoints, time: float, max_points: int) -> "Window":
        """Return the window with a frame, if it is due; of too many points those seen most are kept."""
        if len(seen) < LEAST_SEEN:
            return self
        if self.skipped + 1 < self.stride:
            return replace(self, skipped=self.skipped + 1)
        every, stride = (2, 2 * self.stride) if len(self.times) == MOST_FRAMES else (1, self.stride)
        times = np.append(self.times[::every], time)
        identities, old, new = union(self.identities, seen.identities)
        positions = np.zeros((len(times), len(identities), 2))
        variances = np.zeros((len(times), len(identities)))
        positions[:-1, old], variances[:-1, old] = self.positions[::every], self.variances[::every]
        positions[-1, new], variances[-1, new] = seen.positions, seen.variances
        counts = (variances > 0).sum(axis=0)
        kept = np.sort(np.argsort(-counts, kind="stable")[: min(max_points, np.count_nonzero(counts))])
        return Window(identities[kept], positions[:, kept], variances[:, kept], times, stride)

    @property
    def due(self) -> bool:
        """Whether it is time to try for a shape."""
        n_frames = len(self.times)
        return not self.skipped and n_frames >= FIRST_FRAMES and n_frames % STEP == 0


def first_structure(window: Window) -> Structure | None:
    """Return shape and camera after the last frame, or `None` if the points' motion does not determine them.

    Of a static camera or a flat scene one of the shape's three directions comes from noise alone. A
    `ValueError` says if frames fall into sets that share too few points.
    """
    frames, points = _enough(window.variances > 0)
    if len(frames) < FIRST_FRAMES:
        return None
    chosen = np.ix_(frames, points)
    positions, stated = window.positions[chosen], window.variances[chosen]
    weights = np.divide(1, stated, out=np.zeros_like(stated), where=stated > 0)
    found = factorise_robustly(positions, weights)
    fit = found.factorisation
    squares = weights * ((positions - projected(fit.cameras, fit.shape)) ** 2).sum(axis=2)
    usual = float(np.median(squares[found.trusted])) / MEDIAN
    if fit.noise_variance > max(UNEVEN * usual, LEAST_SCALE) and len(window.times) < MOST_FRAMES:
        return None
    trusted_frames, trusted_points = _enough(found.trusted)
    if len(trusted_frames) < FIRST_FRAMES:
        return None
    chosen = np.ix_(trusted_frames, trusted_points)
    positions, stated, seen = positions[chosen], stated[chosen], found.trusted[chosen]
    cameras, shape = fit.cameras[trusted_frames], fit.shape[trusted_points]
    times, identities = window.times[frames][trusted_frames], window.identities[points][trusted_points]
    weights = np.where(seen, weights[chosen], 0.0)
    scale = max(fit.noise_variance, LEAST_SCALE)
    linear = cameras[:, :, :3]
    per_frame, per_point = seen.sum() / seen.shape[0], seen.sum() / seen.shape[1]
    _, sizes, directions = np.linalg.svd(linear.reshape(-1, 3), full_matrices=False)
    third = np.sqrt(per_frame) * sizes[2]
    # a track that goes on at another point has a depth of its own, and nearly all of the sum of squares
    depths = np.square(shape @ directions[2])
    by_chance = np.sqrt(scale * stated[seen].mean()) * (np.sqrt(2 * per_point) + np.sqrt(per_frame))
    if not (third > CLEAR * by_chance and depths.sum() ** 2 > LEAST_SEEN * np.square(depths).sum()):
        return None

    extent = float(np.sqrt(0.5 * (linear**2).sum() / len(linear)))
    precisions = weights / scale
    autocorrelation = _autocorrelation(cameras, shape, positions, seen)
    shape, covariance = _intersected(cameras, shape, positions, precisions, correlation_time(autocorrelation))
    of_shape = np.einsum("tcj,ijk,tck->ti", linear, covariance, linear, optimize=True)
    points_and_one = homogeneous(shape)
    of_camera = [
        camera_information(points_and_one, where, precision / (1 + precision * noise))
        for where, precision, noise in zip(positions, precisions, of_shape, strict=True)
    ]
    information, vector = (np.array(parts) for parts in zip(*of_camera, strict=True))
    evidence = CameraEvidence(information, vector, times)
    motion_noise = learned_noise(None, evidence, extent, ROUNDS)
    motion = CameraMotion.vague(extent, motion_noise)
    for k in range(len(times)):
        if k:
            motion = motion.predict(float(times[k] - times[k - 1]))
        motion = motion.update(information[k], vector[k])
    now = float(window.times[-1])
    if now > times[-1]:
        motion = motion.predict(now - float(times[-1]))
    last_seen = times[len(times) - 1 - np.argmax(seen[::-1], axis=0)]
    return Structure(
        identities=identities,
        shape=shape,
        shape_covariance=covariance,
        unseen=now - last_seen,
        motion=motion,
        evidence=evidence,
        extent=extent,
        noise_scale=scale,
        innovations=np.zeros_like(shape[:, :2]),
        autocorrelation=autocorrelation ** (1 / window.stride),
        wander=wandering(autocorrelation, scale * stated[seen], float(np.median(np.diff(times)))),
    )


def _enough(seen: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Frames and points that are seen often enough, of `(n_frames, n_points)`."""
    points = seen.sum(axis=0) >= LEAST_FRAMES
    return np.flatnonzero(seen[:, points].sum(axis=1) >= LEAST_SEEN), np.flatnonzero(points)


def _autocorrelation(cameras: Array, shape: Array, positions: Array, seen: NDArray[np.bool_]) -> float:
    """Correlation of what points are off by, from one frame of the window to the next."""
    off = np.where(seen[:, :, None], positions - projected(cameras, shape), 0.0)
    both = (seen[1:] & seen[:-1])[:, :, None]
    squares = 0.5 * float(((off[1:] ** 2 + off[:-1] ** 2) * both).sum())
    return max(0.0, float((off[1:] * off[:-1]).sum()) / squares) if squares > 0 else 0.0


def _intersected(
    cameras: Array, shape: Array, positions: Array, precisions: Array, repeated: float
) -> tuple[Array, Array]:
    """Points `(n, 3)` and their covariances from all frames, each through the camera that the others show."""
    points = homogeneous(shape)
    of_frames = np.einsum("ti,ij,ik->tjk", precisions, points, points, optimize=True)
    leverage = np.einsum("ij,tjk,ik->ti", points, np.linalg.inv(of_frames), points, optimize=True)
    others = np.maximum(1 - precisions * leverage, 1e-6)  # without the point's share of its own camera
    weights = precisions / (repeated + precisions * leverage / others)
    linear = cameras[:, :, :3]
    information = np.einsum("ti,tcj,tck->ijk", weights, linear, linear, optimize=True)
    vector = np.einsum("ti,tcj,tic->ij", weights, linear, positions - cameras[:, None, :, 3], optimize=True)
    covariance = np.linalg.inv(information + np.eye(3) / PRIOR_DEVIATION**2)
    return (covariance @ vector[:, :, None])[:, :, 0], covariance


LOST = 0.5  # standard deviation of the camera, in extents of the shape's picture, from which on it is lost


@short_repr
@dataclass(frozen=True, eq=False)
class StructureState:
    """A shape and its camera, or a window of frames that do not determine one yet.

    `time` and `elapsed` are s, of the state, and since the last frame that it was updated with.
    """

    time: float
    elapsed: float
    window: Window
    structure: Structure | None


@checked
@short_repr
@dataclass(frozen=True)
class RecursiveStructure:
    """Rigid shape and camera motion, from the points that others track; RSMCM eq. (18) to (20), filtered.

    The message to a point is `N(M_-i (S_i, 1), P_i)`, with `M_-i` the camera from the other points of the
    frame (the predicted camera if there are none), and P_i the covariance from this camera and S_i.

    Its message is uniform until the motion determines a shape (never with a static camera, a flat scene, or
    fewer than six points). When the camera is lost (another scene, no visible point of the shape), the shape
    ends and a new one begins.

    Parameters
    ----------
    max_coast_time
        s after which a point without observations ends.
    max_points
        maximum number of points; those not seen for longest end first.
    """

    max_coast_time: Positive = 20.0
    max_points: Annotated[int, at_least(LEAST_SEEN)] = 2000
    name: str = "structure"

    ports = (Port(PointTracks, Cavity.OTHERS),)

    def initial(self, frame: Frame) -> StructureState:
        """Return a state without shape."""
        return StructureState(frame.time, 0.0, Window.empty(), None)

    def predict(self, state: StructureState, dt: float) -> StructureState:
        """Return the state `dt` seconds on: the camera moves, the shape stays."""
        structure = state.structure
        if structure is not None:
            motion = structure.motion.predict(dt)
            structure = replace(structure, motion=motion, unseen=structure.unseen + dt)
        return replace(state, time=state.time + dt, elapsed=state.elapsed + dt, structure=structure)

    def message(self, state: StructureState, feature: PointTracks, incoming: Incoming) -> PointMessage:
        """Return the densities of all points' positions (mu_{S -> F}); uniform as long as there is no shape.

        All points depend on one camera, which a message of independent points cannot represent: each gets its
        own marginal, given the other points.
        """
        structure = state.structure
        if structure is None or not len(structure):
            return feature.uniform()
        found = incoming.once(_registered, structure, state, incoming[feature])
        return PointMessage(
            GaussianMessage.from_moments(structure.identities, found.means, found.covariances)
        )

    def update(self, state: StructureState, incoming: Incoming) -> StructureState:
        """Return camera and points updated with the frame's points."""
        others = incoming[PointTracks]
        seen, structure = _seen(state, others), state.structure
        if structure is not None:
            found = incoming.once(_registered, structure, state, others)
            variance = found.motion.camera_covariance.diagonal()[:3].mean()
            if len(seen) < LEAST_SEEN or not variance > (LOST * structure.extent) ** 2:
                structure = updated(structure, found, state.elapsed, state.time)
                structure = self._remembered(add_points(structure, seen))
                return replace(state, elapsed=0.0, structure=structure)
        window = state.window.lengthened(seen, state.time, self.max_points)
        structure = None
        if window is not state.window and window.due:
            try:
                structure = first_structure(window)
            except ValueError:  # frames share too few points: another scene has begun
                window = Window.empty()
        window = window if structure is None else Window.empty()
        return StructureState(state.time, 0.0, window, structure)

    def _remembered(self, structure: Structure) -> Structure:
        """Without the points that were not seen for too long."""
        latest = np.argsort(structure.unseen, kind="stable")[: self.max_points]
        latest = latest[structure.unseen[latest] <= self.max_coast_time]
        return structure if len(latest) == len(structure) else structure.only(np.sort(latest))


def _seen(state: StructureState, others: PointMessage) -> ObservedPoints:
    """The points that the frame shows: where they were found, as sure as the message is of them.

    Not where the tracker expects them: that comes from frames that the shape has been fitted to as well.
    """
    identities, positions, covariances = others.positions.moments
    variances = 0.5 * np.trace(covariances, axis1=1, axis2=2)
    if others.view is None:
        return ObservedPoints(identities, positions, variances)
    found = others.view.points
    if state.time - others.view.time > 0.5 * state.elapsed:  # a tracker's view of an earlier frame
        found = NO_POINTS
    both, here, there = common(identities, found.identities)
    whole = ~np.isnan(found.positions[there]).any(axis=1)
    both, here, there = both[whole], here[whole], there[whole]
    return ObservedPoints(both, found.positions[there], variances[here])


def _registered(structure: Structure, state: StructureState, others: PointMessage) -> Registration:
    return register(structure, _seen(state, others))

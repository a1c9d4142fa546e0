"""A rigid shape before a moving affine camera, estimated recursively from the points of each frame.

RSMCM eq. (18) to (20) as a filter: position of point i = M (S_i, 1) + noise, the shape S constant, the rows
of M moving by eq. (19). Points and camera are kept apart, each with its own covariance, and updated in turn.
Covariances stay consistent because a point learns from the camera that the *other* points of the frame show,
whose errors are not its own: camera and point are taken for independent, and so they are but for what they
have from earlier frames.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.sfm.factor_analysis.em import homogeneous
from ...models.core.short_repr import short_repr
from ...models.numerics.densities import squared_distances
from . import camera_motion
from .camera_motion import CameraMotion

Numbers = NDArray[np.float64]
Identities = NDArray[np.int64]
Mask = NDArray[np.bool_]

GATE = 9.21
"""Squared Mahalanobis distance of a position (two numbers) that one inlier in a hundred exceeds."""

MEDIAN = 2 * np.log(2)
"""Of squared Mahalanobis distances of positions."""

REGISTRATIONS = 5
"""Rounds in which the camera and the choice of inliers settle, at most."""

PRIOR_DEVIATION = 3.0
"""Standard deviation of a new point's place, in units of the first shape's spread."""

MOTION_FRAMES = 48
"""Last frames from which the noise of the camera's motion is learned."""

LEARNING_RATE = 0.05
"""Share by which a frame with many points changes what is known of the noise of positions: of a frame and not
of a second, since each frame is one more sample of that noise."""

LEAST_SCALE = 1e-4
"""Of that scale: a hundredth of the standard deviation that is stated."""

MOST_CORRELATION = 0.9
"""Of a point's errors from one frame to the next; then 19 observations are worth one."""

MANY = 10
"""Points of a frame from which on it counts as one with many."""

OUTLIER_TIME = 0.2
"""s in which the covariance of a point grows by e while it is an outlier."""


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """Points of a frame.

    Parameters
    ----------
    identities
        `(k,)` int64, increasing.
    positions
        `(k, 2)` px.
    variances
        `(k,)` px^2, of u and of v, as stated.
    """

    identities: Identities
    positions: Numbers
    variances: Numbers

    def __len__(self) -> int:
        return len(self.identities)


@short_repr
@dataclass(frozen=True, eq=False)
class CameraEvidence:
    """What the last frames said of the camera, in information form.

    Parameters
    ----------
    information, vector
        `(n, 4, 4)` and `(n, 2, 4)`, as `camera_motion.update` takes them.
    times
        `(n,)` s.
    """

    information: Numbers
    vector: Numbers
    times: Numbers


@short_repr
@dataclass(frozen=True, eq=False)
class Structure:
    """Shape and camera; they are determined up to an affine change of both.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    shape, shape_covariance
        `(n, 3)` and `(n, 3, 3)`, in units of the first shape's spread.
    unseen
        `(n,)` s since a point was last an inlier.
    motion
        of the camera.
    evidence
        of the camera in the last frames.
    extent
        px, about how large the shape appeared at first.
    noise_scale
        how much larger the variances of positions are than stated.
    innovations
        `(n, 2)` px: position less prediction of each point when it was last an inlier.
    autocorrelation
        of innovations, from one frame to the next.
    wander
        px^2/s, in u and in v: how fast what a point is off by changes (see `offsets`).
    """

    identities: Identities
    shape: Numbers
    shape_covariance: Numbers
    unseen: Numbers
    motion: CameraMotion
    evidence: CameraEvidence
    extent: float
    noise_scale: float
    innovations: Numbers
    autocorrelation: float
    wander: float

    @property
    def offsets(self) -> Numbers:
        """`(n, 2)` px: what each point is taken to be off by, since what it was off by lasts.

        The camera is not quite affine, the thing not quite rigid, and a tracker's patch drifts: where it was,
        it is found again. With e = a + white noise and autocorrelation rho, the mean of a given e is rho e,
        and its variance rho (1 - rho) that of e. By so much it is taken to grow in every further frame.
        """
        return self.autocorrelation * self.innovations

    def __len__(self) -> int:
        return len(self.identities)

    def only(self, kept: NDArray[np.intp]) -> "Structure":
        """Some of the points, by place."""
        return replace(
            self,
            identities=self.identities[kept],
            shape=self.shape[kept],
            shape_covariance=self.shape_covariance[kept],
            unseen=self.unseen[kept],
            innovations=self.innovations[kept],
        )


@dataclass(frozen=True, eq=False)
class Registration:
    """A frame's camera, as all points show it and as all but one do.

    Parameters
    ----------
    motion
        updated with the frame.
    information, vector
        of the camera from the frame, as `camera_motion.update` takes them.
    cameras, leverages
        `(n, 2, 4)` and `(n,)`: for every known point the camera that the others show, and the variance (px^2,
        in u and in v) that its uncertainty gives the point's position.
    means, covariances
        `(n, 2)` px and `(n, 2, 2)` px^2: where the point should be therefore, but for noise of one frame.
    places
        `(k,)` of the seen points among the known ones.
    positions, variances
        `(k, 2)` px and `(k,)` px^2: where they were seen, and the noise of that.
    inliers
        `(k,)` bool: not too far from where they should be.
    """

    motion: CameraMotion
    information: Numbers
    vector: Numbers
    cameras: Numbers
    leverages: Numbers
    means: Numbers
    covariances: Numbers
    places: NDArray[np.intp]
    positions: Numbers
    variances: Numbers
    inliers: Mask


def register(structure: Structure, seen: ObservedPoints) -> Registration:
    """The camera that fits a frame's points but for outliers.

    For each point also the camera without it (leave-one-out): its part of the information is taken out again.
    """
    known = np.isin(seen.identities, structure.identities)
    places = np.searchsorted(structure.identities, seen.identities[known])
    positions, variances = seen.positions[known], structure.noise_scale * seen.variances[known]
    before, all_points, spreads = structure.motion, homogeneous(structure.shape), structure.shape_covariance
    points = all_points[places]
    of_shape = _seen_through(before.camera[None, :, :3], spreads[places])
    of_both = _joint(before, spreads[places])
    # The rows of the camera share one covariance, so to them noise is the same in all directions.
    noise = variances + np.trace(of_shape, axis1=1, axis2=2) + of_both

    def distances(motion: CameraMotion, used: Mask) -> Numbers:
        """Squared Mahalanobis distances of points from where the used ones, without them, say that they
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
        before = camera_motion.shaken(before, float(np.median(off)))
        inliers = distances(before, np.zeros(len(points), bool)) <= GATE
    for _ in range(REGISTRATIONS):
        information, vector = camera_information(points, positions, np.where(inliers, 1 / noise, 0.0))
        motion = camera_motion.update(before, information, vector)
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


def updated(structure: Structure, found: Registration, elapsed: float, time: float) -> Structure:
    """The structure updated with a frame that it is registered with, `elapsed` s after the last one.

    Outliers become uncertain, so that they are believed at last.
    """
    shape, covariance = structure.shape.copy(), structure.shape_covariance.copy()
    unseen = structure.unseen.copy()
    inliers, outliers = found.places[found.inliers], found.places[~found.inliers]
    noise = correlation_time(structure.autocorrelation) * found.variances[found.inliers]
    noise += found.leverages[inliers]
    shape[inliers], covariance[inliers] = intersect(
        shape[inliers], covariance[inliers], found.cameras[inliers], found.positions[found.inliers], noise
    )
    covariance[outliers] *= np.exp(elapsed / OUTLIER_TIME)
    unseen[inliers] = 0.0
    if len(found.places):
        structure = _with_learned_noise(structure, found, elapsed, time)
    return replace(structure, shape=shape, shape_covariance=covariance, unseen=unseen)


def add_points(structure: Structure, seen: ObservedPoints) -> Structure:
    """The structure with the points that are new in a frame, whose camera is known.

    What is known of them after one frame is where they are across the view, and of the rest that they belong
    to the shape.
    """
    new = ~np.isin(seen.identities, structure.identities)
    count, motion = int(new.sum()), structure.motion
    if not count:
        return structure
    shape, covariance = np.zeros((count, 3)), np.tile(PRIOR_DEVIATION**2 * np.eye(3), (count, 1, 1))
    noise = structure.noise_scale * seen.variances[new] + _joint(motion, covariance)
    noise += _leverage(motion, homogeneous(shape))
    cameras = np.tile(motion.camera, (count, 1, 1))
    shape, covariance = intersect(shape, covariance, cameras, seen.positions[new], noise)
    together = replace(
        structure,
        identities=np.concatenate([structure.identities, seen.identities[new]]),
        shape=np.concatenate([structure.shape, shape]),
        shape_covariance=np.concatenate([structure.shape_covariance, covariance]),
        unseen=np.concatenate([structure.unseen, np.zeros(count)]),
        innovations=np.concatenate([structure.innovations, np.zeros((count, 2))]),
    )
    return together.only(np.argsort(together.identities))


def intersect(
    shape: Numbers, covariance: Numbers, cameras: Numbers, positions: Numbers, noise: Numbers
) -> tuple[Numbers, Numbers]:
    """Points after each was seen by a camera of its own (Kalman update in Joseph's form).

    Parameters
    ----------
    shape, covariance
        `(k, 3)` and `(k, 3, 3)`.
    cameras
        `(k, 2, 4)`.
    positions, noise
        `(k, 2)` px and `(k,)` px^2, of u and of v.
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
    """Frames whose observations of a point are worth one: what tracks are off by lasts for a while.

    The integrated autocorrelation time of a first-order Gauss-Markov process.
    """
    correlation = min(max(autocorrelation, 0.0), MOST_CORRELATION)
    return (1 + correlation) / (1 - correlation)


def wandering(autocorrelation: float, variances: Numbers, elapsed: float) -> float:
    """`Structure.wander` where errors have these variances, `elapsed` s after each other."""
    return autocorrelation * (1 - autocorrelation) * float(np.median(variances)) / elapsed


def camera_information(points: Numbers, positions: Numbers, precisions: Numbers) -> tuple[Numbers, Numbers]:
    """Information `(4, 4)` and vector `(2, 4)` of a camera from observed points `(k, 4)`, with a 1 last."""
    weighted = points.T * precisions
    return weighted @ points, (weighted @ positions).T


def isotropic(variances: Numbers) -> Numbers:
    """`(n, 2, 2)` covariances, the same in all directions."""
    return variances[:, None, None] * np.eye(2)


def _leverage(motion: CameraMotion, points: Numbers) -> Numbers:
    """px^2 by which the camera's uncertainty moves points `(n, 4)`, in u and in v."""
    moved: Numbers = ((points @ motion.camera_covariance) * points).sum(axis=1)
    return moved


def _seen_through(linear: Numbers, spreads: Numbers) -> Numbers:
    """`(n, 2, 2)` px^2: covariances of points `(n, 3, 3)` as they show in the picture."""
    return linear @ spreads @ linear.swapaxes(-1, -2)


def _joint(motion: CameraMotion, spreads: Numbers) -> Numbers:
    """px^2, in u and in v, of the product of both errors, the camera's and the point's."""
    moved: Numbers = (motion.camera_covariance[:3, :3] * spreads).sum(axis=(1, 2))
    return moved


def _with_learned_noise(structure: Structure, found: Registration, elapsed: float, time: float) -> Structure:
    """With what a frame says of the noise of positions and of the camera's motion."""
    places, count = found.places, len(found.places)
    off = found.positions - found.means[places] + structure.offsets[places]
    total = found.covariances[places] + isotropic(
        found.variances - structure.wander * structure.unseen[places]
    )
    trust = 2 * found.variances / np.trace(total, axis1=1, axis2=2)  # else points are off by their own error
    rate = LEARNING_RATE * count / (count + MANY)
    # A Newton step towards the scale at which half of the points are farther off than the median should be:
    # those that are far off for another reason count as little as can be.
    far = squared_distances(off, total) > MEDIAN
    step = float((trust * (far - 0.5)).sum() / trust.sum()) / (0.25 * MEDIAN)
    scale = max(structure.noise_scale * float(np.exp(rate * step)), LEAST_SCALE)

    innovations = structure.innovations.copy()
    again = found.inliers & (structure.unseen[places] <= 1.01 * elapsed)
    before, now = innovations[places[again]], off[again]
    products = float((trust[again] * (before * now).sum(axis=1)).sum())
    squares = float((trust[again] * 0.5 * (before**2 + now**2).sum(axis=1)).sum())
    correlation = products / squares if squares > 0 else structure.autocorrelation
    autocorrelation = max(0.0, structure.autocorrelation + rate * (correlation - structure.autocorrelation))
    innovations[places[found.inliers]] = off[found.inliers]

    evidence = CameraEvidence(
        np.concatenate([structure.evidence.information, found.information[None]])[-MOTION_FRAMES:],
        np.concatenate([structure.evidence.vector, found.vector[None]])[-MOTION_FRAMES:],
        np.append(structure.evidence.times, time)[-MOTION_FRAMES:],
    )
    noise = structure.motion.noise
    if len(evidence.times) > 1:
        noise = camera_motion.learned_noise(
            noise, evidence.information, evidence.vector, evidence.times, structure.extent
        )
    return replace(
        structure,
        noise_scale=scale,
        evidence=evidence,
        motion=replace(found.motion, noise=noise),
        innovations=innovations,
        autocorrelation=autocorrelation,
        wander=wandering(autocorrelation, found.variances, elapsed),
    )

"""A rigid shape before a moving affine camera, met with the points of one frame after the other.

RSMCM eq. (18) to (20) as a filter: position of point i = M (S_i, 1) + noise, the shape S constant, the rows
of M moving by eq. (19). Points and camera are kept apart, each with its own covariance, and updated in turn.
What keeps that honest is that a point learns from the camera that the *other* points of the frame show, whose
errors are not its own: camera and point are taken for independent, and so they are but for what they have
from earlier frames.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from . import camera_motion
from .camera_motion import CameraMotion

Numbers = NDArray[np.float64]
Identities = NDArray[np.int64]
Mask = NDArray[np.bool_]

GATE = 9.21
"""Squared Mahalanobis distance of a position (two numbers) that one good look in a hundred exceeds."""

MEDIAN = 2 * np.log(2)
"""Of squared Mahalanobis distances of positions."""

REGISTRATIONS = 5
"""Rounds in which the camera and the choice of good looks settle, at most."""

OUTSIDE = 3.0
"""Standard deviation of a new point's place, in units of the first shape's spread."""

LOOKS = 48
"""Frames from which the noise of the camera's motion is learned."""

LEARNING = 0.05
"""Share by which a frame with many points changes the scale of the noise of positions."""

LEAST_SCALE = 1e-4
"""Of that scale: a hundredth of the standard deviation that is stated."""

MOST_PERSISTENCE = 0.9
"""Correlation of a point's errors from one frame to the next, at most; then 19 looks are worth one."""

MANY = 10
"""Points of a frame from which on it counts as one with many."""

FADING = 0.2
"""s in which the covariance of a point grows by e while it is seen elsewhere than it should be."""


@dataclass(frozen=True, eq=False)
class Seen:
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
class Looks:
    """What the last frames said of the camera.

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
        `(n,)` s since a point was last seen where it should be.
    motion
        of the camera.
    looks
        at the camera in the last frames.
    extent
        px, about how large the shape looked at first.
    noise_scale
        how much larger the variances of positions are than stated.
    surprises
        `(n, 2)` px, by how far a point was off where it should be, when it was last seen there.
    persistence
        correlation of surprises from one frame to the next.
    """

    identities: Identities
    shape: Numbers
    shape_covariance: Numbers
    unseen: Numbers
    motion: CameraMotion
    looks: Looks
    extent: float
    noise_scale: float
    surprises: Numbers
    persistence: float

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
            surprises=self.surprises[kept],
        )


@dataclass(frozen=True, eq=False)
class Registration:
    """A frame's camera, as all points show it and as all but one do.

    Parameters
    ----------
    motion
        after the look.
    information, vector
        of the look, as `camera_motion.update` takes them.
    cameras, leverages
        `(n, 2, 4)` and `(n,)`: for every known point the camera that the others show, and the variance (px^2,
        in u and in v) that its uncertainty gives the point's position.
    means, covariances
        `(n, 2)` px and `(n, 2, 2)` px^2: where the point should be therefore, but for noise.
    places
        `(k,)` of the seen points among the known ones.
    positions, variances
        `(k, 2)` px and `(k,)` px^2: where they were seen, and the noise of that.
    good
        `(k,)`: not too far from where they should be.
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
    good: Mask


def register(structure: Structure, seen: Seen) -> Registration:
    """The camera that fits a frame's points but for those that are too far off.

    For each point also the camera without it: its part of the information is taken out again.
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
        return _squares(off, covariances)

    off = ((positions - points @ before.camera.T) ** 2).sum(axis=1)
    good = distances(before, np.zeros(len(points), bool)) <= GATE
    if 2 * good.sum() < len(good):
        # A jerk: of the camera next to nothing is known from before, by as much as the points are off.
        before = camera_motion.shaken(before, float(np.median(off)))
        good = distances(before, np.zeros(len(points), bool)) <= GATE
    for _ in range(REGISTRATIONS):
        information, vector = look(points, positions, np.where(good, 1 / noise, 0.0))
        motion = camera_motion.update(before, information, vector)
        settled, good = good, distances(motion, good) <= GATE
        if np.array_equal(good, settled):
            break
    good = settled

    cameras, leverages = np.tile(motion.camera, (len(structure), 1, 1)), _leverage(motion, all_points)
    used, others = places[good], noise[good] - leverages[places[good]]
    off = positions[good] - points[good] @ motion.camera.T
    pull = points[good] @ motion.camera_covariance / others[:, None]
    cameras[used] -= off[:, :, None] * pull[:, None, :]
    leverages[used] *= noise[good] / others
    leverages += _joint(motion, spreads)
    return Registration(
        motion=motion,
        information=information,
        vector=vector,
        cameras=cameras,
        leverages=leverages,
        means=(cameras @ all_points[:, :, None])[:, :, 0],
        covariances=_seen_through(cameras[:, :, :3], spreads) + isotropic(leverages),
        places=places,
        positions=positions,
        variances=variances,
        good=good,
    )


def take_in(structure: Structure, found: Registration, elapsed: float, time: float) -> Structure:
    """The structure after a frame with which it has been registered, `elapsed` s after the last one.

    Points that are seen elsewhere than they should be become uncertain, so that they are believed at last.
    """
    shape, covariance = structure.shape.copy(), structure.shape_covariance.copy()
    unseen = structure.unseen.copy()
    good, bad = found.places[found.good], found.places[~found.good]
    shape[good], covariance[good] = intersect(
        shape[good],
        covariance[good],
        found.cameras[good],
        found.positions[found.good],
        repeats(structure.persistence) * found.variances[found.good] + found.leverages[good],
    )
    covariance[bad] *= np.exp(elapsed / FADING)
    unseen[good] = 0.0
    if len(found.places):
        structure = _with_learned_noise(structure, found, elapsed, time)
    return replace(structure, shape=shape, shape_covariance=covariance, unseen=unseen)


def join(structure: Structure, seen: Seen) -> Structure:
    """The structure with the points that are new in a frame, whose camera is known.

    What is known of them after one look is where they are across the view, and of the rest that they belong
    to the shape.
    """
    new = ~np.isin(seen.identities, structure.identities)
    count, motion = int(new.sum()), structure.motion
    if not count:
        return structure
    shape, covariance = np.zeros((count, 3)), np.tile(OUTSIDE**2 * np.eye(3), (count, 1, 1))
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
        surprises=np.concatenate([structure.surprises, np.zeros((count, 2))]),
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


def repeats(persistence: float) -> float:
    """How many looks at what stays are worth one, because what tracks are off by lasts for a while."""
    correlation = min(max(persistence, 0.0), MOST_PERSISTENCE)
    return (1 + correlation) / (1 - correlation)


def look(points: Numbers, positions: Numbers, precisions: Numbers) -> tuple[Numbers, Numbers]:
    """What seen points, `(k, 4)` with a 1 last, say of a camera: information `(4, 4)` and vector `(2, 4)`."""
    weighted = points.T * precisions
    return weighted @ points, (weighted @ positions).T


def homogeneous(shape: Numbers) -> Numbers:
    """`(n, 4)`: points with a 1 behind."""
    return np.concatenate([shape, np.ones((len(shape), 1))], axis=1)


def isotropic(variances: Numbers) -> Numbers:
    """`(n, 2, 2)` covariances, the same in all directions."""
    return variances[:, None, None] * np.eye(2)


def _squares(off: Numbers, covariances: Numbers) -> Numbers:
    """Squared Mahalanobis distances of `(n, 2)`."""
    squares: Numbers = (off * np.linalg.solve(covariances, off[:, :, None])[:, :, 0]).sum(axis=1)
    return squares


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
    off = found.positions - found.means[places]
    total = found.covariances[places] + isotropic(found.variances)
    trust = 2 * found.variances / np.trace(total, axis1=1, axis2=2)  # else points are off by their own error
    rate = LEARNING * count / (count + MANY)
    # A Newton step towards the scale at which half of the points are farther off than the median should be:
    # those that are far off for another reason count as little as can be.
    far = _squares(off, total) > MEDIAN
    step = float((trust * (far - 0.5)).sum() / trust.sum()) / (0.25 * MEDIAN)
    scale = max(structure.noise_scale * float(np.exp(rate * step)), LEAST_SCALE)

    surprises = structure.surprises.copy()
    again = found.good & (structure.unseen[places] <= 1.01 * elapsed)
    before, now = surprises[places[again]], off[again]
    products = float((trust[again] * (before * now).sum(axis=1)).sum())
    squares = float((trust[again] * 0.5 * (before**2 + now**2).sum(axis=1)).sum())
    correlation = products / squares if squares > 0 else structure.persistence
    persistence = max(0.0, structure.persistence + rate * (correlation - structure.persistence))
    surprises[places[found.good]] = off[found.good]

    looks = Looks(
        np.concatenate([structure.looks.information, found.information[None]])[-LOOKS:],
        np.concatenate([structure.looks.vector, found.vector[None]])[-LOOKS:],
        np.append(structure.looks.times, time)[-LOOKS:],
    )
    noise = structure.motion.noise
    if len(looks.times) > 1:
        noise = camera_motion.learned_noise(
            noise, looks.information, looks.vector, looks.times, structure.extent
        )
    return replace(
        structure,
        noise_scale=scale,
        looks=looks,
        motion=replace(found.motion, noise=noise),
        surprises=surprises,
        persistence=persistence,
    )

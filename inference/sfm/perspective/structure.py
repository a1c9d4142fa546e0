"""Shape and perspective cameras from point tracks with gaps, and whether they explain them best.

Affine cameras under the same noise are what they are compared with, and one of the starts of the search.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from ....models.camera.perspective_camera import MIRROR, PerspectiveCameras
from ....models.core.short_repr import short_repr
from ..affine_camera import Euclidean, euclidean
from ..factor_analysis.factorisation import projected
from ..factor_analysis.observations import Listed, Numbers, Observations, determined
from ..factor_analysis.variable_projection import NEAR, variable_projection
from .bundle_adjustment import (
    Bundle,
    BundleCovariance,
    about,
    adjust,
    covariance_of,
    freedom,
    predicted,
    retriangulated,
)
from .growth import grown
from .student_noise import StudentNoise

Mask = NDArray[np.bool_]

FIT_ROUNDS = 15
FIT_SETTLED = 1e-3
"""Nats an observation: a round that gains less is the last."""
PRECISION, MOST_STEPS = 1e-3, 20
"""Of the least squares of a round: the next one has other weights."""


@dataclass(frozen=True, eq=False)
class AffineFit:
    """Cameras and shape under Student's noise.

    Parameters
    ----------
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`, in px.
    frames, points
        `(n_frames,)` and `(n_points,)` bool: which the observations determine; others are not fitted.
    weights
        `(n_frames, n_points)`: as given, less what makes an observation an outlier.
    noise
        px^2 at weight 1.
    log_likelihood
        of the observations of those frames and points, nats.
    """

    cameras: Numbers
    shape: Numbers
    frames: NDArray[np.bool_]
    points: NDArray[np.bool_]
    weights: Numbers
    noise: StudentNoise
    log_likelihood: float


def affine_fit(positions: ArrayLike, weights: ArrayLike, cameras: Numbers, shape: Numbers) -> AffineFit:
    """Make observations likelier, by weighted least squares whose weights follow from the round before.

    Parameters
    ----------
    positions, weights
        as of `factorise`.
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`, the start.

    Raises
    ------
    ValueError
        as `factorise` does, but frames may fall into sets that share no points.
    """
    where, given = np.asarray(positions, np.float64), np.asarray(weights, np.float64)
    frames, points = determined(Observations.from_arrays(where, given), apart=True)
    seen = (given > 0) & frames[:, None] & points
    best: AffineFit | None = None
    counted = given
    for _ in range(FIT_ROUNDS):
        squares = np.sum((where - projected(cameras, shape)) ** 2, axis=2)[seen]
        noise = StudentNoise.of_errors(squares, given[seen])
        likelihood = noise.log_likelihood(squares, given[seen])
        before = -np.inf if best is None else best.log_likelihood
        counted = given.copy()
        counted[seen] = noise.weights(squares, given[seen])
        if likelihood > before:
            best = AffineFit(cameras, shape, frames, points, counted, noise, likelihood)
        if likelihood < before + FIT_SETTLED * len(squares):
            break
        cameras, shape = _refitted(where, np.where(seen, counted, 0), cameras)
    assert best is not None
    return best


def _refitted(positions: Numbers, weights: Numbers, cameras: Numbers) -> tuple[Numbers, Numbers]:
    observations = Observations.from_arrays(positions, weights)
    found = variable_projection(
        observations,
        observations.scaled(cameras),
        damping=NEAR,
        tolerance=PRECISION,
        most_steps=MOST_STEPS,
    )
    moved = found.cameras * observations.scale
    moved[..., 3] += observations.centre
    return moved, found.shape


Start = tuple[PerspectiveCameras, Numbers]

FOCAL_STARTS = (0.8, 1.5, 3.0)
"""Focal lengths to grow with, in widths of the picture: from 64 degrees wide, as of phones, to 19."""
AFFINE_STARTS = (1.0, 2.0)
"""And those for an affine structure, which is quicker to have but may need them for either mirror image."""

TRIAL_STEPS = 15
"""Steps of bundle adjustment in each of two rounds after which starts are compared."""
FINALISTS = 2
"""Starts that go on after that."""
MOST_ROUNDS = 6
"""Of bundle adjustment and new points, at the end."""
SETTLED = 3.0
"""Nats: a round that gains less is the last. It is the evidence of no more than one number in a film."""


def affine_starts(
    metric: Euclidean, principal: Numbers, width: float, focal: float | None
) -> Iterable[Start]:
    """Starts from an affine structure: the shape and its mirror image.

    Parameters
    ----------
    metric
        the affine structure in a space with right angles.
    principal
        `(2,)` px.
    width
        px, the longer edge of the picture.
    focal
        px; `None` where it is unknown. Then scaled orthography is a start as well, from which the first step
        finds out which of the two it is.
    """
    shifts = metric.cameras[..., 3] - principal
    focals = [focal] if focal is not None else [factor * width for factor in AFFINE_STARTS]
    curvatures = [sign / each for each in focals for sign in (1, -1)]
    for curvature in curvatures if focal is not None else [0.0, *curvatures]:
        start = PerspectiveCameras(metric.rotations, metric.scales, shifts, curvature, principal)
        yield (start, metric.shape) if curvature >= 0 else (start.mirrored(), metric.shape @ MIRROR)


def grown_starts(places: Numbers, principal: Numbers, width: float, focal: float | None) -> Iterable[Start]:
    """Starts that grow from two views, which need no affine structure and take any depth.

    Parameters
    ----------
    places
        `(n_frames, n_points, 2)` px, NaN where nothing was seen.
    principal, width, focal
        as of `affine_starts`.
    """
    focals = [focal] if focal is not None else [factor * width for factor in FOCAL_STARTS]
    tried = [grown(places - principal, each, focal_known=focal is not None) for each in focals]
    found = [each for each in tried if each is not None]
    most = max((np.count_nonzero(known) for _, _, known in found), default=0)
    for cameras, shape, known in found:
        if np.count_nonzero(known) == most:  # where it has come to a halt all further cameras are wrong
            yield replace(cameras, principal=principal), shape


def best_bundle(listed: Listed, starts: Iterable[Start], *, focal_known: bool) -> Bundle | None:
    """Bundle adjustment from the start that gets farthest; `None` where there is none.

    Of an unknown focal length the sign is free, too: a negative one is that of the mirrored shape.
    """
    trials = [_tried(listed, start, focal_known) for start in starts]
    if not trials:
        return None
    trials.sort(key=lambda each: -each.log_likelihood)
    ends = [_settled(listed, trial, focal_known) for trial in trials[:FINALISTS]]
    return max(ends, key=lambda each: each.log_likelihood)


def _tried(listed: Listed, start: Start, focal_known: bool) -> Bundle:
    found = _round(listed, start, focal_known, TRIAL_STEPS)
    return _round(listed, (found.cameras, found.shape), focal_known, TRIAL_STEPS)


def _settled(listed: Listed, found: Bundle, focal_known: bool) -> Bundle:
    for _ in range(MOST_ROUNDS):
        before = found.log_likelihood
        found = _round(listed, (found.cameras, found.shape), focal_known)
        if found.log_likelihood < before + SETTLED:
            break
    return found


def _round(listed: Listed, start: Start, focal_known: bool, most_steps: int = 100) -> Bundle:
    """Bundle adjustment and new points, before cameras of a focal length that is not negative."""
    found = adjust(listed, *start, focal_known=focal_known, most_steps=most_steps)
    if found.cameras.curvature < 0:
        found = replace(found, cameras=found.cameras.mirrored(), shape=found.shape @ MIRROR)
    return replace(found, shape=retriangulated(listed, found))


@dataclass(frozen=True)
class Lens:
    """What is known of the camera of a film.

    Parameters
    ----------
    size
        `(height, width)` px of the picture; the principal point is its middle.
    focal
        focal length, px; `None` where it is not known.
    """

    size: tuple[int, int]
    focal: float | None = None

    @property
    def principal(self) -> Numbers:
        """`(2,)` px, the middle of the picture."""
        return np.array([self.size[1] - 1, self.size[0] - 1]) / 2


@short_repr
@dataclass(frozen=True, eq=False)
class PerspectiveStructure:
    """Cameras and shape, up to a similarity.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    cameras
        of all frames; of those that are not determined, between those before and after.
    shape
        `(n_points, 3)`, axes as in the first view (x right, y down, z away), in px at the mean scale of the
        cameras.
    shape_covariance
        `(n_points, 3, 3)`.
    positions, covariances
        `(n_frames, n_points, 2)` px and `(n_frames, n_points, 2, 2)` px^2 of all points in all frames, seen
        or not, without the noise of observations.
    frame_determined
        `(n_frames,)` bool: the frame shows four points or more.
    noise
        of observations of weight 1.
    log_likelihood
        of all observations, nats.
    parameters
        how many numbers are fitted to them.
    observations
        numbers observed.
    curvature_deviation
        1/px, standard deviation of 1 / focal length; 0 where that was given.
    """

    size: tuple[int, int]
    cameras: PerspectiveCameras
    shape: Numbers
    shape_covariance: Numbers
    positions: Numbers
    covariances: Numbers
    frame_determined: Mask
    noise: StudentNoise
    log_likelihood: float
    parameters: int
    observations: int
    curvature_deviation: float

    @property
    def focal_deviation(self) -> float:
        """Standard deviation of the focal length, px, to first order; infinite where it is not known."""
        if self.curvature_deviation == 0:
            return 0.0
        return self.curvature_deviation * self.cameras.focal**2 if self.focal_determined else np.inf

    @property
    def focal_determined(self) -> bool:
        """Whether the focal length is known to be finite, by Schwarz's criterion for its one number."""
        if self.curvature_deviation == 0:
            return True
        return (self.cameras.curvature / self.curvature_deviation) ** 2 > math.log(self.observations)

    def agrees(self, positions: Numbers, weights: Numbers) -> Mask:
        """Whether there is an observation `(n_frames, n_points)`, and no outlier.

        Arguments as of `perspective_structure`.
        """
        squares = np.sum((positions - self.positions) ** 2, axis=2)
        agreeing: Mask = (weights > 0) & self.noise.agrees(np.where(weights > 0, squares, 0), weights)
        return agreeing

    def of_points(self, points: Mask) -> Self:
        """The same with some points only."""
        return replace(
            self,
            shape=self.shape[points],
            shape_covariance=self.shape_covariance[points],
            positions=self.positions[:, points],
            covariances=self.covariances[:, points],
        )

    def better_than(self, affine: AffineFit) -> bool:
        """Whether it explains the positions better than affine cameras do, by Schwarz's criterion (BIC).

        An affine camera has 8 numbers, and 12 of a film's are the choice of the shape's axes; a perspective
        one has 6, all together have a focal length, and 7 are the choice of the axes. Both have the same
        points, and noise of the same kind.
        """
        n_frames, n_points = np.count_nonzero(affine.frames), np.count_nonzero(affine.points)
        more = self.parameters - (8 * n_frames + 3 * n_points - 12)
        gain = self.log_likelihood - affine.log_likelihood
        return self.focal_determined and bool(gain > 0.5 * more * math.log(self.observations))


def perspective_structure(
    positions: Numbers, weights: Numbers, affine: AffineFit, lens: Lens
) -> PerspectiveStructure | None:
    """Find cameras, focal length and shape; `None` if no start is found.

    Parameters
    ----------
    positions
        `(n_frames, n_points, 2)` px; anything where the weight is 0.
    weights
        `(n_frames, n_points)`, 1 / relative variance, 0 where nothing was seen. Each point is seen somewhere.
    affine
        the same with affine cameras, to begin with; those frames and points count that it determines.
    lens
        of the camera.
    """
    known, n_points = affine.frames, positions.shape[1]
    frames, points = np.nonzero(weights[known] > 0)
    x, y = positions[known][frames, points].T.copy()
    weight = weights[known][frames, points]
    by_frame = Listed.sorted_by(frames, int(known.sum()), points, x, y, weight)
    everything = about(by_frame.transposed(n_points), lens.principal)
    listed = everything.only(affine.points, np.ones(int(known.sum()), bool))
    metric = euclidean(affine.cameras[known], affine.shape)
    fixed = lens.focal is not None
    about_lens = lens.principal, float(max(lens.size)), lens.focal
    places = np.where((weights[known] > 0)[..., None] & affine.points[:, None], positions[known], np.nan)
    starts = [
        *(affine_starts(metric, *about_lens) if metric.determined else ()),
        *grown_starts(places, *about_lens),
    ]
    found = best_bundle(listed, starts, focal_known=fixed)
    if found is None:
        return None
    # a point of one frame has a direction, and the depth of all others
    found = _upright(found, affine.points)
    found = replace(found, shape=retriangulated(everything, found))
    spread = np.cov(found.shape[affine.points].T)
    covariance = covariance_of(everything, found, spread, focal_known=fixed)
    cameras, places, covariances = _in_all_frames(found, covariance, known)
    return PerspectiveStructure(
        size=lens.size,
        cameras=cameras,
        shape=found.shape,
        shape_covariance=covariance.points,
        positions=places,
        covariances=covariances,
        frame_determined=known,
        noise=found.noise,
        log_likelihood=found.log_likelihood,
        parameters=freedom(listed, focal_known=fixed),
        observations=2 * len(listed.x),
        curvature_deviation=covariance.curvature_deviation,
    )


def _upright(found: Bundle, points: Mask) -> Bundle:
    """The same in the axes of the first view, about the middle of some points, in px at the mean scale."""
    cameras = found.cameras
    turn, middle = cameras.rotations[0], np.median(found.shape[points], axis=0)
    # what a camera sees of the new origin is its new depth and shift
    moved = cameras.rotations @ middle * cameras.scales[:, None]
    depths = 1 + cameras.curvature * moved[:, 2]
    scales = cameras.scales / depths
    size = float(np.exp(np.mean(np.log(scales))))
    cameras = replace(
        cameras,
        rotations=cameras.rotations @ turn.T,
        scales=scales / size,
        shifts=(moved[:, :2] + cameras.shifts) / depths[:, None],
    )
    return replace(
        found, cameras=cameras, shape=size * np.where(points[:, None], found.shape - middle, 0) @ turn.T
    )


def _in_all_frames(
    found: Bundle, covariance: BundleCovariance, known: Mask
) -> tuple[PerspectiveCameras, Numbers, Numbers]:
    """Cameras of all frames, positions of all points in them, and how uncertain these are.

    Where a frame shows too little its camera lies between those before and after, and positions are as
    uncertain as the way between those is long.
    """
    positions, covariances = predicted(found, covariance)
    if known.all():
        return found.cameras, positions, covariances
    times, wanted = np.flatnonzero(known), np.arange(len(known))
    inside = np.clip(wanted, times[0], times[-1])
    cameras = replace(
        found.cameras,
        rotations=Slerp(times, Rotation.from_matrix(found.cameras.rotations))(inside).as_matrix(),
        scales=np.exp(np.interp(wanted, times, np.log(found.cameras.scales))),
        shifts=np.stack([np.interp(wanted, times, each) for each in found.cameras.shifts.T], axis=1),
    )
    places, _ = cameras.seen(found.shape)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    way = np.sum((positions[after] - positions[after - 1]) ** 2, axis=2)
    whole = covariances[after] + way[..., None, None] * np.eye(2)
    whole[known], places[known] = covariances, positions
    return cameras, places, whole

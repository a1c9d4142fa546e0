"""Shape and perspective cameras from point tracks with gaps, and whether they explain them best."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ....models.camera.perspective_camera import PerspectiveCameras
from ....models.core.short_repr import short_repr
from ..affine_camera import euclidean
from ..factor_analysis.observations import Listed, Numbers
from .affine_fit import AffineFit
from .bundle_adjustment import Bundle, about, freedom, retriangulated
from .covariance import BundleCovariance, covariance_of, predicted
from .search import affine_starts, best_bundle, grown_starts
from .student_noise import StudentNoise

Mask = NDArray[np.bool_]


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

"""How uncertain bundle adjustment leaves cameras, focal length, points, and where points are seen."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ....models.camera.perspective_camera import PerspectiveCameras
from ..factor_analysis.observations import Listed, Numbers
from .bundle_adjustment import GAUGE, Bundle, Sums, freedom, reduced, squares_of, sums_of
from .kernels.bundle_adjustment import CAMERA
from .kernels.prediction import prediction_covariances

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

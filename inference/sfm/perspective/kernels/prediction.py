"""How uncertain positions are that cameras and points predict."""

import numpy as np

from .....models.numerics.compiled import compiled
from .bundle_adjustment import CAMERA, _jacobian


@compiled
def prediction_covariances(
    rotations, scales, shifts, curvature, shape, of_cameras, of_points, of_points_and_cameras
):
    """Covariances `(n_frames, n_points, 2, 2)` of all points in all frames, to first order.

    Parameters
    ----------
    of_cameras
        `(n_frames, 7, 7)` of each frame's camera and q.
    of_points
        `(n_points, 3, 3)`.
    of_points_and_cameras
        `(n_points, 3, 6 n_frames + 1)`.
    """
    n_frames, n_points = scales.size, shape.shape[0]
    out = np.empty((n_frames, n_points, 2, 2))
    last = CAMERA
    by_camera, by_place, by_focal = np.zeros((2, CAMERA)), np.zeros((2, 3)), np.zeros(2)
    rows, seen = np.zeros((2, CAMERA + 1)), np.zeros(2)
    for t in range(n_frames):
        for i in range(n_points):
            _jacobian(
                rotations[t], scales[t], shifts[t], curvature, shape[i], by_camera, by_place, by_focal, seen
            )
            for c in range(2):
                rows[c, :last] = by_camera[c]
                rows[c, last] = by_focal[c]
            for c in range(2):
                for e in range(c + 1):
                    total = 0.0
                    for m in range(last + 1):
                        for n in range(last + 1):
                            total += rows[c, m] * of_cameras[t, m, n] * rows[e, n]
                    for m in range(3):
                        for n in range(3):
                            total += by_place[c, m] * of_points[i, m, n] * by_place[e, n]
                        for n in range(last + 1):
                            column = CAMERA * t + n if n < last else CAMERA * n_frames
                            both = of_points_and_cameras[i, m, column]
                            total += both * (by_place[c, m] * rows[e, n] + by_place[e, m] * rows[c, n])
                    out[t, i, c, e] = out[t, i, e, c] = total
    return out

"""Rotations in space, many at once: rotation vectors, the matrices that they stand for, and the way back."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def exponential(vectors: Array) -> Array:
    """Return `(n, 3, 3)` rotations exp([w]x) about the rotation vectors `(n, 3)` rad."""
    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def logarithm(rotations: Array) -> Array:
    """Return `(n, 3)` rad: rotation vectors, shorter than or equal to pi, of the rotations `(n, 3, 3)`."""
    twice_sine = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = 0.5 * np.linalg.norm(twice_sine, axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1)
    angle = np.arctan2(sine, cosine)
    vectors: Array = 0.5 * twice_sine / np.sinc(angle / np.pi)[:, None]
    turned_round = cosine < -0.9  # the sine fades, and the axis with it
    if turned_round.any():
        vectors[turned_round] = Rotation.from_matrix(rotations[turned_round]).as_rotvec()
    return vectors


def cross_matrices(vectors: Array) -> Array:
    """Return [w]x for which [w]x p = w x p: `(..., 3, 3)` for vectors `(..., 3)`."""
    matrices = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2] = -z, y, -x
    matrices[..., 1, 0], matrices[..., 2, 0], matrices[..., 2, 1] = z, -y, x
    return matrices


def nearest_rotation(matrices: Array) -> Array:
    """Return the rotations nearest to `matrices` `(..., 3, 3)` in the Frobenius norm."""
    left, _, right = np.linalg.svd(matrices)
    sign = np.linalg.det(left @ right)
    left = left.copy()
    left[..., :, 2] *= sign[..., None]
    return np.asarray(left @ right)

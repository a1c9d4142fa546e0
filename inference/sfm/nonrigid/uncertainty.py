"""What tracks leave open of poses, weights and bases: Laplace's covariances at the end of EM."""

import numpy as np
from numpy.typing import NDArray

from ....models.face.morphable_model import MorphableModel
from ....models.face.pose import RIGID, Poses
from .em import ALIKE, basis_covariance_of_axes

Numbers = NDArray[np.float64]

POSE = 6
"""Numbers of a frame before its weights: turn (rad), logarithm of scale, translation (px)."""


def without_triangles(bases: Numbers) -> MorphableModel:
    """Points of which only places are of interest."""
    return MorphableModel(bases, np.zeros((0, 3), np.int64))


def frame_changes(bases: Numbers, poses: Poses) -> Numbers:
    """d shape / d (turn, log scale, translation, weights): `(n_frames, n_points, 3, 6 + n_modes)` px."""
    model = without_triangles(bases)
    by_morph = model.jacobian_with_depth(poses)
    growth = model.turned(poses)[..., None]
    along_weights = poses.sizes[:, None, None, None] * by_morph[..., RIGID + 1 :]
    return np.concatenate([by_morph[..., :3], growth, by_morph[..., 3:RIGID], along_weights], axis=3)


def frame_covariances(bases: Numbers, poses: Poses, seen: NDArray[np.bool_], noise: float) -> Numbers:
    """`(n_frames, 6 + n_modes, 6 + n_modes)` given the bases; weights are N(0, 1) before.

    Parameters
    ----------
    seen
        `(n_frames, n_points)`.
    noise
        px: standard deviation of a coordinate.
    """
    rows = frame_changes(bases, poses)[:, :, :2] * seen[..., None, None] / noise
    flat = rows.reshape(len(rows), -1, rows.shape[-1])
    information = flat.transpose(0, 2, 1) @ flat
    every = np.arange(information.shape[1])
    # before, a pose is known to a radian, a factor of e and its size: the turn of a line about itself, which
    # nothing shows, stays finite
    information[:, every, every] += np.where((every == 4) | (every == 5), 1 / poses.sizes[:, None] ** 2, 1.0)
    covariances: Numbers = np.linalg.inv(information).astype(np.float64)
    return covariances


def basis_covariances(
    bases: Numbers, poses: Poses, weights: Numbers, spread: Numbers, seen: NDArray[np.bool_], noise: float
) -> Numbers:
    """`(n_points, 3 n_bases, 3 n_bases)` given poses and weights, with the prior of EM.

    Parameters
    ----------
    weights, spread
        `(n_frames, n_modes)` means and `(n_frames, n_modes, n_modes)` covariances of the weights.
    """
    axes = poses.sizes[:, None, None] * poses.rotations[:, :2]
    extended = np.concatenate([np.ones((len(weights), 1)), weights], axis=1)
    second = extended[:, :, None] * extended[:, None]
    second[:, 1:, 1:] += spread
    products = np.einsum("nkl,nab->nkalb", second, axes.transpose(0, 2, 1) @ axes) / noise**2
    size = 3 * len(bases)
    information = (seen.T.astype(np.float64) @ products.reshape(len(seen), -1)).reshape(-1, size, size)
    prior = ALIKE * np.linalg.inv(basis_covariance_of_axes(bases, axes))
    covariances: Numbers = np.linalg.inv(information + np.kron(prior, np.eye(3)))
    return covariances

"""Points before a turning camera: positions with the truth that they came from."""

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


def rotation(axis: int, angle: float) -> Numbers:
    """Rotation by `angle` radians about a coordinate axis."""
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    j, k = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[j, j] = matrix[k, k] = cosine
    matrix[j, k], matrix[k, j] = -sine, sine
    return matrix


def turning(
    n_frames: int = 20, n_points: int = 15, noise: float = 0.0, degrees: float = 40.0, seed: int = 1
) -> tuple[Numbers, Numbers, Numbers]:
    """Positions `(n_frames, n_points, 2)` px, cameras `(n_frames, 2, 4)`, shape `(n_points, 3)`.

    Turned by `degrees` in all, nodding a little, zooming a little, panning.
    """
    generator = np.random.default_rng(seed)
    shape = generator.normal(size=(n_points, 3)) * [100, 70, 50]
    cameras = np.zeros((n_frames, 2, 4))
    for t, share in enumerate(np.linspace(0, 1, n_frames)):
        turned = rotation(0, 0.3 * np.sin(3 * share)) @ rotation(1, np.radians(degrees) * share)
        cameras[t, :, :3] = (1 + 0.2 * share) * turned[:2]
        cameras[t, :, 3] = 300 + 40 * share, 200 - 30 * share
    positions = np.einsum("tcj,ij->tic", cameras[..., :3], shape) + cameras[:, None, :, 3]
    return positions + noise * generator.normal(size=positions.shape), cameras, shape


def through(positions: Numbers, length: int, seed: int = 0) -> Numbers:
    """The same with each point seen through `length` frames in a row only, NaN before and after."""
    n_frames, n_points = positions.shape[:2]
    first = np.random.default_rng(seed).integers(0, n_frames - length + 1, n_points)
    times = np.arange(n_frames)[:, None]
    return np.where(((times >= first) & (times < first + length))[..., None], positions, np.nan)

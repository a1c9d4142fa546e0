"""Tracks of a bent sheet that turns and deforms, and its true shapes."""

import numpy as np
from numpy.typing import NDArray
from rsmcm.models.numerics.rotations import exponential

Numbers = NDArray[np.float64]

N_FRAMES, N_POINTS, N_BASES = 60, 20, 3
NOISE = 0.5  # px
SIZE = 50.0  # px

MIRROR = np.array([1.0, 1.0, -1.0])


def deforming(
    n_frames: int = N_FRAMES, turn: float = 0.6, noise: float = NOISE, seed: int = 0
) -> tuple[Numbers, Numbers]:
    """Tracks `(n_frames, n_points, 2)` px of a bent sheet that turns and deforms, and its true 3-D shapes."""
    random = np.random.default_rng(seed)
    across = random.uniform(-1, 1, (N_POINTS, 2))
    bases = np.zeros((N_BASES, N_POINTS, 3))
    bases[0] = np.column_stack([across, 0.8 * np.sum(across**2, axis=1)])
    bases[1:] = 0.12 * random.standard_normal((N_BASES - 1, N_POINTS, 3))
    weights = random.standard_normal((n_frames, N_BASES - 1))
    time = np.linspace(0, 1, n_frames)
    angles = turn * np.column_stack([np.sin(7 * time), np.cos(5 * time), 0.5 * np.sin(4 * time)])
    scales = SIZE * (1 + 0.1 * np.sin(9 * time))
    shapes = bases[0] + np.tensordot(weights, bases[1:], 1)
    seen = scales[:, None, None] * (shapes @ exponential(angles).transpose(0, 2, 1))
    seen[..., :2] += np.column_stack([200 + 30 * time, 150 - 20 * time])[:, None]
    return seen[..., :2] + noise * random.standard_normal((n_frames, N_POINTS, 2)), seen


def holes(tracks: Numbers, share: float, seed: int = 1) -> Numbers:
    """Tracks of which a share is missing at random, but not in the first frames."""
    partial = tracks.copy()
    hidden = np.random.default_rng(seed).random(tracks.shape[:2]) < share
    hidden[:3] = False
    partial[hidden] = np.nan
    return partial


def error(found: Numbers, truth: Numbers) -> float:
    """Normalised 3-D error about the centroids, up to one mirror image."""
    one, other = (shapes - shapes.mean(axis=1, keepdims=True) for shapes in (found, truth))
    size = np.linalg.norm(other, axis=(1, 2))
    return min(
        float(np.mean(np.linalg.norm(one * image - other, axis=(1, 2)) / size)) for image in (1.0, MIRROR)
    )

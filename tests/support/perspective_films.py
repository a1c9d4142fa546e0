"""Tracks of points before perspective cameras, with the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rsmcm.models.camera.perspective_camera import PerspectiveCameras
from scipy.spatial.transform import Rotation

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PerspectiveFilm:
    """`tracks (n_frames, n_points, 2)` px, NaN where nothing was seen, and what they are of."""

    cameras: PerspectiveCameras
    shape: Numbers
    tracks: Numbers
    size: tuple[int, int]

    @property
    def weights(self) -> Numbers:
        return np.asarray(~np.isnan(self.tracks[..., 0]), np.float64)


def turning(
    seed: int,
    *,
    widths: float = 1.5,
    n_points: int = 120,
    n_frames: int = 36,
    degrees: float = 10.0,
    distance: float = 3.0,
    noise: float = 0.3,
    outliers: float = 0.0,
    missing: float = 0.7,
) -> PerspectiveFilm:
    """A ball, of radius 1, that turns by so many degrees a frame before a lens so many pictures wide."""
    rng, size = np.random.default_rng(seed), (480, 640)
    shape = rng.normal(size=(n_points, 3))
    shape *= rng.uniform(0.7, 1.0, (n_points, 1)) / np.linalg.norm(shape, axis=1, keepdims=True)
    turns = np.radians(degrees) * np.arange(n_frames)[:, None]
    rotations = (Rotation.from_euler("x", 25, degrees=True) * Rotation.from_euler("y", turns)).as_matrix()
    focal = widths * size[1]
    cameras = PerspectiveCameras(
        rotations,
        np.full(n_frames, focal / distance),
        np.tile([9.0, -5.0], (n_frames, 1)),
        1 / focal,
        np.array([size[1] - 1, size[0] - 1]) / 2,
    )
    return _filmed(rng, cameras, shape, size, noise, outliers, missing)


def table_top(
    seed: int,
    *,
    widths: float = 1.0,
    n_points: int = 120,
    n_frames: int = 30,
    noise: float = 0.3,
    outliers: float = 0.0,
    missing: float = 0.5,
) -> PerspectiveFilm:
    """Things on a table that a camera moves about, near enough that some are thrice as far as others."""
    rng, size = np.random.default_rng(seed), (240, 320)
    shape = rng.uniform([-1, -0.2, -1], [1, 0, 1], (n_points, 3))
    shape[::2, 1] = 0
    times = np.linspace(0, 1, n_frames)
    angles = 1.5 * (times - 0.5)
    centres = np.stack([1.5 * np.sin(angles), -1.1 - 0.2 * np.sin(6 * times), -1.6 * np.cos(angles)], axis=1)
    aims = 0.1 * np.stack([np.sin(5 * times), np.zeros(n_frames), np.cos(4 * times)], axis=1)
    away = (aims - centres) / np.linalg.norm(aims - centres, axis=1, keepdims=True)
    right = np.cross([0, 1, 0], away)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotations = np.stack([right, np.cross(away, right), away], axis=1)
    translations = -np.einsum("tij,tj->ti", rotations, centres)
    focal = widths * size[1]
    cameras = PerspectiveCameras(
        rotations,
        focal / translations[:, 2],
        focal * translations[:, :2] / translations[:, 2:],
        1 / focal,
        np.array([size[1] - 1, size[0] - 1]) / 2,
    )
    return _filmed(rng, cameras, shape, size, noise, outliers, missing)


def _filmed(
    rng: np.random.Generator,
    cameras: PerspectiveCameras,
    shape: Numbers,
    size: tuple[int, int],
    noise: float,
    outliers: float,
    missing: float,
) -> PerspectiveFilm:
    """Each point is seen in one stretch of frames; of this, so many are outliers."""
    places, depths = cameras.seen(shape)
    n_frames, n_points = depths.shape
    mean = (1 - missing) * n_frames
    lengths = np.maximum(2, rng.poisson(mean, n_points))
    first = rng.integers(-int(mean / 2), n_frames - int(mean / 2), n_points)
    times = np.arange(n_frames)[:, None]
    seen = (times >= first) & (times < first + lengths) & (depths > 0.05)
    seen &= np.all((places >= 0) & (places < (size[1], size[0])), axis=2)
    tracks = places + rng.normal(0, noise, places.shape)
    wrong = seen & (rng.random(seen.shape) < outliers)
    tracks[wrong] += rng.uniform(-40, 40, (np.count_nonzero(wrong), 2))
    tracks[~seen] = np.nan
    kept = seen.sum(axis=0) >= 2
    return PerspectiveFilm(cameras, shape[kept], tracks[:, kept], size)

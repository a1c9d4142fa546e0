"""A small bumpy surface that deforms, smooth pictures to paint it with, bilinear interpolation in numpy."""

import numpy as np
from numpy.typing import NDArray
from rsmcm.chains.face.texture_likelihood import Level
from rsmcm.models.face.morphable_model import MorphableModel, Poses, rms_radius
from rsmcm.models.face.surface import SurfaceTexels
from rsmcm.models.numerics.rotations import exponential

Array = NDArray[np.float64]


def bumpy(n_bases: int = 3, seed: int = 0, *, closed: bool = True) -> MorphableModel:
    """A bulging sheet of 5 x 4 vertices, with smooth deformations; without triangles if not `closed`."""
    random = np.random.default_rng(seed)
    across, down = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 4))
    shape = np.stack([across, down, 0.5 * (across**2 + down**2)], axis=-1).reshape(-1, 3)
    shape[:, :2] += random.uniform(-0.1, 0.1, (20, 2))
    shape = (shape - shape.mean(axis=0)) / rms_radius(shape)
    waves = [
        0.15 * np.sin(shape @ random.normal(size=(3, 3)) + random.uniform(0, 6, 3))
        for _ in range(n_bases - 1)
    ]
    corner = np.array([row * 5 + column for row in range(3) for column in range(4)])
    upper = np.stack([corner, corner + 5, corner + 1], axis=1)
    lower = np.stack([corner + 5, corner + 6, corner + 1], axis=1)
    triangles = np.concatenate([upper, lower]).astype(np.int64)
    return MorphableModel(np.stack([shape, *waves]), triangles if closed else triangles[:0])


def poses_near(n: int, n_bases: int, seed: int, *, size: float = 24.0, turn: float = 0.2) -> Poses:
    """Random poses of an object in the middle of a picture of 120 x 160 px, seen nearly from the front."""
    random = np.random.default_rng(seed)
    morphs = size * 0.5 * random.normal(size=(n, n_bases))
    morphs[:, 0] = size * random.uniform(0.95, 1.05, n)
    translations = np.array([80, 60]) + random.uniform(-3, 3, (n, 2))
    return Poses(exponential(turn * random.uniform(-1, 1, (n, 3))), translations, morphs)


def random_poses(model: MorphableModel, n: int, seed: int, turn: float = 0.4, morphs: float = 0.7) -> Poses:
    """Random poses of a model of 20 to 90 px, some hundred px from the origin."""
    random = np.random.default_rng(seed)
    poses = Poses.upright(random.uniform(50, 200, (n, 2)), random.uniform(20, 90, n), model.n_bases)
    changes = np.zeros((n, poses.dimension))
    changes[:, :3] = turn * random.normal(size=(n, 3))
    changes[:, 6:] = morphs * poses.sizes[:, None] * random.normal(size=(n, model.n_bases - 1))
    return poses.moved(changes)


def smooth_picture(seed: int, height: int = 120, width: int = 160, shortest: float = 14.0) -> Array:
    """`(height, width)` from 8 to 247: a sum of waves, none shorter than `shortest` px."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    picture = np.zeros((height, width))
    for _ in range(12):
        angle, length = random.uniform(0, np.pi), shortest * random.uniform(1, 3)
        there = (x * np.cos(angle) + y * np.sin(angle)) / length
        picture += np.sin(2 * np.pi * there + random.uniform(0, 6))
    return np.asarray(127.5 + 119.5 * picture / np.abs(picture).max())


def level(picture: Array, scale: float = 1.0) -> Level:
    """A picture as a level of its own."""
    return Level(np.ascontiguousarray(picture, np.float32), scale)


def bilinear(picture: Array, places: Array) -> tuple[Array, Array]:
    """Values `(n,)` and slopes `(n, 2)` of the bilinear interpolant at `places` `(n, 2)` in the picture."""
    picture = np.asarray(picture, np.float64)
    left = np.floor(places).astype(int)
    fx, fy = (places - left).T
    x, y = left.T
    p00, p01, p10, p11 = picture[y, x], picture[y, x + 1], picture[y + 1, x], picture[y + 1, x + 1]
    value = (1 - fy) * ((1 - fx) * p00 + fx * p01) + fy * ((1 - fx) * p10 + fx * p11)
    across = (1 - fy) * (p01 - p00) + fy * (p11 - p10)
    down = (1 - fx) * (p10 - p00) + fx * (p11 - p01)
    return value, np.stack([across, down], axis=1)


def row_of_texel(texels: SurfaceTexels) -> NDArray[np.int64]:
    """`(n_texels,)`: number of the row that each texel lies in, its place in its group."""
    return np.repeat(np.arange(len(texels.first) - 1), np.diff(texels.first))


def used_on(texels: SurfaceTexels, level: int) -> NDArray[np.bool_]:
    """`(n_texels,)`: which are used on a level of the picture, a fourth of those of the level before."""
    most = -(-texels.counts // 4**level)
    used: NDArray[np.bool_] = row_of_texel(texels) < most[texels.group_of_texel]
    return used

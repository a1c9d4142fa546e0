"""Films and tracks in which there is no depth to be found, each for a reason of its own."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.models.numerics.rotations import exponential

Numbers = NDArray[np.float64]
Image = NDArray[np.uint8]

SIZE = (200, 150)  # width, height
FOCAL = 190.0  # px
N_FRAMES = 8


def homographies(kind: str, n_frames: int = N_FRAMES) -> Numbers:
    """`(n_frames, 3, 3)`: from places on a wall, px about its middle, to pictures.

    `still`: nothing moves. `zoom`: the camera zooms. `rotation`: it turns where it stands. `plane`: it goes
    round the wall.
    """
    times = np.linspace(-1, 1, n_frames)
    camera = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    first = np.diag([1, 1, FOCAL])  # the wall is as far away as the focal length is long
    turn = {"rotation": 0.12, "plane": 0.4}.get(kind, 0.0)
    maps = []
    for time, rotation in zip(times, exponential(np.outer(times, [0.3 * turn, turn, 0])), strict=True):
        zoom = np.diag([1 + 0.2 * time, 1 + 0.2 * time, 1]) if kind == "zoom" else np.eye(3)
        seen = rotation @ first
        if kind == "plane":  # it turns about the wall's middle
            seen = np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, FOCAL]])
        maps.append(camera @ zoom @ seen)
    return np.array(maps)


def wall(noise: float = 60.0) -> Image:
    """A texture with corners, larger than what cameras see of it."""
    coarse = np.random.default_rng(0).normal(128, noise, (110, 135))
    return np.clip(cv2.resize(coarse, (1100, 900), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)


def write_pictures(folder: Path, images: list[Image]) -> Path:
    """Pictures in a folder."""
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"{number:02}.png"), image)
    return folder


def tracks_on_wall(kind: str, noise: float = 0.2, n_points: int = 60, seed: int = 0) -> Numbers:
    """Tracks `(n_frames, n_points, 2)` px of points on the wall."""
    random = np.random.default_rng(seed)
    places = random.uniform(-60, 60, (n_points, 2))
    seen = [cv2.perspectiveTransform(places[None], each)[0] for each in homographies(kind, 24)]
    return np.array(seen) + noise * random.standard_normal((24, n_points, 2))


def tracks_in_depth(noise: float = 0.2, n_points: int = 60, seed: int = 0) -> Numbers:
    """Tracks of points in depth that a camera sees which goes sideways and looks at their middle."""
    random = np.random.default_rng(seed)
    points = random.uniform(-60, 60, (n_points, 3))
    turned = points @ exponential(np.outer(np.linspace(-0.4, 0.4, 24), [0.3, 1, 0])).transpose(0, 2, 1)
    seen = FOCAL * turned[..., :2] / (turned[..., 2:] + 400)
    return seen + noise * random.standard_normal(seen.shape)

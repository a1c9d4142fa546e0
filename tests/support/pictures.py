"""Pictures of a plane whose motion is known exactly: a sum of waves is sampled anew for every frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Grey = NDArray[np.uint8]

HEIGHT, WIDTH = 140, 180


@dataclass(frozen=True)
class Pose:
    """Where the plane is: its point P is seen at `linear @ P + shift`."""

    linear: Numbers
    shift: Numbers

    def seen(self, points: Numbers) -> Numbers:
        """Positions `(n, 2)` px of points of the plane."""
        return points @ self.linear.T + self.shift

    def on_plane(self, positions: Numbers) -> Numbers:
        """Points of the plane at positions `(..., 2)` px."""
        return (positions - self.shift) @ np.linalg.inv(self.linear).T


class Texture:
    """A plane with grey values about 0 with a standard deviation of 40, in waves of 5 to 60 px in all
    directions."""

    def __init__(self, seed: int, n_waves: int = 80) -> None:
        random = np.random.default_rng(seed)
        length = np.exp(random.uniform(np.log(5), np.log(60), n_waves))
        direction = random.uniform(0, np.pi, n_waves)
        self._waves = 2 * np.pi / length * np.array([np.cos(direction), np.sin(direction)])
        self._heights = np.sqrt(length) * np.exp(1j * random.uniform(0, 2 * np.pi, n_waves))
        self._heights *= 40 / np.sqrt((np.abs(self._heights) ** 2).sum() / 2)

    def seen(self, pose: Pose) -> Numbers:
        """Values at all pixels, `(HEIGHT, WIDTH)`, of the plane in a pose."""
        # a wave on the plane is one in the picture: a product of what its rows and its columns do
        waves = np.linalg.inv(pose.linear).T @ self._waves
        shifted = self._heights * np.exp(-1j * pose.shift @ waves)
        rows = np.exp(1j * np.arange(HEIGHT)[:, None] * waves[1])
        columns = np.exp(1j * waves[0][:, None] * np.arange(WIDTH))
        values: Numbers = ((rows * shifted) @ columns).real
        return values


def sliding(n_frames: int, per_frame: Sequence[float] = (0.83, 0.37)) -> list[Pose]:
    """A plane that moves on at constant velocity, and sways a little."""
    return [
        Pose(np.eye(2), np.array([per_frame[0] * t, per_frame[1] * t + 3 * np.sin(t / 5)]))
        for t in range(n_frames)
    ]


def turning(n_frames: int, degrees_per_frame: float = 0.5) -> list[Pose]:
    """A plane that turns about the middle of the picture."""
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    poses = []
    for angle in np.radians(degrees_per_frame) * np.arange(n_frames):
        linear = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        poses.append(Pose(linear, middle - linear @ middle))
    return poses


def picture(
    texture: Texture,
    pose: Pose,
    noise: float = 0.0,
    seed: int = 0,
    contrast: float = 1.0,
    light: float = 128.0,
) -> Grey:
    """`(HEIGHT, WIDTH)` of the plane in a pose, with noise of so many grey values."""
    values = light + contrast * texture.seen(pose)
    values += noise * np.random.default_rng(seed).standard_normal(values.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def film(poses: Sequence[Pose], seed: int = 0, noise: float = 1.0) -> list[Grey]:
    """Pictures of one plane in its poses."""
    texture = Texture(seed)
    return [picture(texture, pose, noise, 1000 * seed + t) for t, pose in enumerate(poses)]


def hidden_by_a_bar(pictures: Sequence[Grey], first: int, speed: float, width: int = 40) -> list[Grey]:
    """A textured bar enters from the left in frame `first` and crosses the picture at `speed` px a frame."""
    texture = Texture(987)
    columns = np.arange(WIDTH)
    result = []
    for t, grey in enumerate(pictures):
        left = speed * (t - first) - width
        bar = picture(texture, Pose(np.eye(2), np.array([left, 0.0])))
        result.append(np.where((columns >= left) & (columns < left + width), bar, grey))
    return result

"""A picture prepared for matching textures: light taken out, smoothed to several degrees."""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.pictures import grey_of
from ...models.numerics.threads import side_by_side

Picture = NDArray[np.float32]

MIDDLE_GREY = 128.0
DARKEST = 5.0
"""Grey levels added to the local mean, so that black regions do not blow up sensor noise."""

FINE_LIGHT_REACH = 0.1
"""Standard deviation of the local mean on the finest level, in sizes of the object."""

COARSE_LIGHT_REACH = 0.25
"""The same on the others, whose textures are wider than the finest one's reach."""

SMOOTHING = (0.0175, 0.05, 0.125)
"""Standard deviation of the smoothing of each level, in sizes of the object, fine to coarse."""


class Level(NamedTuple):
    """One level of a picture.

    Parameters
    ----------
    image
        `(height, width)` float32 grey, its rows one after the other.
    scale
        px of the level per px of the picture: pixel x of the picture is at x scale + (scale - 1) / 2.
    """

    image: Picture
    scale: float


def image_pyramid(image: NDArray[np.uint8], size: float, *, n_levels: int, local_mean: bool) -> list[Level]:
    """Levels of a picture, fine to coarse; each is half as large as the one before.

    With `local_mean` grey values are divided by their mean about them, y <- 128 y / (mean + 5), which takes
    out light that changes slowly over the object; `size` px is that of the object, by which the mean's reach
    and the smoothing are set. `image` is uint8, grey or BGR.

    Raises
    ------
    ValueError
        if the coarsest level would have less than two px either way.
    """
    least = 2 * 2 ** (n_levels - 1)
    if min(image.shape[:2]) < least:
        raise ValueError(f"image: got {image.shape[:2]}, expected at least {least} px either way")
    raw = grey_of(image).astype(np.float32)

    def fine() -> list[Level]:
        picture = without_light(raw, FINE_LIGHT_REACH * size) if local_mean else raw
        return [Level(smoothed(picture, SMOOTHING[0] * size), 1.0)]

    def coarse() -> list[Level]:
        return list(_coarse_levels(raw, size, n_levels=n_levels, local_mean=local_mean))

    return [level for part in side_by_side([fine, coarse]) for level in part]


def _coarse_levels(picture: Picture, size: float, *, n_levels: int, local_mean: bool) -> Iterator[Level]:
    if local_mean and n_levels > 1:
        picture = without_light(picture, COARSE_LIGHT_REACH * size)
    already = 0.0
    for number in range(1, n_levels):
        scale = 0.5**number
        height, width = (length // 2 * 2 for length in picture.shape)
        picture = np.asarray(
            cv2.resize(picture[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA),
            np.float32,
        )
        picture = smoothed(picture, np.sqrt((SMOOTHING[number] * size) ** 2 - already**2) * scale)
        already = SMOOTHING[number] * size
        yield Level(picture, scale)


def without_light(picture: Picture, reach: float) -> Picture:
    """The picture divided by its mean about every pixel, of standard deviation `reach` px."""
    return picture * (np.float32(MIDDLE_GREY) / (blurred(picture, reach) + np.float32(DARKEST)))


def smoothed(picture: Picture, deviation: float) -> Picture:
    """Gaussian blur of a few px."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), float(deviation)), np.float32)


def blurred(picture: Picture, deviation: float) -> Picture:
    """Gaussian mean about every pixel, worked out on a smaller picture where it is wide."""
    factor = max(int(deviation / 3), 1)
    height, width = picture.shape
    small = cv2.resize(
        picture, (max(width // factor, 1), max(height // factor, 1)), interpolation=cv2.INTER_AREA
    )
    small = cv2.GaussianBlur(small, (0, 0), deviation / factor)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)

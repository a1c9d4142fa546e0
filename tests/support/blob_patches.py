"""Pictures and blobs for loops over patches, and what their colours' density is in float64."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rsmcm.models.pixels.layers import Sprite

F4 = np.float32


def textured(rng: np.random.Generator, channels: int, height: int, width: int) -> NDArray[np.float32]:
    """Smooth random planes, so that small shifts look alike."""
    coarse = rng.uniform(30, 220, (channels, height // 4 + 2, width // 4 + 2))
    rows, columns = np.arange(height) / 4, np.arange(width) / 4
    across = np.array([[np.interp(columns, np.arange(len(row)), row) for row in plane] for plane in coarse])
    out = [[np.interp(rows, np.arange(len(line)), line) for line in plane.T] for plane in across]
    return np.ascontiguousarray(np.array(out).transpose(0, 2, 1), F4)


def sprite(mask: NDArray[Any], appearance: NDArray[Any]) -> Sprite:
    """A blob whose colours have a variance of 300 and a tenth of outliers."""
    return Sprite(mask, appearance, F4(0.5 / 300), F4(4.0), F4(0.1))


def density_of(planes: NDArray[Any], appearance: NDArray[Any]) -> NDArray[np.float64]:
    """What `sprite` says of pixels, relative to the uniform density."""
    distance = np.square(planes.astype(float) - appearance).sum(axis=0)
    return np.asarray(0.9 * np.exp(4.0 - 0.5 / 300 * distance) + 0.1)

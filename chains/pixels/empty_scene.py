"""The empty scene from a sample of frames, as it is when the film begins, whoever moves in front of it then.

What a pixel shows unchanged for the first seconds is taken for the scene, as a tracker takes it that knows no
better: a parked car, or somebody who stands. Where something moves at first, the scene is what comes back
behind everybody: of the colours that a pixel shows, the one that is seen often and at times far apart.
Colours of those who pass differ, and somebody who stays is seen for one stretch of time.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.threads import over_bands
from ...models.pixels.background import EmptyScene
from .background_prediction import LightField
from .kernels.gaussian import HIGHEST_NOISE, HIGHEST_VARIANCE, LOWEST_NOISE, LOWEST_VARIANCE
from .kernels.modes import Modes, find_modes

Image = NDArray[np.uint8]
Numbers = NDArray[np.float64]

STILL = 3.0
"""s: what does not change from the first frame on for so long is part of the scene."""

PRIOR_FRAMES = 8.0
"""How many frames what is known of the noise beforehand counts for."""


def empty_scene(
    images: Sequence[Image],
    times: Numbers,
    light: Sequence[LightField],
    noise: float,
    covered: Sequence[NDArray[np.bool_]] | None = None,
) -> EmptyScene:
    """Find the empty scene.

    Parameters
    ----------
    images
        uint8 `(height, width[, 3])`, all alike; one at least, in order of time.
    times
        `(n_images,)` s.
    light
        of every image, relative to the light of the mean; one for all of them where it does not change.
    noise
        squared grey levels of a single observation, as it is expected.
    covered
        `(height, width)` for every image: where objects are known to be, which does not count, unless they
        always are.
    """
    light = light if len(light) == len(images) else [light[0]] * len(images)
    height, width = images[0].shape[:2]
    channels = 1 if images[0].ndim == 2 else 3
    pixels = np.stack([image.reshape(-1) for image in images])
    found = Modes(
        np.empty((channels, height * width), np.float32),
        *(np.empty(height * width, np.float32) for _ in range(2)),
    )
    since = (np.asarray(times) - times[0]).astype(np.float32)
    early = int(np.count_nonzero(since <= STILL)) if since[-1] > STILL else 0
    behind = np.zeros((len(images), height * width), bool)
    if covered is not None:
        behind = np.stack([each.reshape(-1) for each in covered])
    rows = np.stack([field.along_rows.rows for field in light])
    positions = light[0].along_rows.positions
    # colours within two standard deviations of each other in all channels may be the same
    bandwidth = np.float32(8 * channels * noise)

    def find(first: int, end: int) -> None:
        find_modes(first, end, pixels, behind, since, early, rows, positions, bandwidth, found)

    over_bands(find, height)
    mean, scatter, support = found
    seen = (support * scatter + PRIOR_FRAMES * noise) / (support + PRIOR_FRAMES)
    observed = np.clip(seen, LOWEST_NOISE, HIGHEST_NOISE).astype(np.float32)
    variance = np.clip(observed / support, LOWEST_VARIANCE, HIGHEST_VARIANCE)
    return EmptyScene(images[0].shape, mean, variance.astype(np.float32), observed, light[0].blocks)

"""How much of a scene moves to and fro, learned block by block: what leaves do is no object."""

import math

import numpy as np
from numpy.typing import NDArray

from ...models.pixels.kernels.gaussian import Gaussians, Light
from ...models.pixels.kernels.sway import Sway, count_moved, learn_rates

REACH = 0.01
"""Share of the picture's longer side within which leaves sway."""

SWAY_TIME = 10.0
"""s for which it is remembered that something swayed: a lull is longer than somebody's passing."""

FIRST_TIME = 1.0
"""s for which it is taken for granted in the beginning that nothing sways."""

LEAST_SEEN = 4
"""Pixels of a block that tell how much of it sways."""


def reach(size: tuple[int, int]) -> int:
    """px within which the scene of `size` `(height, width)` sways."""
    return max(math.ceil(REACH * max(size)), 3)


def learned_rates(
    sway: Sway,
    image: NDArray[np.uint8],
    before: Gaussians,
    light: Light,
    log_odds: NDArray[np.int8],
    covered: NDArray[np.uint8],
    times: tuple[float, float],
) -> NDArray[np.float32]:
    """Rates after a frame; what is `covered` `(n_pixels,)` tells nothing of them.

    Parameters
    ----------
    sway, before, light
        predicted.
    image
        uint8 `(height, width[, 3])`.
    log_odds
        `(n_pixels,)` int8, of each pixel by itself.
    times
        s for which the scene has been seen, and s since the frame before.
    """
    counts = np.empty((*sway.rates.shape, 4), np.float32)
    count_moved(np.ascontiguousarray(image).reshape(-1), before, light, log_odds, covered, sway.reach, counts)
    age, elapsed = times
    share = 1 - math.exp(-elapsed / (min(age, SWAY_TIME) + FIRST_TIME))
    rates: NDArray[np.float32] = np.empty_like(sway.rates)
    learn_rates(counts, sway.rates, np.float32(share), LEAST_SEEN, rates)
    return rates

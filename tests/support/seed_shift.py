"""With `SEED_SHIFT=n` in the environment, every seed given to `numpy.random.default_rng` is another one.

A test that fails then rests on one draw of random numbers. `nox --session seeds` runs the quick tests so.
Commands in processes of their own keep their seeds.
"""

import os
from typing import Any

import numpy as np

ORIGINAL = np.random.default_rng


def shifted(seed: Any, shift: int) -> Any:
    """Return the seed plus the shift; of a sequence, the first number is shifted; others stay as they are."""
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        return int(seed) + shift
    if isinstance(seed, list | tuple) and seed and isinstance(seed[0], int | np.integer):
        return [int(seed[0]) + shift, *seed[1:]]
    return seed


def install() -> None:
    """Shift all seeds from now on, if the environment says so."""
    if shift := int(os.environ.get("SEED_SHIFT", "0")):
        np.random.default_rng = lambda seed=None: ORIGINAL(shifted(seed, shift))  # type: ignore[assignment, misc]

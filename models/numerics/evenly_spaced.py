"""A few evenly spaced items of a row of any length."""

import numpy as np


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return at most so many of the numbers below `count`, evenly spaced."""
    return [round(number) for number in np.linspace(0, count - 1, min(count, most)).tolist()]

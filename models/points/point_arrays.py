"""Arrays of points over time, from anybody: damage is refused before it drowns everything else."""

import numpy as np
from numpy.typing import NDArray

FARTHEST = 1e7
"""px: coordinates beyond are taken for damage; their squares would drown everything else."""


def check_points(name: str, points: NDArray[np.float64], *, half: bool = False) -> None:
    """Refuse points `(n_frames, n_points, 2)` px that are neither positions nor missing, which is NaN twice.

    Parameters
    ----------
    name
        of the points, for the message.
    points
        to be judged.
    half
        whether one coordinate alone will do.

    Raises
    ------
    ValueError
        that names the first such point of `name`: it is infinite or farther off than `FARTHEST`, or has one
        coordinate only.
    """
    missing = np.isnan(points)
    for wrong, expected in (
        (np.abs(points) > FARTHEST, f"finite px up to {FARTHEST:g}, NaN where missing"),
        ((missing[..., :1] != missing) & (not half), "both coordinates or none"),
    ):
        if wrong.any():
            frame, point = np.argwhere(wrong.any(axis=2))[0]
            place = f"point {point} of frame {frame} (both from 0)"
            raise ValueError(f"{name}: got {points[frame, point].tolist()} at {place}, expected {expected}")

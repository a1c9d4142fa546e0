"""Which frames and points hang together well enough to be one structure, by counting alone."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .kernels.moments import connected_frames
from .observations import LEAST_FRAMES, LEAST_POINTS, Observations

Mask = NDArray[np.bool_]

LEAST_VIEWS = 2


def determined(observations: Observations, *, apart: bool = False) -> tuple[Mask, Mask]:
    """Frames `(n_frames,)` that show four points or more that are seen in two such frames or more; and those.

    Parameters
    ----------
    observations
        what was seen.
    apart
        whether frames may fall into sets that share too few points to be one structure.

    Raises
    ------
    ValueError
        if there are not enough of them, or they fall into such sets.
    """
    frames = np.ones(observations.n_frames, bool)
    points = np.ones(observations.n_points, bool)
    part = observations
    while True:
        count = part.count
        frames = np.diff(part.by_frame.edges) >= LEAST_POINTS
        points = np.diff(part.by_point.edges) >= LEAST_VIEWS
        part = part.only(frames, points)
        if part.count == count:
            break
    if frames.sum() < LEAST_FRAMES or points.sum() < LEAST_POINTS:
        raise ValueError(
            f"positions: got {frames.sum()} frames with {LEAST_POINTS} points that other frames show too, "
            f"expected {LEAST_FRAMES} or more"
        )
    lost = frames & ~_joined(part)
    if lost.any() and not apart:
        raise ValueError(
            f"positions: got frames {ranges(np.flatnonzero(lost))} that share fewer than {LEAST_POINTS} "
            "points with the other frames, expected frames that hang together (take the sets one by one)"
        )
    return frames, points


def _joined(part: Observations) -> Mask:
    """Frames that hang together with the fullest one and the one that shares most points with it."""
    listed = part.by_frame
    fullest = int(np.argmax(np.diff(listed.edges)))
    shown = np.zeros(part.n_points, bool)
    shown[listed.other[listed.edges[fullest] : listed.edges[fullest + 1]]] = True
    shared = np.bincount(listed.own[shown[listed.other]], minlength=part.n_frames)
    shared[fullest] = 0
    joined: Mask = connected_frames(
        listed, part.by_point, fullest, int(np.argmax(shared)), LEAST_POINTS, LEAST_VIEWS
    )
    return joined


def ranges(numbers: Sequence[int] | NDArray[np.int64]) -> str:
    """Increasing whole numbers as text: `"0-3, 7"`."""
    values = np.asarray(numbers)
    breaks = np.flatnonzero(np.diff(values) > 1) + 1
    return ", ".join(
        f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in np.split(values, breaks)
    )

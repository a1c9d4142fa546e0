"""Which tracks show the same point of a deforming shape: those that lie where the other one is expected."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .learning import LEAST_FRAMES, LEAST_POINTS, learn_shape
from .shape import NonrigidShape

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

ALIKE = 3.0
"""Mean squared distance of a coordinate from where the other track expects it, in units of what is stated.

It is 1 for one point, if covariances are honest. Its errors are alike over time, so that the mean over a
short track spreads as a chi-square of few degrees of freedom would: 3 is its 95 % point for two of them.
"""
SHARP = 0.1
"""Places are expected to this share of the object's size, or another track cannot be told from them."""
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class AssociatedShape:
    """A shape, and the tracks that show its points.

    Parameters
    ----------
    shape
        the shape.
    point_of_track
        `(n_tracks,)` int64; -1 where a track is too short.
    """

    shape: NonrigidShape
    point_of_track: Indices


def learn_associated(positions: Numbers, bases: int, *, associate: bool) -> AssociatedShape:
    """Learn a shape from tracks, of which some may show one point one after the other.

    Parameters
    ----------
    positions
        `(n_frames, n_tracks, 2)` px, NaN where not seen.
    bases
        for `learn_shape`, fewer if the tracks cannot tell so many apart.
    associate
        whether tracks are united: pairs that were never seen at once, of which each lies where the shape
        expects the other and no other one lies nearer. Then the shape is learned again, until none are left.

    Raises
    ------
    ValueError
        as `learn_shape` does.
    """
    point = _long_enough(positions)
    for _ in range(ROUNDS):
        merged = _merged(positions, point)
        shape = learn_shape(merged, bases)
        pairs = _pairs(merged, shape) if associate else []
        if not pairs:
            break
        for one, other in pairs:
            point[point == other] = one
        point[point >= 0] = np.unique(point[point >= 0], return_inverse=True)[1]
    else:
        shape = learn_shape(_merged(positions, point), bases)
    return AssociatedShape(shape, point)


def _long_enough(positions: Numbers) -> Indices:
    """A point for each track that is seen in enough frames which show enough of the others."""
    seen = ~np.isnan(positions[..., 0])
    keeps = np.ones(seen.shape[1], np.bool_)
    while True:
        frames = seen[:, keeps].sum(axis=1) >= LEAST_POINTS
        enough = keeps & (seen[frames].sum(axis=0) >= LEAST_FRAMES)
        if not enough.any():
            return np.arange(len(keeps))  # it is for `learn_shape` to say what is missing
        if (enough == keeps).all():
            return np.where(keeps, np.cumsum(keeps) - 1, -1)
        keeps = enough


def _merged(positions: Numbers, point: Indices) -> Numbers:
    """`(n_frames, n_points, 2)`: of each frame the track that shows the point, if there is one."""
    merged = np.full((len(positions), point.max() + 1, 2), np.nan)
    for track in np.flatnonzero(point >= 0):
        seen = ~np.isnan(positions[:, track, 0])
        merged[seen, point[track]] = positions[seen, track]
    return merged


def _pairs(positions: Numbers, shape: NonrigidShape) -> list[tuple[int, int]]:
    """Pairs of points that are one, the smaller number first; no point is in two of them."""
    seen = ~np.isnan(positions[..., 0]) & shape.frame_determined[:, None]
    apart = (seen.T.astype(np.float64) @ seen) > 0
    means = shape.shapes()[..., :2]
    covariances = shape.shape_covariances()[..., :2, :2]
    covariances[..., [0, 1], [0, 1]] += shape.noise**2
    size = float(np.nanmean(shape.scales))
    n_points = positions.shape[1]
    distance = np.full((n_points, n_points), np.inf)
    for track in range(n_points):
        times = np.flatnonzero(seen[:, track])
        others = np.flatnonzero(~apart[track])
        if not len(times) or not len(others):
            continue
        away = positions[times, track][:, None] - means[np.ix_(times, others)]
        spread = covariances[np.ix_(times, others)]
        squares = np.einsum("tni,tnij,tnj->tn", away, np.linalg.inv(spread), away) / 2
        sharp = np.trace(spread, axis1=2, axis2=3).mean(axis=0) < 2 * (SHARP * size) ** 2
        distance[track, others] = np.where(sharp, squares.mean(axis=0), np.inf)
    distance = np.maximum(distance, distance.T)
    nearest = distance.argmin(axis=1)
    every = np.arange(n_points)
    mutual = (nearest[nearest] == every) & (distance[every, nearest] < ALIKE) & (every < nearest)
    return [(int(one), int(nearest[one])) for one in np.flatnonzero(mutual)]

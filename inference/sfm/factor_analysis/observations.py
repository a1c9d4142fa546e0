"""Observed positions of points as two sparse lists, by frame and by point, and what of them is one structure.

Positions are in units of their own spread, so that numbers are around 1 whatever the unit was.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from .kernels import cover

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

LEAST_FRAMES = 3
LEAST_POINTS = 4
ROUNDING = 1e-13


class SparseObservations(NamedTuple):
    """Observations in one order: those of frame (or point) k are `edges[k]:edges[k + 1]`.

    `own` is the frame (or point) of each and `other` the point (or frame), `x` and `y` its position,
    `weight` 1 / relative variance.
    """

    edges: Indices
    own: Indices
    other: Indices
    x: Array
    y: Array
    weight: Array

    @classmethod
    def sorted_by(cls, own: Indices, n: int, other: Indices, x: Array, y: Array, weight: Array) -> Self:
        """Return the observations of `n` rows, which are sorted by row already."""
        edges = np.zeros(n + 1, np.int64)
        np.cumsum(np.bincount(own, minlength=n), out=edges[1:])
        # loops are compiled once, for arrays without gaps
        compact = np.ascontiguousarray
        return cls(edges, compact(own), compact(other), compact(x), compact(y), compact(weight))

    def transposed(self, n: int) -> Self:
        """Return the observations sorted by the other side, of which there are `n`."""
        rows = csr_array((np.arange(len(self.own)), self.other, self.edges), shape=(len(self.edges) - 1, n))
        order = rows.tocsc().data  # faster than sorting
        own, x, y, weight = self.own[order], self.x[order], self.y[order], self.weight[order]
        return self.sorted_by(self.other[order], n, own, x, y, weight)

    def matrix(self, values: Array, n: int) -> csr_array:
        """Return values of the observations as a matrix; the other side has `n` columns."""
        return csr_array((values, self.other, self.edges), shape=(len(self.edges) - 1, n))

    def errors(self, cameras: Array, shape: Array) -> Array:
        """Return `(2, n)`: observed minus predicted, of observations by frame."""
        rows, points = cameras[self.own], shape[self.other]
        predicted = np.einsum("ncj,nj->cn", rows[..., :3], points) + rows[..., 3].T
        return np.asarray(np.array([self.x, self.y]) - predicted, np.float64)

    def only(self, own: NDArray[np.bool_], other: NDArray[np.bool_]) -> Self:
        """Return the observations of which both sides are kept."""
        if own.all() and other.all():
            return self
        keep = own[self.own] & other[self.other]
        other_kept, x, y, weight = self.other[keep], self.x[keep], self.y[keep], self.weight[keep]
        return self.sorted_by(self.own[keep], len(own), other_kept, x, y, weight)


def as_arrays(positions: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array]:
    """Return positions `(n_frames, n_points, 2)` and weights `(n_frames, n_points)`; else a `ValueError`."""
    where = np.asarray(positions, np.float64)
    if where.ndim != 3 or where.shape[2] != 2:
        raise ValueError(f"positions: got {where.shape}, expected (n_frames, n_points, 2)")
    seen = ~np.isnan(where).all(axis=2) if weights is None else weights
    weight = np.asarray(seen, np.float64)
    if weight.shape != where.shape[:2]:
        raise ValueError(f"weights: got {weight.shape}, expected {where.shape[:2]}")
    return where, weight


@dataclass(frozen=True, eq=False)
class Observations:
    """What was seen of points, moved and scaled so that numbers are around 1, in two orders.

    Px from the `centre` `(2,)` of all positions over their root mean square about their frame's middle,
    `scale`; weights over their mean as given, `weight_unit`. `observed_share` is that of the coordinates that
    were seen, others are filled in.
    """

    by_frame: SparseObservations
    by_point: SparseObservations
    centre: Array
    scale: float
    weight_unit: float
    observed_share: float = 1.0

    @classmethod
    def from_arrays(
        cls, positions: ArrayLike, weights: ArrayLike | None = None, *, observed_share: float = 1.0
    ) -> Self:
        """Return the list of observations; `positions` and `weights` as of `factorise`.

        `observed_share` is that of the coordinates that were seen. A `ValueError` says if shapes do not fit,
        weights are negative or not finite, a position with weight is not finite, or there are fewer than 3
        frames or 4 points.
        """
        where, weight = as_arrays(positions, weights)
        n_frames, n_points = weight.shape
        bad = ~(np.isfinite(weight) & (weight >= 0))
        if bad.any():
            frame, point = np.argwhere(bad)[0]
            raise ValueError(
                f"weights: got {weight[frame, point]} at frame {frame}, point {point}, expected 0 or more"
            )
        shown = weight > 0
        frames, points = np.nonzero(shown)
        x, y = where[frames, points, 0], where[frames, points, 1]
        finite = np.isfinite(x) & np.isfinite(y)
        if not finite.all():
            k = int(np.argmin(finite))
            raise ValueError(
                f"positions: got {[float(x[k]), float(y[k])]} at frame {frames[k]}, point {points[k]}, "
                "expected finite numbers"
            )
        if n_frames < LEAST_FRAMES or n_points < LEAST_POINTS:
            raise ValueError(
                f"positions: got {n_frames} frames and {n_points} points, "
                f"expected {LEAST_FRAMES} frames and {LEAST_POINTS} points or more"
            )
        if not len(frames):
            raise ValueError(
                "positions: got no observation at all, expected points that are seen in some frames"
            )
        given = weight[frames, points]
        unit = float(given.mean())
        centre = np.array([x.mean(), y.mean()])
        x -= centre[0]
        y -= centre[1]
        counts = np.count_nonzero(shown, axis=1)
        of_frame = np.maximum(counts, 1)
        # about the middle of each frame
        squares = float(x @ x + y @ y) - float(
            np.sum((np.bincount(frames, x, n_frames) ** 2 + np.bincount(frames, y, n_frames) ** 2) / of_frame)
        )
        scale = float(np.sqrt(max(squares, 0.0) / (2 * len(x))))
        if scale <= ROUNDING * float(np.abs(centre).max() + np.sqrt(x @ x + y @ y)):
            raise ValueError("positions: got all points of a frame in one place, expected points that differ")
        by_frame = SparseObservations.sorted_by(frames, n_frames, points, x / scale, y / scale, given / unit)
        return cls(by_frame, by_frame.transposed(n_points), centre, scale, unit, observed_share)

    @property
    def n_frames(self) -> int:
        """Number of frames, also of those that show nothing."""
        return len(self.by_frame.edges) - 1

    @property
    def n_points(self) -> int:
        """Number of points, also of those that are never seen."""
        return len(self.by_point.edges) - 1

    @property
    def count(self) -> int:
        """Number of observations."""
        return len(self.by_frame.other)

    @property
    def numbers(self) -> float:
        """How many coordinates were seen."""
        return 2 * self.count * self.observed_share

    def scaled(self, cameras: Array) -> Array:
        """Return cameras `(n_frames, 2, 4)` given in px, in the units used in here."""
        scaled = cameras / self.scale
        scaled[..., 3] -= self.centre / self.scale
        return scaled

    def only(self, frames: NDArray[np.bool_], points: NDArray[np.bool_]) -> "Observations":
        """Return the observations of some frames `(n_frames,)` and points `(n_points,)`."""
        return replace(
            self, by_frame=self.by_frame.only(frames, points), by_point=self.by_point.only(points, frames)
        )


ENOUGH = 100  # points of a frame: more make its camera, which has eight numbers, hardly surer


def covering(seen: Mask) -> Mask:
    """Return points `(n_points,)`, of which each frame shows `ENOUGH` or all that it has.

    These are the points that are seen longest, `seen` `(n_frames, n_points)`: what is searched for among many
    starts is sought by them.
    """
    longest = np.argsort(-np.count_nonzero(seen, axis=0), kind="stable")
    return np.asarray(cover(np.ascontiguousarray(seen), longest, ENOUGH), np.bool_)


LEAST_VIEWS = 2


def determined(observations: Observations, *, apart: bool = False) -> tuple[Mask, Mask]:
    """Return the frames with four or more points that two or more of these frames show, and the points.

    With `apart` frames may fall into sets that share too few points to be one structure. It is a
    `ValueError` if they do otherwise, or if there are not enough of them.
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
    if not apart and (lost := frames & ~_joined(part)).any():
        raise ValueError(
            f"positions: got frames {ranges(np.flatnonzero(lost))} that share fewer than {LEAST_POINTS} "
            "points with the other frames, expected connected frames (use the sets one by one)"
        )
    return frames, points


def _joined(part: Observations) -> Mask:
    """Frames that hang together with the fullest one and the one that shares most points with it.

    Points are known once enough of these frames show them, frames come in as soon as they show enough known
    points.
    """
    listed, n_frames = part.by_frame, part.n_frames
    fullest = int(np.argmax(np.diff(listed.edges)))
    shown = np.zeros(part.n_points, bool)
    shown[listed.other[listed.edges[fullest] : listed.edges[fullest + 1]]] = True
    shared = np.bincount(listed.own[shown[listed.other]], minlength=n_frames)
    shared[fullest] = 0
    joined: Mask = np.isin(np.arange(n_frames), [fullest, int(np.argmax(shared))])
    while True:
        known = np.bincount(listed.other[joined[listed.own]], minlength=part.n_points) >= LEAST_VIEWS
        more = joined | (np.bincount(listed.own[known[listed.other]], minlength=n_frames) >= LEAST_POINTS)
        if np.array_equal(more, joined):
            return joined
        joined = more


def ranges(numbers: Sequence[int] | NDArray[np.int64]) -> str:
    """Return increasing whole numbers as text: `"0-3, 7"`."""
    values = np.asarray(numbers)
    breaks = np.flatnonzero(np.diff(values) > 1) + 1
    return ", ".join(
        f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in np.split(values, breaks)
    )

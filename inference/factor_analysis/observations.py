"""Observed positions of points as two sparse lists, by frame and by point, in units of their own spread."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

LEAST_FRAMES = 3
LEAST_POINTS = 4

ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Listed:
    """Observations in one order: those of frame (or point) k are `edges[k]:edges[k + 1]`.

    Parameters
    ----------
    edges
        `(n + 1,)`.
    other
        `(n_observations,)`, the point (or frame) of each.
    x, y
        `(n_observations,)` positions.
    weight
        `(n_observations,)` positive: 1 / relative variance.
    """

    edges: Indices
    other: Indices
    x: Numbers
    y: Numbers
    weight: Numbers

    @property
    def columns(self) -> tuple[Indices, Indices, Numbers, Numbers, Numbers]:
        """As the kernels take them."""
        return self.edges, self.other, self.x, self.y, self.weight

    def transposed(self, n: int) -> "Listed":
        """The same in the order of the other side, of which there are `n`."""
        rows = len(self.edges) - 1
        places = csr_array((np.arange(len(self.other)), self.other, self.edges), shape=(rows, n)).tocsc()
        order = places.data
        return Listed(
            places.indptr.astype(np.int64),
            places.indices.astype(np.int64),
            self.x[order],
            self.y[order],
            self.weight[order],
        )

    @cached_property
    def own(self) -> Indices:
        """`(n_observations,)`, the frame (or point) of each."""
        return np.repeat(np.arange(len(self.edges) - 1), np.diff(self.edges))


@dataclass(frozen=True, eq=False)
class Observations:
    """What was seen of points, moved and scaled so that numbers are around 1 whatever the units.

    Parameters
    ----------
    by_frame, by_point
        the same observations in two orders.
    centre
        `(2,)` px, the middle of all positions.
    scale
        px, root mean square of positions about the middle of their frame.
    weight_unit
        mean weight as given; in here the mean is 1.
    """

    by_frame: Listed
    by_point: Listed
    centre: Numbers
    scale: float
    weight_unit: float

    @classmethod
    def from_arrays(cls, positions: ArrayLike, weights: ArrayLike | None = None) -> Self:
        """List what was observed.

        Parameters
        ----------
        positions
            `(n_frames, n_points, 2)` px; anything where the weight is 0.
        weights
            `(n_frames, n_points)`, 1 / relative variance, 0 where nothing was seen; where left out, 1
            wherever the position is not NaN.

        Raises
        ------
        ValueError
            if shapes do not fit, weights are negative or not finite, a position with weight is not finite, or
            there are fewer than 3 frames or 4 points.
        """
        where = np.asarray(positions, np.float64)
        if where.ndim != 3 or where.shape[2] != 2:
            raise ValueError(f"positions: got {where.shape}, expected (n_frames, n_points, 2)")
        n_frames, n_points = where.shape[:2]
        if weights is None:
            weight = np.asarray(~np.isnan(where).any(axis=2), np.float64)
        else:
            weight = np.asarray(weights, np.float64)
            if weight.shape != (n_frames, n_points):
                raise ValueError(f"weights: got {weight.shape}, expected {(n_frames, n_points)}")
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
        edges = np.zeros(n_frames + 1, np.int64)
        np.cumsum(counts, out=edges[1:])
        by_frame = Listed(edges, points, x / scale, y / scale, given / unit)
        return cls(by_frame, by_frame.transposed(n_points), centre, scale, unit)

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

    def scaled(self, cameras: Numbers) -> Numbers:
        """Cameras `(n_frames, 2, 4)` given in px, in the units used in here."""
        scaled = cameras / self.scale
        scaled[..., 3] -= self.centre / self.scale
        return scaled

    def only(self, frames: NDArray[np.bool_], points: NDArray[np.bool_]) -> "Observations":
        """Those of some frames `(n_frames,)` and points `(n_points,)`; numbering and units stay."""
        return replace(
            self, by_frame=_kept(self.by_frame, frames, points), by_point=_kept(self.by_point, points, frames)
        )


def _kept(listed: Listed, own: NDArray[np.bool_], other: NDArray[np.bool_]) -> Listed:
    """Observations of which both sides are kept."""
    if own.all() and other.all():
        return listed
    keep = own[listed.own] & other[listed.other]
    edges = np.zeros_like(listed.edges)
    np.cumsum(np.bincount(listed.own[keep], minlength=len(own)), out=edges[1:])
    return Listed(edges, listed.other[keep], listed.x[keep], listed.y[keep], listed.weight[keep])

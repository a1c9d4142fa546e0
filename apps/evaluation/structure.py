"""Measures of a recovered shape and its tracks against the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inference.sfm.affine_camera import affine_alignment
from ..scenes import Cylinder

Numbers = NDArray[np.float64]

REJECTED = -1
"""Stands in `point_of_track` for a track that no estimated point takes."""


@dataclass(frozen=True)
class StructureScores:
    """Errors and counts of one reconstruction.

    An estimated point stands for the true point that most of the observations assigned to it belong to.
    """

    # root mean square distance between estimated points and the noise-free ones that they stand for, over all
    # frames and estimated points, visible or not, in the truth's unit of length
    reprojection_error: float
    # root mean square distance in space, over estimated points, after the affine map of the estimated shape
    # that makes it smallest; NaN where there is no shape
    shape_error: float
    n_points: int  # estimated points
    n_spurious: int  # those beyond one for every true point that is represented
    n_missing: int  # true points for which no estimated point stands
    n_rejected: int  # tracks that belong to no estimated point
    purity: float  # share of the estimated points all of whose observations are of one true point


def score_structure(
    positions: Numbers, shape: Numbers | None, point_of_track: NDArray[np.int64], truth: Cylinder
) -> StructureScores:
    """Compare a reconstruction from `truth.tracks()` with the truth.

    Parameters
    ----------
    positions
        `(n_frames, n_estimated, 2)` of every estimated point in every frame, in the truth's unit of length.
    shape
        `(n_estimated, 3)` up to an affine map; `None` where none was found.
    point_of_track
        `(n_tracks,)`: the estimated point to which each track was assigned, `REJECTED` for none.
    truth
        the generated sequence.
    """
    n_true, n_estimated = truth.visible.shape[1], positions.shape[1]
    counts = np.zeros((n_estimated, n_true), np.int64)  # observations of true points in estimated ones
    taken = point_of_track != REJECTED
    lengths = np.count_nonzero(~np.isnan(truth.tracks()[:, :, 0]), axis=0)
    np.add.at(counts, (point_of_track[taken], truth.point_of_track[taken]), lengths[taken])
    backed = counts.any(axis=1)
    stands_for = counts.argmax(axis=1)[backed]

    error = positions[:, backed] - truth.positions[:, stands_for]
    shape_error = np.nan
    if shape is not None and backed.any():
        shape_error = affine_alignment(shape[backed], truth.shape[stands_for]).error
    n_represented = len(np.unique(stands_for))
    return StructureScores(
        reprojection_error=float(np.sqrt(np.square(error).sum(axis=2).mean())) if error.size else np.nan,
        shape_error=shape_error,
        n_points=n_estimated,
        n_spurious=n_estimated - n_represented,
        n_missing=n_true - n_represented,
        n_rejected=int(np.count_nonzero(~taken)),
        purity=float(np.mean(np.count_nonzero(counts, axis=1) == 1)) if n_estimated else np.nan,
    )

"""What comes in at point tracks over a whole film, as arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...models.points.point_tracks import PointTracks
from ..core.protocols import BatchIncoming

Numbers = NDArray[np.float64]


def observations(
    incoming_over_time: Sequence[BatchIncoming],
) -> tuple[NDArray[np.int64], Numbers, Numbers]:
    """Identities `(n,)`, positions `(n_frames, n, 2)` and 1 / variances `(n_frames, n)` of what comes in."""
    moments = [incoming[PointTracks].positions.moments for incoming in incoming_over_time]
    identities = np.unique(np.concatenate([each for each, _, _ in moments]))
    positions = np.zeros((len(moments), len(identities), 2))
    weights = np.zeros((len(moments), len(identities)))
    for time, (known, means, covariances) in enumerate(moments):
        place = np.searchsorted(identities, known)
        positions[time, place] = means
        weights[time, place] = 2 / np.trace(covariances, axis1=1, axis2=2)
    return identities, positions, weights

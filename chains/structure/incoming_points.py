"""What comes in at point tracks over a whole film, as arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming
from ...models.core.gaussian_message import GaussianMessage
from ...models.points.point_tracks import PointTracks

Numbers = NDArray[np.float64]


def observations(
    incoming_over_time: Sequence[BatchIncoming],
) -> tuple[NDArray[np.int64], Numbers, Numbers]:
    """Identities `(n,)`, positions `(n_frames, n, 2)` and 1 / variances `(n_frames, n)` of what comes in.

    Where there is information about one coordinate only the other one is NaN.
    """
    messages = [incoming[PointTracks].positions for incoming in incoming_over_time]
    identities = np.unique(np.concatenate([each.identities[_told(each)] for each in messages]))
    positions = np.zeros((len(messages), len(identities), 2))
    weights = np.zeros((len(messages), len(identities)))
    for time, message in enumerate(messages):
        known, means, covariances = message.moments
        place = np.searchsorted(identities, known)
        positions[time, place] = means
        weights[time, place] = 2 / np.trace(covariances, axis1=1, axis2=2)
        half = message.only(_told(message) & ~message.proper)
        place = np.searchsorted(identities, half.identities)
        information = half.information.diagonal(axis1=1, axis2=2)
        positions[time, place] = np.where(information > 0, half.vector, np.nan) / np.where(
            information > 0, information, 1.0
        )
        weights[time, place] = information.max(axis=1)
    return identities, positions, weights


def _told(message: GaussianMessage) -> NDArray[np.bool_]:
    """Of whom both coordinates are known, or one of them."""
    one = np.count_nonzero(message.information.any(axis=2), axis=1) == 1
    return np.asarray(message.proper | one)

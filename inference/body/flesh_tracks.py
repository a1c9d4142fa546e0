"""State of the tracker of head and hands: a robust Gaussian each, and which hand is which."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr

Array = NDArray[np.float64]

HEAD, LEFT, RIGHT = range(3)
HANDS = [LEFT, RIGHT]
EXCHANGED = [HEAD, RIGHT, LEFT]


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTracks:
    """Head, left hand and right hand: where they are and how they move, each on its own.

    With probability `trust` a part is where its Gaussian says, otherwise anywhere in reach; and with
    probability `exchanged` each hand is where the other one's Gaussian says.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    means
        `(3, 4)`: x, y px and their velocities px/s.
    covariances
        `(3, 4, 4)`, in the same order.
    trust
        `(3,)` probabilities.
    exchanged
        probability, at most 0.5.
    unseen
        `(3,)` s since a part was last confirmed by a detection; infinite before the first time.
    labels
        `(3,)` int64: number of the detection in the last picture that a part was assigned, -1 for none.
    patience
        s after which a part that is not confirmed is lost.
    """

    size: tuple[int, int]
    means: Array
    covariances: Array
    trust: Array
    exchanged: float
    unseen: Array
    labels: NDArray[np.int64]
    patience: float

    @property
    def positions(self) -> Array:
        """`(3, 2)` px."""
        return self.means[:, :2]

    @property
    def position_covariances(self) -> Array:
        """`(3, 2, 2)` px^2."""
        return self.covariances[:, :2, :2]

    @property
    def exchanged_hands(self) -> Self:
        """The same with each hand where the other one is."""
        return replace(
            self,
            means=self.means[EXCHANGED],
            covariances=self.covariances[EXCHANGED],
            trust=self.trust[EXCHANGED],
            unseen=self.unseen[EXCHANGED],
        )

    @property
    def lost(self) -> NDArray[np.bool_]:
        """`(3,)`: parts that may be anywhere in reach, since nothing has confirmed them for too long."""
        return self.unseen > self.patience

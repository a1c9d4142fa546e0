"""Points that a tracker knows: those that it follows, and those that it lost lately and may meet again."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference.kalman import STATE, PointStates
from ...models.core.short_repr import short_repr

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
Identities = NDArray[np.int64]
Pixels = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class KnownPoints:
    """Points by identity.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    states
        of `n` points; meaningless of those that are not alive.
    alive
        `(n,)`: which ones are followed.
    unseen
        `(n,)` s since a frame showed the point.
    first, patches
        `(n, side, side)` float32 grey values: what the point looked like at first, and what it is taken to
        look like now; 0 where points come without pictures.
    """

    identities: Identities
    states: PointStates
    alive: Mask
    unseen: Numbers
    first: Pixels
    patches: Pixels

    @classmethod
    def none(cls) -> "KnownPoints":
        """No points."""
        return cls.new(
            np.zeros(0, np.int64), PointStates.at_rest([], 1.0, 1.0), np.zeros((0, 0, 0), np.float32)
        )

    @classmethod
    def new(cls, identities: Identities, states: PointStates, patches: Pixels) -> "KnownPoints":
        """Points that have just been seen, `identities` in order."""
        count = len(identities)
        return cls(identities, states, np.ones(count, np.bool_), np.zeros(count), patches, patches)

    @classmethod
    def lost(cls, identities: Identities, first: Pixels, patches: Pixels) -> "KnownPoints":
        """Points of which only the patches are known."""
        count = len(identities)
        states = PointStates(np.zeros((count, STATE)), np.tile(np.eye(STATE), (count, 1, 1)))
        return cls(identities, states, np.zeros(count, np.bool_), np.full(count, np.inf), first, patches)

    def __len__(self) -> int:
        return len(self.identities)

    def only(self, kept: Mask | NDArray[np.intp]) -> "KnownPoints":
        """Those of whom `kept` is true, or at these places."""
        states = PointStates(self.states.mean[kept], self.states.covariance[kept])
        arrays = {name.name: getattr(self, name.name)[kept] for name in fields(self) if name.name != "states"}
        return KnownPoints(states=states, **arrays)

    def joined(self, others: "KnownPoints") -> "KnownPoints":
        """These and others, of other identities."""
        if not len(others):
            return self
        if not len(self):
            return others

        def both(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([one, other])

        states = PointStates(
            both(self.states.mean, others.states.mean), both(self.states.covariance, others.states.covariance)
        )
        arrays = {
            name.name: both(getattr(self, name.name), getattr(others, name.name))
            for name in fields(self)
            if name.name != "states"
        }
        together = KnownPoints(states=states, **arrays)
        return together.only(np.argsort(together.identities))

    def places_of(self, identities: Identities) -> NDArray[np.intp]:
        """`(m,)`: where points of these identities are, which must be known."""
        return np.searchsorted(self.identities, identities)

    def without_oldest(self, most: int) -> "KnownPoints":
        """As they are, but of those that are not alive only the `most` that were seen last."""
        lost = np.flatnonzero(~self.alive)
        if len(lost) <= most:
            return self
        kept = self.alive.copy()
        # of two that were lost at the same time the later one stays
        kept[lost[np.lexsort((-self.identities[lost], self.unseen[lost]))[:most]]] = True
        return self.only(kept)

    def with_states(self, places: NDArray[np.intp], states: PointStates) -> "KnownPoints":
        """As they are, but with other states at some places, alive and just seen."""
        mean, covariance = self.states.mean.copy(), self.states.covariance.copy()
        alive, unseen = self.alive.copy(), self.unseen.copy()
        mean[places], covariance[places] = states.mean, states.covariance
        alive[places], unseen[places] = True, 0.0
        return replace(self, states=PointStates(mean, covariance), alive=alive, unseen=unseen)

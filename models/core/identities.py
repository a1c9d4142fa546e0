"""Tables of things by identity: arrays with a row for each of them, in order of increasing identities.

Identities are integers that a thing keeps as long as it exists, and that no other thing gets.
"""

from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Identities = NDArray[np.int64]
Places = NDArray[np.intp]
RowArray = TypeVar("RowArray", bound=NDArray[Any])


def find(identities: Identities, wanted: ArrayLike) -> tuple[Places, NDArray[np.bool_]]:
    """Return the rows of `wanted` identities, in their shape, and which of them are in the table.

    The row of one that is not there is some row of the table (0 if it has none).
    """
    numbers = np.asarray(wanted, np.int64)
    if not len(identities):
        return np.zeros(numbers.shape, np.intp), np.zeros(numbers.shape, np.bool_)
    place = np.minimum(np.searchsorted(identities, numbers), len(identities) - 1)
    return place, np.asarray(identities[place] == numbers)


def places_of(identities: Identities, wanted: ArrayLike) -> Places:
    """Return the rows of `wanted` identities, in their shape; a `KeyError` if one is not in the table."""
    place, is_there = find(identities, wanted)
    if not is_there.all():
        missing = np.asarray(wanted)[~is_there].flat[0]
        raise KeyError(f"{missing}: not in the table of {len(identities)} identities")
    return place


def union(one: Identities, other: Identities) -> tuple[Identities, Places, Places]:
    """Return the identities of both tables, and the rows of either table's among them."""
    both = np.union1d(one, other)
    return both, np.searchsorted(both, one), np.searchsorted(both, other)


def common(one: Identities, other: Identities) -> tuple[Identities, Places, Places]:
    """Return the identities that are in both tables, and their rows in either table."""
    both, here, there = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    return both, here, there


@dataclass(frozen=True, eq=False)
class Turnover:
    """What becomes of a table when some things end and others begin.

    Parameters
    ----------
    identities
        `(m,)` after it, increasing.
    kept
        `(n,)` bool: which rows of the table before it stay.
    order
        `(m,)`: rows after it, among those that stay followed by those of the new things.
    """

    identities: Identities
    kept: NDArray[np.bool_]
    order: Places

    @classmethod
    def between(cls, identities: Identities, kept: NDArray[np.bool_], new: ArrayLike) -> Self:
        """Return the turnover of a table of which the `kept` `(n,)` stay and `new` ones begin.

        A `ValueError`, if a new one is there already, or comes twice.
        """
        numbers = np.concatenate([identities[kept], np.asarray(new, np.int64)])
        order = np.argsort(numbers, kind="stable")
        after = numbers[order]
        twice = after[1:][after[1:] == after[:-1]]
        if len(twice):
            raise ValueError(f"identities: got {twice[0]} twice, expected each once")
        return cls(after, kept, order)

    def rows(self, before: RowArray, new: ArrayLike) -> RowArray:
        """Return the rows after it, from those before it and those of the new things (or one for all)."""
        count = len(self.order) - int(np.count_nonzero(self.kept))
        begun = np.broadcast_to(np.asarray(new, before.dtype), (count, *before.shape[1:]))
        after: RowArray = np.concatenate([before[self.kept], begun])[self.order]  # type: ignore[assignment]
        return after

"""A few evenly spaced items of a row of any length."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


def evenly_spread(count: int, most: int) -> list[int]:
    """At most so many of the numbers below `count`, evenly spread."""
    return [round(number) for number in np.linspace(0, count - 1, min(count, most)).tolist()]


@dataclass
class EvenlySpaced(Generic[T]):
    """At most so many items: whenever there are more, every second one goes and the distance doubles.

    `kept` are the items so far, of `count` places in the row; they are `stride` places apart, and the next
    place of which one is kept is `due`. `most` is an even number.
    """

    most: int
    kept: list[T] = field(default_factory=list)
    count: int = 0
    stride: int = 1
    due: int = 0

    def add(self, make: Callable[[], T] | None) -> None:
        """Go on to the next place; `make` is called if its item is kept, `None` where there is none."""
        if make is not None and self.count >= self.due:
            self.kept.append(make())
            if len(self.kept) > self.most:
                del self.kept[1::2]
                self.stride *= 2
            self.due = self.count + self.stride
        self.count += 1

"""Bounds of parameters, declared by name and checked where an object is made."""

from collections.abc import Callable
from typing import Any

Bound = tuple[Callable[[Any], bool], str]
"""What holds for a value, and how that is said."""

POSITIVE: Bound = (lambda value: value > 0, "more than 0")
NOT_NEGATIVE: Bound = (lambda value: value >= 0, "0 or more")
PROBABILITY: Bound = (lambda value: 0 < value < 1, "a probability between 0 and 1")
SHARE: Bound = (lambda value: 0 < value < 1, "a share between 0 and 1")


def check_bounds(owner: object, bounds: dict[str, Bound]) -> None:
    """Raise a `ValueError` that names the first attribute out of bounds: what came, what was expected."""
    for name, (holds, expected) in bounds.items():
        value = getattr(owner, name)
        if not holds(value):
            raise ValueError(f"{name}: got {value}, expected {expected}")

"""Declared checks name the parameter, what came and what was expected."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.core.checks import (
    Positive,
    PositiveOrInfinite,
    Shape,
    Share,
    SizesOf,
    at_least,
    between,
    checked,
)

Floats = NDArray[np.float64]


@checked
@dataclass(frozen=True)
class Settings:
    time: Positive = 1.0
    count: Annotated[int, at_least(2)] = 3
    title: str | None = None
    kind: Literal["fast", "exact"] = "fast"
    place: tuple[float, float] = (0.0, 0.0)
    weight: Callable[[float], float] = abs
    numbers: Sequence[int] = ()
    limit: PositiveOrInfinite | None = 3.0
    path: str | Path = "a"
    gain: Annotated[float, between(0, 1)] | Literal["learned"] = 0.5
    part: Share = 0.5
    is_new: bool = True


@checked
def distances(
    points: Annotated[Floats, Shape("n", 2)],
    others: Annotated[Floats, Shape("n", 2)],
    image: NDArray[np.uint8] | None = None,
    stack: Annotated[Floats, Shape(..., 3)] | None = None,
) -> float:
    return float(np.hypot(*(points - others).T).sum())


@checked
def first_frame(rows: NDArray[np.void] | NDArray[np.float64]) -> float:
    return float(rows["frame"][0])


@pytest.mark.parametrize(
    ("name", "value", "error", "message"),
    [
        ("time", 0, ValueError, "time: got 0, expected more than 0"),
        ("time", "x", TypeError, "time: got 'x', expected a number"),
        ("time", np.nan, ValueError, "time: got nan, expected a finite number"),
        ("time", np.inf, ValueError, "time: got inf, expected a finite number"),
        ("time", True, TypeError, "time: got True, expected a number"),
        ("count", 1, ValueError, "count: got 1, expected 2 or more"),
        ("count", 2.5, TypeError, "count: got 2.5, expected a whole number"),
        ("title", 3, TypeError, "title: got 3, expected a text or None"),
        ("kind", "slow", ValueError, "kind: got 'slow', expected 'fast' or 'exact'"),
        ("place", (1,), TypeError, "place: got (1,), expected 2 values"),
        ("place", (1, "a"), TypeError, "place[1]: got 'a', expected a number"),
        ("weight", 3, TypeError, "weight: got 3, expected a function"),
        ("numbers", ["a"], TypeError, "numbers[0]: got 'a', expected a whole number"),
        ("numbers", "12", TypeError, "numbers: got '12', expected a sequence"),
        ("limit", -1, ValueError, "limit: got -1, expected more than 0"),
        ("limit", np.nan, ValueError, "limit: got nan, expected a number"),
        ("path", 3, TypeError, "path: got 3, expected a text or a Path"),
        ("gain", "learn", ValueError, "gain: got 'learn', expected 'learned'"),
        ("gain", 2, ValueError, "gain: got 2, expected 0 to 1"),
        ("part", 1, ValueError, "part: got 1, expected a share between 0 and 1"),
        ("is_new", 1, TypeError, "is_new: got 1, expected True or False"),
    ],
)
def test_a_wrong_value_is_named(name: str, value: object, error: type[Exception], message: str) -> None:
    arguments: dict[str, Any] = {name: value}
    with pytest.raises(error) as caught:
        Settings(**arguments)
    assert str(caught.value) == message
    with pytest.raises(error):
        replace(Settings(), **arguments)


def test_what_is_right_is_taken() -> None:
    made = Settings(np.float32(2), np.int64(4), limit=np.inf, numbers=[1], path=Path("b"), gain="learned")
    assert (made.time, made.count, made.limit, made.gain) == (2, 4, np.inf, "learned")
    assert first_frame(np.zeros(2, [("frame", int)])) == 0
    assert distances(np.zeros((3, 2)), np.ones((3, 2)), stack=np.zeros((5, 4, 3))) == pytest.approx(
        3 * 2**0.5
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": np.zeros((3, 3))}, "points: got shape (3, 3), expected shape (n, 2) with n = 3"),
        ({"points": np.zeros((4, 2))}, "others: got shape (3, 2), expected shape (n, 2) with n = 4"),
        ({"points": np.full((3, 2), np.nan)}, "points: got NaN or infinity, expected finite numbers"),
        ({"points": [[1, 2]]}, "points: got [[1, 2]], expected an array of float64"),
        (
            {"image": np.zeros((3, 3))},
            "image: got an array of float64 of shape (3, 3), expected an array of uint8 or None",
        ),
        ({"stack": np.zeros(2)}, "stack: got shape (2,), expected shape (..., 3) with n = 3"),
    ],
)
def test_a_wrong_array_is_named(arguments: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"points": np.zeros((3, 2)), "others": np.zeros((3, 2))} | arguments
    with pytest.raises((TypeError, ValueError)) as caught:
        distances(**given)
    assert str(caught.value) == message


@checked
def pixels(
    size: Annotated[tuple[int, ...], SizesOf("height", "width", "channels")],
    flat: Annotated[Floats, Shape("height * width")],
    again: Annotated[tuple[int, int] | None, SizesOf("height", "width")] = None,
) -> int:
    return len(flat)


def test_sizes_are_named_by_a_tuple() -> None:
    assert pixels((2, 3), np.zeros(6)) == pixels((2, 3, 3), np.zeros(6), (2, 3)) == 6
    with pytest.raises(ValueError, match=r"flat: got shape \(5,\), expected shape \(height \* width,\) with"):
        pixels((2, 3), np.zeros(5))
    with pytest.raises(ValueError, match=r"again: got \(2, 4\), expected width = 3"):
        pixels((2, 3), np.zeros(6), (2, 4))
    with pytest.raises(ValueError, match=r"size: got \(-2, -3\), expected sizes from 0"):
        pixels((-2, -3), np.zeros(6))

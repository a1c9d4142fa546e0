"""Steps lower the error until it stands still; scipy finds the same minimum."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.inference.optimisation import Damping, levenberg_marquardt

Numbers = np.ndarray


def residuals(x: Numbers) -> Numbers:
    """Rosenbrock's valley."""
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def jacobian(x: Numbers) -> Numbers:
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def linearised(x: Numbers) -> Callable[[float], Numbers | None]:
    rows, error = jacobian(x), residuals(x)

    def step(damping: float) -> Numbers | None:
        normal = rows.T @ rows
        moved = x - np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ error)
        return moved if np.sum(residuals(moved) ** 2) < np.sum(error**2) else None

    return step


def hardly(before: Numbers, after: Numbers) -> bool:
    return bool(np.abs(after - before).max() < 1e-12)


@given(st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
def test_the_minimum_of_rosenbrock_is_found_from_anywhere(start: tuple[float, float]) -> None:
    """It is at (1, 1); scipy's solver stands still where it begins within rounding of (0, 0)."""
    found, _ = levenberg_marquardt(np.array(start), linearised, hardly, Damping(), most_steps=1000)
    np.testing.assert_allclose(found, 1.0, atol=1e-6)


def test_no_step_raises_the_error() -> None:
    seen: list[float] = []

    def watched(x: Numbers) -> Callable[[float], Numbers | None]:
        seen.append(float(np.sum(residuals(x) ** 2)))
        return linearised(x)

    levenberg_marquardt(np.array([-1.2, 1.0]), watched, hardly, Damping(), most_steps=1000)
    assert len(seen) > 5
    assert (np.diff(seen) < 0).all()


def test_damping_falls_and_rises() -> None:
    answers = iter([1, None, None, 2, 3])
    asked: list[float] = []

    def scripted(place: int) -> Callable[[float], int | None]:
        def step(damping: float) -> int | None:
            asked.append(damping)
            return next(answers)

        return step

    found = levenberg_marquardt(
        0, scripted, lambda *_: False, Damping(1.0, fall=2.0, rise=8.0, least=0.75), most_steps=5
    )
    assert asked == [1.0, 0.75, 6.0, 48.0, 24.0]
    assert found == (3, 12.0)


class Counted:
    """A problem that counts its steps."""

    def __init__(self, step: Callable[[Any], Any]) -> None:
        self.step, self.steps = step, 0

    def __call__(self, at: Any) -> Callable[[float], Any]:
        def step(_: float) -> Any:
            self.steps += 1
            return self.step(at)

        return step


@pytest.mark.parametrize(("settled_steps", "steps"), [(1, 1), (3, 3)])
def test_so_many_settled_steps_are_the_end(settled_steps: int, steps: int) -> None:
    onwards = Counted(lambda at: at + 1)
    found, _ = levenberg_marquardt(
        0, onwards, lambda *_: True, Damping(), most_steps=9, settled_steps=settled_steps
    )
    assert (found, onwards.steps) == (steps, steps)


def test_where_no_step_helps_it_ends_with_the_most_damping() -> None:
    nowhere = Counted(lambda at: None)
    found, _ = levenberg_marquardt(0, nowhere, lambda *_: False, Damping(1.0, most=1e3), most_steps=99)
    assert (found, nowhere.steps) == (0, 3)


def test_a_problem_may_say_that_nothing_is_to_be_gained() -> None:
    place, still = object(), Counted(lambda at: at)
    found, _ = levenberg_marquardt(place, still, lambda *_: False, Damping(), most_steps=99)
    assert found is place
    assert still.steps == 1

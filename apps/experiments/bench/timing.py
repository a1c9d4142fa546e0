"""Times of methods that take turns, and how sure what follows from them is."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence

from ...reports.expectations import Expectation, over_seeds

Judge = Callable[[dict[str, float]], Sequence[Expectation]]
"""What seconds a call of each method mean."""

Spent = dict[str, list[float]]
"""By method, median seconds of a call in each round."""


def in_turns(methods: Mapping[str, Callable[[], object]], rounds: int, turn: int = 1) -> Spent:
    """Time methods that take turns of `turn` calls; a round before these warms up."""
    spent: Spent = {name: [] for name in methods}
    for _ in range(rounds + 1):
        for name, method in methods.items():
            calls = []
            for _ in range(turn):
                started = time.perf_counter()
                method()
                calls.append(time.perf_counter() - started)
            spent[name].append(statistics.median(calls))
    return {name: values[1:] for name, values in spent.items()}


def medians(spent: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Seconds of a call, the median over the rounds."""
    return {name: statistics.median(values) for name, values in spent.items()}


def over_rounds(
    judge: Callable[[dict[str, float]], Sequence[Expectation]], spent: Spent
) -> list[Expectation]:
    """What is judged of the medians, with the standard errors that the choice of rounds brings."""
    return over_seeds(lambda drawn: judge(medians(drawn)), spent)

"""What is wanted beside what was measured, as a table, and how sure that is."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..evaluation.text_tables import rounded

DRAWS = 200
"""How often seeds are drawn again; standard errors are then known to 5 %."""


@dataclass(frozen=True)
class Expectation:
    """A number and the bound that it should keep.

    Parameters
    ----------
    what
        is measured, with its unit.
    measured
        its value.
    relation, bound
        what is wanted of it; `None` where nothing is, and the value only informs.
    spread, seeds
        standard error of the value, and the number of seeds that it comes from; NaN where there is but one.
        Of speeds, the seeds are rounds.
    quartiles
        of speeds, between which half of the rounds lie; the value is their median.
    ratio
        whether it stays the same on a machine that does everything twice as fast.
    loaded
        whether other processes ran meanwhile, so that a speed says little.
    """

    what: str
    measured: float
    relation: Literal["<=", ">="] = "<="
    bound: float | None = None
    spread: float = math.nan
    seeds: int = 1
    quartiles: tuple[float, float] | None = None
    ratio: bool = False
    loaded: bool = False

    @property
    def verdict(self) -> str:
        """`"pass"`, `"short"`, or nothing where nothing is wanted; NaN is short."""
        if self.bound is None:
            return ""
        holds = self.measured <= self.bound if self.relation == "<=" else self.measured >= self.bound
        return "pass" if holds else "short"

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """What, wanted, measured, its standard error or quartiles, verdict."""
        wanted = "" if self.bound is None else f"{self.relation} {self.bound:g}"
        error = "" if math.isnan(self.spread) else rounded(self.spread, 2)
        if self.quartiles is not None:
            error = "–".join(map(rounded, self.quartiles))
        return self.what, wanted, rounded(self.measured), error, self.verdict


HEADER = ("measure", "wanted", "measured", "±", "")


def over_seeds(judge: Callable[[Any], Sequence[Expectation]], found: Mapping[Any, Any]) -> list[Expectation]:
    """What is judged of all seeds, with the standard errors that the choice of seeds brings.

    Seeds are drawn again from those there are (the bootstrap of Efron, 1979), the same for all methods, so
    ratios of methods keep what they have in common.

    Parameters
    ----------
    judge
        gives the expectations of what was found, always in the same order.
    found
        mappings, of mappings perhaps, of lists with a value a seed; lists of one value stay as they are.
    """
    n_seeds = max(map(len, _lists(found)))
    judged = list(judge(found))
    if n_seeds == 1:
        return judged
    random = np.random.default_rng(0)
    draws = [judge(_drawn(found, random.integers(0, n_seeds, n_seeds).tolist())) for _ in range(DRAWS)]
    return [
        replace(each, spread=_deviation([draw[place].measured for draw in draws]), seeds=n_seeds)
        for place, each in enumerate(judged)
    ]


def _deviation(values: Sequence[float]) -> float:
    """Standard deviation of those values that are finite; NaN of fewer than two."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.std(finite, ddof=1)) if len(finite) > 1 else math.nan


def _lists(found: Mapping[Any, Any]) -> Iterable[Sequence[Any]]:
    for value in found.values():
        if isinstance(value, Mapping):
            yield from _lists(value)
        else:
            yield value


def _drawn(found: Any, seeds: Sequence[int]) -> Any:
    if isinstance(found, Mapping):
        return {name: _drawn(value, seeds) for name, value in found.items()}
    return found if len(found) == 1 else [found[seed] for seed in seeds]

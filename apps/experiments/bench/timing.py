"""Times of methods that take turns, of single chains, and what follows from them round by round."""

import math
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ....inference import MultiChain, RecursiveBP, RunState
from ....models.core.frame import Frame
from ..record import Expectation

Judge = Callable[[dict[Any, float]], Sequence[Expectation]]  # what seconds a call of each method mean
Spent = dict[Any, list[float]]  # by method, median seconds of a call in each round
ROUNDS = 8  # at least seven of them should count, or quartiles mean little


def in_turns(methods: Mapping[Any, Callable[[], object]], rounds: int = ROUNDS, turn: int = 1) -> Spent:
    """Time methods that take turns of `turn` calls; a round before these warms up.

    Every other round goes from the last method to the first, so that none always has the same one before it.
    """
    spent: Spent = {name: [] for name in methods}
    for number in range(rounds + 1):
        for name in list(methods)[:: -1 if number % 2 else 1]:
            calls = []
            for _ in range(turn):
                started = time.perf_counter()
                methods[name]()
                calls.append(time.perf_counter() - started)
            spent[name].append(statistics.median(calls))
    return {name: values[1:] for name, values in spent.items()}


def over_frames(
    steps: Mapping[Any, Callable[[Frame], object]], frames: Sequence[Frame], turn: int, warm_up: int
) -> Spent:
    """Return mean seconds a frame in each turn of several methods, each of which takes all frames in order.

    They take turns of `turn` frames; the first `warm_up` frames do not count.
    """
    spent: Spent = {name: [] for name in steps}
    edges = [*range(0, len(frames), turn), len(frames)]
    for number, (first, end) in enumerate(pairwise(edges)):
        for name in list(steps)[:: -1 if number % 2 else 1]:
            started = time.perf_counter()
            for frame in frames[first:end]:
                steps[name](frame)
            spent[name].append((time.perf_counter() - started) / (end - first))
    return {name: values[-(-warm_up // turn) :] for name, values in spent.items()}


def over_rounds(judge: Judge, spent: Spent) -> list[Expectation]:
    """Return the medians, with quartiles, of what is judged of each round's seconds by itself.

    A ratio is one of times that were taken right after each other, so that it does not suffer where the
    machine slows down for both. `judge` always gives its expectations in the same order.
    """
    rounds = [dict(zip(spent, seconds, strict=True)) for seconds in zip(*spent.values(), strict=True)]
    on_another_machine = judge({name: 2 * second for name, second in rounds[0].items()})
    found = []
    for *of_rounds, elsewhere in zip(*map(judge, rounds), on_another_machine, strict=True):
        values = [each.measured for each in of_rounds]
        low, middle, high = np.percentile(values, (25, 50, 75)).tolist()
        ratio = math.isclose(values[0], elsewhere.measured, rel_tol=1e-9)
        found.append(
            replace(of_rounds[0], measured=middle, quartiles=(low, high), ratio=ratio, seeds=len(values))
        )
    return found


class _Timed:
    """A chain or feature that notes how long its methods take."""

    def __init__(self, node: Any, spent: dict[str, float]) -> None:
        self._node, self._spent, self.name = node, spent, node.name

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return self._node.__class__  # ports tell nodes by their class

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._node, name)
        if name not in ("predict", "message", "update", "evidence"):
            return value

        def timed(*arguments: Any) -> Any:
            started, before = time.perf_counter(), sum(self._spent.values())
            try:
                return value(*arguments)
            finally:
                # without what others were asked for meanwhile: messages are worked out when they are read
                own = time.perf_counter() - started - (sum(self._spent.values()) - before)
                self._spent[self.name] = self._spent.get(self.name, 0.0) + own

        return timed


def of_chains(model: MultiChain, frames: Iterable[Frame]) -> tuple[list[dict[str, float]], RunState]:
    """Return seconds of chains and features in every frame, by name, `whole` the sum; and the last state."""
    spent: dict[str, float] = {}
    nodes = {name: _Timed(node, spent) for name, node in {**model.chains, **model.features}.items()}
    same = MultiChain()
    for name in model.chains:
        for feature in model.features_of[name]:
            same.connect(nodes[name], nodes[feature], feedback=name in model.senders[feature])
    engine, state, found = RecursiveBP(same), RunState(), []
    for frame in frames:
        spent.clear()
        started = time.perf_counter()
        state = engine.step(state, frame).state
        found.append({**spent, "whole": time.perf_counter() - started})
    return found, state

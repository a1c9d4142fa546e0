"""Where the time of a frame goes, and what a model keeps."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from ....inference import MultiChain, RecursiveBP, RunState
from ....models import Frame

STEPS = ("predict", "message", "update", "evidence")


class Timed:
    """A chain or feature that notes how long each of its methods takes."""

    def __init__(self, node: Any, spent: dict[str, float]) -> None:
        self._node = node
        self._spent = spent
        self.name = node.name

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return self._node.__class__  # ports tell nodes by their class

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._node, name)
        if name not in STEPS:
            return value

        def timed(*arguments: Any) -> Any:
            started, before = time.perf_counter(), sum(self._spent.values())
            try:
                return value(*arguments)
            finally:
                key = f"{self.name}: {name}"
                # without what others were asked for meanwhile: messages are worked out when they are read
                own = time.perf_counter() - started - (sum(self._spent.values()) - before)
                self._spent[key] = self._spent.get(key, 0.0) + own

        return timed


def timed(model: MultiChain) -> tuple[MultiChain, dict[str, float]]:
    """The same model, and seconds that its chains and features have taken so far, by name and method."""
    spent: dict[str, float] = {}
    nodes = {name: Timed(node, spent) for name, node in {**model.chains, **model.features}.items()}
    same = MultiChain()
    for name in model.chains:
        for feature in model.features_of(name):
            same.connect(nodes[name], nodes[feature], feedback=name in model.senders(feature))
    return same, spent


def stages(model: MultiChain, frames: Sequence[Frame]) -> tuple[list[dict[str, float]], RunState]:
    """Seconds of each stage of the background application in every frame, mask included, and the last state.

    `whole` is all of it.
    """
    same, spent = timed(model)
    engine, state, found = RecursiveBP(same), RunState(), []
    for frame in frames:
        spent.clear()
        started = time.perf_counter()
        belief = engine.step(state, frame)
        state = belief.state
        stepped = time.perf_counter()
        belief["pixels"].foreground()
        ended = time.perf_counter()
        spent["mask"] = ended - stepped
        rest = stepped - started - sum(value for name, value in spent.items() if name != "mask")
        found.append({**spent, "engine and the rest": rest, "whole": ended - started})
    return found, state


def of_chain(name: str, stages_of_frame: Mapping[str, float]) -> float:
    """Seconds that a chain took in a frame."""
    return sum(seconds for stage, seconds in stages_of_frame.items() if stage.startswith(f"{name}: "))


def shares(found: Sequence[Mapping[str, float]]) -> list[tuple[str, float, float]]:
    """Stage, mean ms a frame, and share of the whole, %."""
    names = {name: None for each in found for name in each}
    mean = {name: float(np.mean([each.get(name, 0.0) for each in found])) for name in names}
    whole = mean.pop("whole")
    return [(name, 1e3 * value, 100 * value / whole) for name, value in mean.items()]


def n_bytes(value: Any) -> int:
    """Bytes of all arrays in a tree of dataclasses and collections."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if is_dataclass(value) and not isinstance(value, type):
        return sum(n_bytes(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping):
        return sum(map(n_bytes, value.values()))
    return sum(map(n_bytes, value)) if isinstance(value, list | tuple) else 0

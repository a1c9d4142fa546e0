"""What somebody can get hold of from models, beliefs and solutions."""

import dataclasses
import inspect
from collections.abc import Iterator
from typing import Any, get_args, get_origin, get_type_hints

import rsmcm.chains
import rsmcm.inference
import rsmcm.models


def reachable_classes() -> set[type]:
    """Public classes of the three packages, the states, messages and trajectories they give, and fields."""
    found: set[type] = set()
    waiting: list[Any] = [
        getattr(package, name)
        for package in (rsmcm.models, rsmcm.inference, rsmcm.chains)
        for name in package.__all__
    ]
    while waiting:
        hint = waiting.pop()
        waiting += get_args(hint)
        kind = get_origin(hint) or hint
        if inspect.isclass(kind) and kind.__module__.startswith("rsmcm") and kind not in found:
            found.add(kind)
            waiting += _mentioned(kind)
    return found


def _mentioned(kind: type) -> Iterator[Any]:
    if dataclasses.is_dataclass(kind):
        yield from get_type_hints(kind).values()
    for method in ("initial", "smooth", "uniform", "evidence"):
        if hasattr(kind, method):
            yield get_type_hints(getattr(kind, method)).get("return")

"""Work of experiments in this process."""

from collections.abc import Callable
from typing import Any

import pytest
from rsmcm.apps.experiments import experiment, pets


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have work in parallel done here, one task after the other."""

    def in_turn(label: str, work: list[tuple[Callable[..., Any], tuple[Any, ...]]]) -> list[Any]:
        return [function(*arguments) for function, arguments in work]

    for module in (experiment, pets):
        monkeypatch.setattr(module, "in_parallel", in_turn)

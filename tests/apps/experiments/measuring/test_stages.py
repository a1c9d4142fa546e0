"""Stages add up, and bytes are counted wherever arrays lie."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.background.application import build_model
from rsmcm.apps.experiments.measuring.stages import n_bytes, of_chain, shares, stages
from rsmcm.apps.scenes import sleeping_man


def test_stages_add_up_to_the_whole() -> None:
    found, state = stages(build_model(), list(sleeping_man(6, size=(96, 72))))
    assert len(found) == 6
    assert n_bytes(state.states["background"]) > 10 * 96 * 72
    for each in found:
        whole = each["whole"]
        assert sum(seconds for name, seconds in each.items() if name != "whole") == pytest.approx(whole)
    rows = shares(found)
    assert {"background: message", "blobs: update", "mask"} <= {name for name, _, _ in rows}
    assert sum(share for _, _, share in rows) == pytest.approx(100)
    assert of_chain("a", {"a: predict": 1.0, "a: update": 2.0, "ab: predict": 4.0, "whole": 8.0}) == 3.0


@dataclass
class _Tree:
    own: NDArray[np.float32]
    parts: list[tuple[NDArray[np.uint8], str]]
    named: dict[str, "_Tree"] = field(default_factory=dict)
    number: float = 0.0


def test_bytes_of_a_tree() -> None:
    leaf = _Tree(np.zeros((2, 3), np.float32), [(np.zeros(5, np.uint8), "five")])
    assert n_bytes(leaf) == 24 + 5
    assert n_bytes(_Tree(np.zeros(0, np.float32), [], {"leaf": leaf})) == 29

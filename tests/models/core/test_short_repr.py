"""Everything prints itself in a line."""

import numpy as np
import pytest
from rsmcm.inference import MultiChain, RecursiveBP, RunState
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.core.short_repr import brief

from ...support.discrete import random_model

LONGEST = 250


def test_a_filter_and_all_that_it_gives() -> None:
    whole = random_model(np.random.default_rng(0), [("a", "f"), ("b", "f")])
    model = MultiChain().connect(whole.chains["a"], whole.features["f"])
    model.connect(whole.chains["b"], whole.features["f"], feedback=False)
    assert repr(model) == "MultiChain(a -- f, b <- f)"
    engine = RecursiveBP(model)
    *_, belief = engine.run([np.zeros((1, 64), np.uint8)] * 2)
    assert repr(belief) == "Belief(frame 2 at 0.04 s: a, b on f)"
    for value in (engine, belief.state, *belief.states.values(), belief["f"], belief.frame):
        assert len(repr(value)) <= LONGEST
    assert repr(belief.frame) == "Frame(image=uint8 (1, 64), time=0.04, number=2)"
    assert repr(RunState()) == "RunState()"
    missing = engine.step(RunState(), Frame(None, 0.0, 1))
    assert repr(missing) == "Belief(frame 1 at 0 s, missing: nothing yet)"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array([1.0, 0.25]), "[1. , 0.25]"),
        (np.zeros((3, 4)), "float64 (3, 4)"),
        ((1, 2), "(1, 2)"),
        (tuple(range(9)), "[9 int]"),
        ([PixelLabels()], "[1 PixelLabels]"),
        ({"one": PixelLabels()}, "{one: PixelLabels(...)}"),
        (
            dict.fromkeys(["background", "blobs", "ground"], PixelLabels()),
            "{background, blobs, ground}",
        ),
        (1 / 3, "0.333333"),
        (PixelLabels, "PixelLabels"),
        ("x" * 100, "str(...)"),
    ],
)
def test_brief(value: object, text: str) -> None:
    assert brief(value) == text

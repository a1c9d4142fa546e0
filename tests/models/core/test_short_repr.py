"""Everything prints itself in a line."""

import dataclasses

import numpy as np
import pytest
from rsmcm.chains import AdaptiveBackground, BlobTracker, FactorStructure
from rsmcm.inference import CoordinateAscent, MultiChain, RecursiveBP, RunState
from rsmcm.models import Frame, PixelLabels, PointTracks
from rsmcm.models.core.frame import GivenPoints
from rsmcm.models.core.short_repr import brief

from ...support.reachable import reachable_classes

LONGEST = 250


@pytest.mark.parametrize(
    "kind",
    sorted(filter(dataclasses.is_dataclass, reachable_classes()), key=str),
    ids=lambda kind: kind.__name__,
)
def test_whatever_somebody_gets_hold_of_is_short(kind: type) -> None:
    big = np.random.default_rng(0).normal(size=(40, 30))
    value = object.__new__(kind)
    for field in dataclasses.fields(kind):
        object.__setattr__(value, field.name, big)
    text = repr(value)
    assert text.startswith(kind.__name__)
    assert len(text) <= LONGEST
    assert "\n" not in text


def test_a_filter_and_all_that_it_gives() -> None:
    random = np.random.default_rng(0)
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels, feedback=False)
    assert repr(model) == "MultiChain(background -- pixels, blobs <- pixels)"
    engine = RecursiveBP(model)
    *_, belief = engine.run([random.integers(0, 255, (48, 64), np.uint8) for _ in range(2)])
    assert repr(belief) == "Belief(frame 2 at 0.04 s: background, blobs on pixels)"
    for value in (engine, belief.state, *belief.states.values(), belief[pixels], belief.frame):
        assert len(repr(value)) <= LONGEST
    assert repr(belief.frame) == "Frame(image=uint8 (48, 64), time=0.04, number=2)"
    assert repr(RunState()) == "RunState()"
    assert (
        repr(engine.step(RunState(), Frame(None, 0.0, 1))) == "Belief(frame 1 at 0 s, missing: nothing yet)"
    )


def test_a_solution() -> None:
    random = np.random.default_rng(0)
    shape = random.normal(size=(12, 3))
    frames = [
        Frame(None, t / 25, t + 1, GivenPoints(shape @ random.normal(size=(3, 2)), np.arange(12)))
        for t in range(8)
    ]
    points = PointTracks(noise=0.01)
    solution = CoordinateAscent(MultiChain().connect(FactorStructure(), points)).run(frames)
    assert repr(solution).startswith("Solution(8 frames, ")
    assert repr(solution).endswith("converged: structure on points)")
    for value in (solution["structure"], solution[points][0]):
        assert len(repr(value)) <= LONGEST


def test_parameters_show_where_they_were_set() -> None:
    assert repr(PixelLabels()) == "PixelLabels()"
    assert repr(PixelLabels("left")) == "PixelLabels(name='left')"


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

"""The page on writing a chain runs as printed and shows what it says."""

from pathlib import Path
from typing import Any

import pytest
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

from ..support import pages

PAGE = pages.ROOT / "docs" / "own-chain.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Names that the code blocks define; what they print is what the page shows."""
    return pages.Reader(PAGE).read().names


def test_three_outputs_are_shown() -> None:
    assert [block.language for block in pages.blocks(PAGE)].count("output") == 3


def test_background_behind_an_open_door_stays(page: dict[str, Any]) -> None:
    assert page["with_door"] < 5
    assert page["with_simple_door"] < 5
    assert page["alone"] > 100


def test_closed_hours_are_left_to_the_others(page: dict[str, Any]) -> None:
    assert page["same"]
    assert page["night_alone"] == page["night_with_door"]
    state = page["DoorState"](clock=3 * 3600.0, open=0.0)
    message = page["door"].message(state, PixelLabels(), {})
    assert not message.layers
    assert message.background is None


def test_chains_are_short() -> None:
    blocks = [block.text for block in pages.blocks(PAGE) if block.language == "python"]

    def lines(block: str, first: str) -> int:
        counted = [line for line in block.splitlines() if line.strip() and "import" not in line]
        return len(counted[next(n for n, line in enumerate(counted) if line.startswith(first)) :])

    assert lines(blocks[0], "region = ") <= 15
    assert lines(blocks[1], "walkers = ") <= 8
    assert lines(blocks[2], "@dataclass") <= 40


def test_cut_edge_leaves_the_background_alone(page: dict[str, Any]) -> None:
    pixels = PixelLabels()
    model = MultiChain().connect(page["AdaptiveBackground"](follow_light=False), pixels)
    model.connect(page["door"], pixels, feedback=False)
    *_, last = RecursiveBP(model).run(list(page["film"](9 * 3600))[:250])
    assert abs(last["background"].picture().astype(float) - page["street"])[40:68, 70:86].mean() > 100


def test_state_is_saved_as_it_is(page: dict[str, Any], tmp_path: Path) -> None:
    pixels = PixelLabels()
    engine = RecursiveBP(
        MultiChain()
        .connect(page["AdaptiveBackground"](follow_light=False), pixels)
        .connect(page["door"], pixels)
    )
    *_, last = engine.run(list(page["film"](9 * 3600))[:60])
    engine.save(tmp_path / "state.npz", last.state)
    state, _ = engine.load(tmp_path / "state.npz")
    assert state.states["door"] == last["door"]

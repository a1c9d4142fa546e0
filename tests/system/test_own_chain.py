"""The page on writing a chain runs as printed and shows what it says."""

from typing import Any

import pytest
from rsmcm.models import PixelLabels

from ..support import pages

PAGE = pages.ROOT / "docs" / "own-chain.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Names that the code blocks define; what they print is what the page shows."""
    return pages.Reader(PAGE).read().names


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

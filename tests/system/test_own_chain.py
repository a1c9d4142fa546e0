"""The page on writing a chain runs as printed and shows what it says."""

import re
from pathlib import Path
from typing import Any

import pytest
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

PAGE = Path(__file__).parents[2] / "docs" / "own-chain.md"


@pytest.fixture(scope="module")
def page() -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Names that the code blocks define, and what each block printed beside what the page prints."""
    text = PAGE.read_text()
    names: dict[str, Any] = {"__name__": "own_chain"}
    outputs: list[tuple[str, str]] = []
    for block, rest in re.findall(r"```python\n(.*?)```\n(.*?)(?=```python|\Z)", text, re.DOTALL):
        printed: list[str] = []
        names["print"] = lambda line, printed=printed: printed.append(str(line))
        exec(compile(block, str(PAGE), "exec"), names)  # the page's own code
        shown = [line[4:] for line in rest.splitlines() if line.startswith("    ")]
        outputs.append(("\n".join(printed), "\n".join(shown)))
    return names, outputs


def test_output_is_what_the_page_shows(page: tuple[dict[str, Any], list[tuple[str, str]]]) -> None:
    """Words as they are, numbers to 20 % (or 2 grey levels): other machines round otherwise."""
    number = r"\d+(?:\.\d+)?"
    assert sum(bool(shown) for _, shown in page[1]) == 3
    for printed, shown in page[1]:
        assert re.sub(number, "#", printed) == re.sub(number, "#", shown)
        found, expected = (list(map(float, re.findall(number, text))) for text in (printed, shown))
        assert found == pytest.approx(expected, rel=0.2, abs=2 if "grey levels" in shown else 0.05)


def test_background_behind_an_open_door_stays(page: tuple[dict[str, Any], list[tuple[str, str]]]) -> None:
    names, _ = page
    assert names["with_door"] < 5
    assert names["alone"] > 100


def test_closed_hours_are_left_to_the_others(page: tuple[dict[str, Any], list[tuple[str, str]]]) -> None:
    names, _ = page
    assert names["same"]
    assert names["night_alone"] == names["night_with_door"]
    state = names["DoorState"](clock=3 * 3600.0, open=0.0)
    message = names["door"].message(state, PixelLabels(), {})
    assert not message.layers
    assert message.background is None


def test_the_chain_is_forty_lines_and_knows_nothing_private() -> None:
    block = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert block is not None
    assert len([line for line in block[1].splitlines() if line.strip()]) <= 40
    assert not re.search(r"\b_\w|/ 20\b(?!,|\))", block[1])


def test_cut_edge_leaves_the_background_alone(page: tuple[dict[str, Any], list[tuple[str, str]]]) -> None:
    names, _ = page
    pixels = PixelLabels()
    model = MultiChain().connect(names["AdaptiveBackground"](follow_light=False), pixels)
    model.connect(names["door"], pixels, feedback=False)
    *_, last = RecursiveBP(model).run(list(names["film"](9 * 3600))[:250])
    assert abs(last["background"].picture().astype(float) - names["street"])[40:68, 70:86].mean() > 100


def test_state_is_saved_as_it_is(page: tuple[dict[str, Any], list[tuple[str, str]]], tmp_path: Path) -> None:
    names, _ = page
    pixels = PixelLabels()
    engine = RecursiveBP(
        MultiChain()
        .connect(names["AdaptiveBackground"](follow_light=False), pixels)
        .connect(names["door"], pixels)
    )
    *_, last = engine.run(list(names["film"](9 * 3600))[:60])
    engine.save(tmp_path / "state.npz", last.state)
    state, _ = engine.load(tmp_path / "state.npz")
    assert state.states["door"] == last["door"]

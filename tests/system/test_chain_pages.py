"""Every public chain has a page, and what its tables say of features, parameters and code is so."""

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
import rsmcm.chains
from rsmcm.inference.engine.protocols import Cavity, Port

CHAINS = Path(__file__).parents[2] / "docs" / "chains"
INDEX = (CHAINS / "index.md").read_text()
PAGES = {path.stem: path.read_text() for path in sorted(CHAINS.glob("*.md")) if path.stem != "index"}
PUBLIC = {name: getattr(rsmcm.chains, name) for name in rsmcm.chains.__all__}
KINDS = {
    name: kind
    for name, kind in PUBLIC.items()
    if hasattr(kind, "ports") and kind.__module__.startswith("rsmcm.chains.")
}
GLOSSARY = (CHAINS.parent / "conventions.md").read_text()
NAMES = sorted(
    {
        name
        for page in (*PAGES.values(), GLOSSARY)
        for name in re.findall(r"`((?:models|inference|chains)\.[\w.]+)`", page)
    }
)
CAVITIES = {Cavity.NOTHING: "nothing", Cavity.IMAGE: "the image", Cavity.OTHERS: "image and others"}


def found(name: str) -> bool:
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(["rsmcm", *parts[:length]]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            if is_dataclass(thing) and part in {field.name for field in fields(thing)}:
                return True
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def page_of(name: str) -> str:
    return PAGES[KINDS[name].__module__.rpartition(".")[2]]


def ports(name: str) -> tuple[Port, ...]:
    """Of a chain with its defaults; those of a class, if it needs none."""
    kind = KINDS[name]
    return tuple(kind().ports if isinstance(kind.ports, property) else kind.ports)


def shown(port: Port) -> str:
    """A feature as tables show it."""
    return f"`{port.kind.__name__}`" + " (optional)" * port.optional


def test_every_chain_has_a_page_of_its_own() -> None:
    assert sorted(kind.__module__.rpartition(".")[2] for kind in KINDS.values()) == sorted(PAGES)
    for name in KINDS:
        assert page_of(name).startswith(f"# {name}\n"), name


@pytest.mark.parametrize("name", sorted(KINDS))
def test_features_are_those_of_the_code(name: str) -> None:
    table = re.search(r"\| feature \| cavity \| message.*\n\|[-|]+\n((?:\|.*\n)+)", page_of(name))
    assert table is not None
    rows = [[cell.strip() for cell in row.split(" | ")] for row in table[1].splitlines()]
    listed = [(row[0].removeprefix("| "), row[1]) for row in rows]
    assert listed == [(shown(port), CAVITIES[port.cavity]) for port in ports(name)]
    row = re.search(rf"^\| \[{name}\]\((\w+)\.md\) \| (.*?) \|", INDEX, re.MULTILINE)
    assert row is not None
    assert row[1] in PAGES
    assert row[2] == ", ".join(shown(port) for port in ports(name))


def test_parameters_that_pages_name_are_there() -> None:
    """In tables of failures, `name` up or down is a parameter of this chain."""
    count = 0
    for name, kind in KINDS.items():
        own = {field.name for field in fields(kind)}
        for parameter in re.findall(r"`(\w+)` (?:up|down)\b", page_of(name).partition("## Failures")[2]):
            assert parameter in own, f"{name}: {parameter}"
            count += 1
    assert count > 20


def test_code_that_pages_name_is_there() -> None:
    assert len(NAMES) > 90
    assert not found("models.core.frame.Frame.colour")
    assert [name for name in NAMES if not found(name)] == []

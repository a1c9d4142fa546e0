"""Imports run in one direction, nothing is too large, tests mirror the tree."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAY_IMPORT = {
    "models": {"models"},
    "inference": {"models", "inference"},
    "chains": {"models", "inference"},
    "apps": {"models", "inference", "chains", "apps"},
}
FILES = [path.relative_to(ROOT) for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py"))]

MOST_FILES = 12
"""In a folder, but for chains."""

MOST_LINES = 450
MOST_LINES_OF_A_CHAIN = 300
MOST_LINES_OF_A_FUNCTION = 80
"""Without its docstring."""

MOST_ARGUMENTS = 10
"""By position."""


def imported(path: Path) -> set[tuple[str, ...]]:
    """What a file imports of ours: `("models", "frame", "Frame")`, without the leading `rsmcm`."""
    names: set[tuple[str, ...]] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = ("rsmcm", *path.with_suffix("").parts)[: -node.level] if node.level else ()
            start = (*above, *(node.module or "").split("."))
            names |= {(*filter(None, start), alias.name) for alias in node.names}
    return {name[1:] for name in names if name[0] == "rsmcm"}


def forbidden(path: Path) -> list[str]:
    """The imports of a file that go against the order of the packages, or from one chain to another."""
    package = path.parts[0]
    against = [name for name in imported(path) if name[:1] and name[0] not in MAY_IMPORT[package]]
    if package == "chains" and path.stem == "__init__":  # lists all chains
        against = [name for name in against if name[0] != "chains"]
    return sorted(".".join(name) for name in against)


@pytest.mark.parametrize("path", FILES, ids=str)
def test_imports_go_in_one_direction(path: Path) -> None:
    assert forbidden(path) == []


FOLDERS = sorted({path.parent for path in FILES})


@pytest.mark.parametrize("folder", FOLDERS, ids=str)
def test_folders_are_small(folder: Path) -> None:
    modules = [path for path in FILES if path.parent == folder and path.name != "__init__.py"]
    assert folder == Path("chains") or len(modules) <= MOST_FILES


@pytest.mark.parametrize("path", FILES, ids=str)
def test_files_and_functions_are_short(path: Path) -> None:
    text = (ROOT / path).read_text()
    assert text.count("\n") <= (MOST_LINES_OF_A_CHAIN if path.parts[0] == "chains" else MOST_LINES)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[1] if ast.get_docstring(node) and len(node.body) > 1 else node.body[0]
            assert (node.end_lineno or 0) - first.lineno < MOST_LINES_OF_A_FUNCTION, node.name
            arguments = {argument.arg for argument in node.args.posonlyargs + node.args.args}
            assert len(arguments - {"self", "cls"}) <= MOST_ARGUMENTS, node.name


TESTS = [path.relative_to(ROOT / "tests") for path in sorted((ROOT / "tests").rglob("test_*.py"))]


@pytest.mark.parametrize("test", [path for path in TESTS if path.parts[0] != "system"], ids=str)
def test_a_test_is_where_its_source_is(test: Path) -> None:
    """`test_gflow.py` and `test_gflow_points.py` are both of `gflow.py` beside which they would lie."""
    words = test.stem.removeprefix("test_").split("_")
    names = ["_".join(words[:count]) for count in range(len(words), 0, -1)]
    assert any((ROOT / test.parent / name).with_suffix(".py").exists() for name in names)


def test_the_test_sees_every_kind_of_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "chains").mkdir()
    path = Path("chains/example.py")
    for line in (
        "from .other import Thing",
        "from . import other",
        "from ..apps.video import open_source",
        "from .. import apps",
        "import rsmcm.apps.video",
        "from rsmcm.chains import Thing",
        "def late():\n    from ..chains.other import Thing",
    ):
        (tmp_path / path).write_text(line)
        assert forbidden(path), line
    for line in (
        "import numpy as np",
        "from ..models.frame import Frame",
        "from ..inference import protocols",
    ):
        (tmp_path / path).write_text(line)
        assert not forbidden(path), line

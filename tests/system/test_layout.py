"""Imports run in one direction, also between folders, and a domain of chains knows no other."""

import ast
import re
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGES = ("models", "inference", "chains", "apps")
"""Each may import those before it."""


def imports_of(path: Path) -> list[tuple[str, ...]]:
    """What a file imports of ours: `("models", "core", "frame", "Frame")`, without the leading `rsmcm`."""
    here = ("rsmcm", *path.relative_to(ROOT).with_suffix("").parts)
    names: list[tuple[str, ...]] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            start = (here[: -node.level] if node.level else ()) + tuple(
                filter(None, (node.module or "").split("."))
            )
            names += [(*start, alias.name) for alias in node.names]
    return [name[1:] for name in names if name[0] == "rsmcm" and len(name) > 1]


def test_imports_run_in_one_direction() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {'.'.join(name)}"
        for place, package in enumerate(PACKAGES)
        for path in (ROOT / package).rglob("*.py")
        for name in imports_of(path)
        if name[0] not in PACKAGES[: place + 1]
    ]
    assert found == []


def test_no_folder_imports_one_that_imports_it() -> None:
    graph = nx.DiGraph()
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        folder = path.relative_to(ROOT).parts[:-1]
        if path.name != "__init__.py":  # which only hands on
            for name in imports_of(path):
                known = next(n for n in range(len(name), 0, -1) if (ROOT / Path(*name[:n])).is_dir())
                graph.add_edge(folder, name[:known])
    assert [circle for circle in nx.strongly_connected_components(graph) if len(circle) > 1] == []


def test_a_domain_of_chains_imports_no_other() -> None:
    domains = {path.parent.name for path in (ROOT / "chains").glob("*/__init__.py")}
    assert domains >= {"pixels", "objects", "points", "structure", "face", "body"}
    found = [
        f"{path.relative_to(ROOT)}: {'.'.join(name)}"
        for domain in domains
        for path in (ROOT / "chains" / domain).rglob("*.py")
        for name in imports_of(path)
        if name[:1] == ("chains",) and name[1:2] != (domain,)
    ]
    assert found == []


def test_docs_import_what_is_public() -> None:
    found = []
    for path in (
        ROOT / "README.md",
        *DOCS.rglob("*.md"),
        *DOCS.glob("gallery/*.py"),
        *DOCS.glob("examples/*.py"),
    ):
        imports = re.findall(
            r"^ *from rsmcm\.(\S+) import ([^(\n]+|\([^)]*\))",
            path.read_text(),
            re.MULTILINE,
        )
        for package, names in imports:
            stub = ROOT.joinpath(*package.split(".")) / "__init__.pyi"
            public = re.findall(r'^    "(\w+)",$', stub.read_text(), re.MULTILINE) if stub.is_file() else []
            found += [
                f"{path.name}: {package}.{name}" for name in re.findall(r"\w+", names) if name not in public
            ]
    assert found == []

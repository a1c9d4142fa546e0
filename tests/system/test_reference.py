"""The reference has every public name, and what its pages are made of is what the code says."""

import importlib.util
import re
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest
import rsmcm.chains

pytest.importorskip("sphinx", reason="needs what the documentation is built with")
pytest.importorskip("numpydoc")
nodes = pytest.importorskip("docutils.nodes")

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGES = sorted(
    ".".join(("rsmcm", *path.parent.relative_to(ROOT).parts))
    for package in ("models", "inference", "chains", "apps")
    for path in (ROOT / package).rglob("__init__.pyi")
)


def extension(name: str) -> ModuleType:
    """One of the documentation's own."""
    spec = importlib.util.spec_from_file_location(name, DOCS / "_ext" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_package_with_public_names_is_in_the_reference() -> None:
    listed = re.findall(r"^   (rsmcm\.\S+)$", (DOCS / "reference" / "api.rst").read_text(), re.MULTILINE)
    assert {"rsmcm.models", "rsmcm.apps.io"} < set(PACKAGES) <= set(listed)


@pytest.mark.parametrize(
    "name", sorted(name for name in rsmcm.chains.__all__ if hasattr(getattr(rsmcm.chains, name), "ports"))
)
def test_the_docstring_of_a_chain_documents_its_parameters(name: str) -> None:
    """`rows` refuses what is no parameter; here, that none is left out."""
    kind = getattr(rsmcm.chains, name)
    documented = re.findall(r"`(\w+)`", " ".join(names for names, _, _ in extension("parameters").rows(kind)))
    assert {field.name for field in fields(kind) if field.init} - {"name"} <= set(documented)


def test_parameters_that_pages_name_are_there() -> None:
    """`[blobs] max_coast_time` and the like, on the page of symptoms."""
    from rsmcm.apps.background.parameters import SECTIONS

    text = (DOCS / "parameters.md").read_text()
    cells = re.findall(r"`\[([\w-]+)\] (\w+)", text)
    assert len(cells) > 15
    for section, name in cells:
        names = {field.name for kind in SECTIONS[section].values() for field in fields(kind)}
        assert name in names | {"model"}, f"[{section}] {name}"

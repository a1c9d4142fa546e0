"""The notebook of the tutorial is made of its page, and a kernel runs it."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGE, NOTEBOOK = DOCS / "tutorial.md", DOCS / "tutorial.ipynb"


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    """The script that makes it."""
    spec = importlib.util.spec_from_file_location("tutorial", DOCS / "pictures" / "tutorial.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_notebook_is_that_of_the_page(maker: ModuleType) -> None:
    """After a change of the page: `python docs/pictures/tutorial.py`, which `make results` does as well."""
    page = PAGE.read_text()
    assert NOTEBOOK.read_text() == maker.notebook(page)
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(each in page for each in code)
    assert len(code) == page.count("```python\n")
    assert page.count("\n## ") == 8  # seven steps, and the commands


@pytest.mark.slow
def test_a_kernel_runs_the_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MPLBACKEND", raising=False)  # a kernel chooses its own, which draws in the notebook
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    nbclient.NotebookClient(notebook, timeout=600).execute()
    drawn = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", {})
    ]
    assert len(drawn) == 4  # steps 1, 2, 3 and 6

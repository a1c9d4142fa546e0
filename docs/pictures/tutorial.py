"""Make the notebook and the pictures of docs/tutorial.md from its code: python docs/pictures/tutorial.py.

The page is the source: text becomes cells of Markdown, Python becomes cells of code, and what a block of
Python draws in step n becomes tutorial-n.png.
"""

import json
import re
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from PIL import Image

HERE = Path(__file__).parent
PAGE = HERE.parent / "tutorial.md"
NOTEBOOK = PAGE.with_suffix(".ipynb")
INSTALL = "Needs the package, from a checkout: `pip install .`"


def cells(page: str) -> list[tuple[str, str]]:
    """Cells `("markdown" or "code", text)`, without what code prints and draws: a notebook shows it."""
    found = []
    parts = re.split(r"^```(\w+)\n(.*?)^```\n", page, flags=re.DOTALL | re.MULTILINE)
    for text, language, code in zip(parts[::3], [*parts[1::3], ""], [*parts[2::3], ""], strict=True):
        text = re.sub(r"^!\[.*\n", "", text, flags=re.MULTILINE)
        text = re.sub(r"\]\(([\w-]+)\.md", r"](\1.md", text).replace(
            "[The notebook](tutorial.ipynb)", "The page"
        )
        if text.strip():
            found.append(("markdown", re.sub(r"\n{3,}", "\n\n", text.strip())))
        if language == "python":
            found.append(("code", code.rstrip()))
    return found


def notebook(page: str) -> str:
    """The page as a notebook without outputs, in the format 4.5."""
    made: list[dict[str, Any]] = []
    for number, (kind, text) in enumerate(cells(page)):
        text = f"{text}\n\n{INSTALL}" if number == 0 else text
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": text.splitlines(True)}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    about = {"kernelspec": kernel, "language_info": {"name": "python"}}
    content = {"cells": made, "metadata": about, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def draw(page: str) -> None:
    """Run the code, and keep what it draws."""
    names: dict[str, Any] = {"__name__": "page"}
    for step, part in enumerate(page.split("\n## ")):
        for kind, text in cells(part):
            if kind == "code":
                exec(compile(text, f"step {step}", "exec"), names)
        if plt.get_fignums():
            buffer = BytesIO()
            plt.savefig(buffer, dpi=100)
            Image.open(buffer).convert("RGB").quantize(256).save(HERE / f"tutorial-{step}.png", optimize=True)
            plt.close("all")


if __name__ == "__main__":
    plt.switch_backend("Agg")
    text = PAGE.read_text(encoding="utf-8")
    NOTEBOOK.write_text(notebook(text), encoding="utf-8")
    draw(text)

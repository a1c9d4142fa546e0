"""The page of an experiment: tables, and pictures that it holds itself."""

import base64
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...models.files import write_atomically, write_text
from ..evaluation.text_tables import rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Section = tuple[str, Sequence[str]]
"""Heading, which may be empty, and parts in HTML."""

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 1320px; margin: 0 auto; padding: 1rem 1.5rem; }}
table {{ border-collapse: collapse; }}
th, td {{ text-align: left; padding: .25rem .9rem .25rem 0; border-bottom: 1px solid #8885; }}
figure {{ margin: .6rem 0; }}
figure, .wide {{ overflow-x: auto; }}
img {{ max-width: 100%; height: auto; background: white; }}
</style>
<main>
<h1>{title}</h1>
{body}
</main>
</html>
"""


def write_page(path: Path, title: str, sections: Iterable[Section]) -> None:
    """Write a page of sections as one HTML file.

    Raises
    ------
    OSError
        if the file cannot be written; nothing half-written stays behind.
    """
    lines: list[str] = []
    for heading, parts in sections:
        lines += [f"<h2>{escape(heading)}</h2>"] if heading else []
        lines += parts
    write_text(path, PAGE.format(title=escape(title), body="\n".join(lines)))


def table(header: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "") -> str:
    """A table in HTML; numbers are rounded."""

    def line(cells: Iterable[object], kind: str) -> str:
        texts = (rounded(cell) if isinstance(cell, float) else str(cell) for cell in cells)
        return f"<tr>{''.join(f'<{kind}>{escape(text)}</{kind}>' for text in texts)}</tr>"

    above = [f"<p>{escape(caption)}</p>"] if caption else []
    lines = [line(header, "th"), *(line(row, "td") for row in rows)]
    return "\n".join([*above, '<div class="wide"><table>', *lines, "</table></div>"])


def picture(path: Path, caption: str) -> str:
    """A picture from a PNG file.

    Raises
    ------
    OSError
        if the file cannot be read.
    """
    said, data = escape(caption), base64.b64encode(path.read_bytes()).decode("ascii")
    image = f'<img src="data:image/png;base64,{data}" alt="{said}">'
    return f"<figure>{image}<figcaption>{said}</figcaption></figure>"


def write_figure(path: Path, draw: Callable[["Figure"], None], size: tuple[float, float]) -> None:
    """Draw on an empty matplotlib figure of a size in inches, and write it as PNG, whole or not at all.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    from matplotlib.figure import Figure

    with _plot_style(), write_atomically(path) as unfinished:
        canvas = Figure(figsize=size, layout="constrained")
        draw(canvas)
        canvas.savefig(unfinished, format="png", dpi=110)


def _plot_style() -> AbstractContextManager[None]:
    import matplotlib

    style: dict[Any, object] = {
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.alpha": 0.18,
        "legend.frameon": False,
    }
    inked = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return matplotlib.rc_context(style | dict.fromkeys(inked, "#0a0b0c"))

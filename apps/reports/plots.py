"""Plots: inside a page as SVG in the reader's text colour, or as files."""

import io
import re
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from ...models.files import write_atomically
from .page import captioned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#0a0b0c"  # stands for the reader's text colour in plots


def figure(draw: Callable[["Figure"], None], size: tuple[float, float], caption: str = "") -> Markup:
    """A plot as inline SVG, in the reader's text colour.

    Parameters
    ----------
    draw
        draws on an empty matplotlib figure; no global state is touched.
    size
        `(width, height)` inches.
    """
    from matplotlib.figure import Figure

    with _plot_style(caption), warnings.catch_warnings():
        # the text stays text, and is shown in a font of the reader's, which has more letters
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font")
        canvas = Figure(figsize=size, layout="constrained")
        draw(canvas)
        written = io.StringIO()
        canvas.savefig(written, format="svg", transparent=True, metadata={"Date": None})
    svg = written.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # names that every plot shares would clash on a page with several
    svg = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", svg)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(caption or "plot")}" ', 1)
    return captioned(Markup(svg), caption)


def write_figure(path: Path, draw: Callable[["Figure"], None], size: tuple[float, float]) -> None:
    """Write a plot as PNG, whole or not at all; parameters as of `figure`.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    from matplotlib.figure import Figure

    with _plot_style(path.name):
        canvas = Figure(figsize=size, layout="constrained")
        draw(canvas)
        with write_atomically(path) as unfinished:
            canvas.savefig(unfinished, format="png", dpi=110)


def _plot_style(salt: str) -> AbstractContextManager[None]:
    """Settings of matplotlib; the salt makes the same page on every run."""
    import matplotlib

    style: dict[Any, object] = {
        "svg.fonttype": "none",
        "svg.hashsalt": salt or "plot",
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.alpha": 0.18,
        "legend.frameon": False,
    }
    inked = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return matplotlib.rc_context(style | dict.fromkeys(inked, INK))

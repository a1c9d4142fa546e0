"""Figures of experiments, as files."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...models.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

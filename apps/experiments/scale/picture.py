"""Curves as small pictures side by side."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from .curve import Curve

COLUMNS = 4
PANEL = (2.9, 2.4)
"""Inches."""


def size(found: Sequence[Curve]) -> tuple[float, float]:
    """Of the picture, inches."""
    rows = -(-len(_panels(found)) // COLUMNS)
    return COLUMNS * PANEL[0], rows * PANEL[1]


def draw(canvas: Figure, found: Sequence[Curve]) -> None:
    """A panel for each kind of size: time solid, its limit dashed."""
    panels = _panels(found)
    axes = canvas.subplots(-(-len(panels) // COLUMNS), COLUMNS, squeeze=False).reshape(-1)
    for each, (title, inside) in zip(axes, panels.items(), strict=False):
        _draw_panel(each, title, inside)
    for empty in axes[len(panels) :]:
        empty.set_axis_off()


def _panels(found: Sequence[Curve]) -> dict[str, list[Curve]]:
    """Curves by what they are over."""
    panels: dict[str, list[Curve]] = {}
    for each in found:
        panels.setdefault(each.unit, []).append(each)
    return panels


def _draw_panel(axes: Axes, unit: str, inside: Sequence[Curve]) -> None:
    for number, curve in enumerate(inside):
        colour = f"C{number}"
        sizes = [each.size for each in curve.points]
        milliseconds = [1e3 * each.seconds for each in curve.points]
        axes.plot(sizes, milliseconds, "o-", color=colour, markersize=3, label=curve.name)
        axes.plot(sizes, [1e3 * each.limit for each in curve.points], "--", color=colour, linewidth=1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=8)
    axes.set_xlabel(unit, fontsize=9)
    axes.set_ylabel("ms", fontsize=9)
    axes.legend(fontsize=8, loc="upper left", handlelength=1, borderaxespad=0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 8 ** len(inside))  # room for the names

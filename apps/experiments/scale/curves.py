"""All curves, what is wanted of them, and what they are drawn as."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....models.numerics.threads import set_threads
from ...reports.expectations import Expectation
from ...reports.experiment import Experiment, Plot
from ...reports.record import Table
from .curve import Curve, tables
from .machine import bandwidth, drawing, operations
from .of_pictures import over_frames_of_a_film, over_objects, over_pixels
from .of_points import over_observations, over_points
from .of_poses import over_experts, over_samples, over_texels

MANY_FRAMES, SOME_FRAMES = 10_000, 1_500
"""Of the film over which time and memory are watched."""

WANTED: Mapping[str, float] = {"frames so far": 0.05}
"""Powers by unit; of all others `LINEAR`."""

LINEAR = 1.1
PEER = "MOG2"
GROWN = 32.0
"""MB."""

COLUMNS = 4
PANEL = (2.6, 2.4)
"""Inches."""


def curves(n_frames: int) -> Experiment:
    """Measure all of them.

    Parameters
    ----------
    n_frames
        of the film over which time and memory are watched.
    """
    set_threads(1)
    over_time, grown = over_frames_of_a_film(n_frames)
    found = [
        *over_pixels(),
        *over_objects(),
        *over_time,
        *over_points(),
        *over_observations(),
        *over_samples(),
        *over_experts(),
        *over_texels(),
    ]
    expectations = [
        each.expectation(None if each.name == PEER else WANTED.get(each.unit, LINEAR)) for each in found
    ]
    what = f"memory grown over the last four fifths of {n_frames} frames, MB"
    expectations.append(Expectation(what, grown, "<=", GROWN))
    everything = [*tables(found), machine_table()]
    plot = Plot("curves.png", lambda canvas: draw(canvas, found), size(found), "Time; dashed: its limit.")
    return Experiment("Cost as curves", everything, expectations, [plot])


def machine_table() -> Table:
    """What the limits are worked out with."""
    rows: list[Sequence[object]] = [
        (f"bytes moved by a copy of {n_bytes >> 10} kB, a second", bandwidth(n_bytes), bandwidth(n_bytes, 2))
        for n_bytes in (1 << 18, 1 << 22, 1 << 26, 1 << 28)
    ]
    rows.append(("operations of single precision in a product of matrices, a second", operations(), None))
    rows.append(("normal numbers drawn, a second", 1 / drawing(1.0), None))
    return Table(("what", "one thread", "two"), rows, "What the machine can do, in the same run.")


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
    axes.set_xlabel(unit)
    axes.set_ylabel("ms")
    axes.legend(fontsize=6, loc="upper left", handlelength=1)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 6 ** len(inside))  # room for the names

"""What an experiment leaves: printed tables, figures, numbers as JSON, and a page with everything."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ..io.files import write_json
from .expectations import HEADER, Expectation, print_tables
from .page import Section, table, write_page
from .plots import figure, write_figure


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot: its file's name, what draws it, its size in inches, and what is said below it."""

    name: str
    draw: Callable[[Figure], None]
    size: tuple[float, float]
    caption: str


@dataclass(frozen=True, eq=False)
class Table:
    """What was measured: names of the columns, rows, and what is said above them."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""


def publish(
    out: Path,
    title: str,
    measured: Table,
    expectations: Sequence[Expectation],
    *,
    plots: Sequence[Plot] = (),
    sections: Sequence[Section] = (),
    numbers: Any = None,
) -> None:
    """Print what was measured and what was wanted of it, and write it with its figures into a folder.

    Parameters
    ----------
    out
        folder of the experiment.
    title
        heading of the page, `index.html`.
    measured, expectations
        first on the page and on standard output.
    plots
        each is on the page and a file of its own.
    sections
        what else is on the page.
    numbers
        content of `results.json`; `None` for no such file.

    Raises
    ------
    OSError
        if something cannot be written.
    """
    print_tables(measured.header, measured.rows, expectations)
    for plot in plots:
        write_figure(out / plot.name, plot.draw, plot.size)
    if numbers is not None:
        write_json(out / "results.json", numbers)
    wanted = table(HEADER, [each.cells for each in expectations])
    figures = [figure(plot.draw, plot.size, plot.caption) for plot in plots]
    everything = table(measured.header, measured.rows, measured.caption)
    first: list[Section] = [("", [wanted]), *([("Figures", figures)] if figures else [])]
    write_page(out / "index.html", title, [*first, ("Measured", [everything]), *sections])
    print(f"\npage: {out / 'index.html'}")

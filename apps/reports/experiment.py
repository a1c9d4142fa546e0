"""What an experiment leaves: printed tables, figures, a record as JSON, and a page with everything."""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .expectations import Expectation, columns, in_columns
from .page import Section, table, write_page
from .plots import figure, write_figure
from .record import Record, Stopwatch, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot: its file's name, what draws it, its size in inches, and what is said below it."""

    name: str
    draw: Callable[["Figure"], None]
    size: tuple[float, float]
    caption: str


@dataclass(frozen=True, eq=False)
class Experiment:
    """What an experiment found.

    Parameters
    ----------
    title
        heading of the page, `index.html`.
    tables, expectations
        what was measured, and what was wanted of it: printed, on the page, and in the record.
    plots
        each is on the page and a file of its own.
    sections
        what else is on the page.
    runs
        every run's measures, for the record in the experiment's folder.
    """

    title: str
    tables: Sequence[Table]
    expectations: Sequence[Expectation]
    plots: Sequence[Plot] = ()
    sections: Sequence[Section] = ()
    runs: Any = None


def run_and_publish(name: str, command: str, out: Path, run: Callable[[], Experiment]) -> None:
    """Run an experiment; print what it found, and write it with its figures and its record into a folder.

    Parameters
    ----------
    name, command
        for the record: of the experiment, and what repeats it.
    out
        folder of the experiment, made if need be.
    run
        does the work.

    Raises
    ------
    OSError
        if something cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    watch = Stopwatch()
    found = run()
    record = Record(name, found.title, command, watch.provenance(), found.expectations, found.tables)
    record.write(out / "results.json", found.runs)
    for each in found.tables:
        print(*textwrap.wrap(each.caption, 110), in_columns(each.header, each.rows), "", sep="\n")
    header, wanted = columns(found.expectations)
    print(in_columns(header, wanted))
    for plot in found.plots:
        write_figure(out / plot.name, plot.draw, plot.size)
    figures = [figure(plot.draw, plot.size, plot.caption) for plot in found.plots]
    first: list[Section] = [("", [table(header, wanted)]), *([("Figures", figures)] if figures else [])]
    measured = [table(each.header, each.rows, each.caption) for each in found.tables]
    write_page(out / "index.html", found.title, [*first, ("Measured", measured), *found.sections])
    print(f"\npage: {out / 'index.html'}")

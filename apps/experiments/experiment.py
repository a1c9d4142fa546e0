"""What an experiment leaves: printed tables, pictures, a record as JSON, and a page with everything."""

import textwrap
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..evaluation.text_tables import in_columns
from ..io.files import write_image
from ..runs.parallel import in_parallel
from ..view.page import Page, Section, picture_file, table, write_page
from .expectations import HEADER, Expectation
from .figures import write_figure
from .record import Record, Stopwatch, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Cell = TypeVar("Cell", bound=Hashable)
Method = TypeVar("Method", bound=Hashable)
T = TypeVar("T")


def by_seed(
    label: str,
    measure: Callable[[Cell, int], Mapping[Method, T]],
    cells: Sequence[Cell],
    seeds: Sequence[int],
) -> dict[Cell, dict[Method, list[T]]]:
    """Measure every cell with every seed, in several processes.

    Parameters
    ----------
    label
        of the progress that is shown.
    measure
        gives measures by method, of a cell and a seed; it can be sent to another process.
    cells, seeds
        what is measured: all combinations.

    Returns
    -------
    dict
        by cell and method, a measure for each seed: what `over_seeds` takes.
    """
    work = [(measure, (cell, seed)) for cell in cells for seed in seeds]
    measured = iter(in_parallel(label, work))
    found = {}
    for cell in cells:
        of_seeds = [next(measured) for _ in seeds]
        found[cell] = {method: [each[method] for each in of_seeds] for method in of_seeds[0]}
    return found


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot: its file's name, what draws it, its size in inches, and what is said below it."""

    name: str
    draw: Callable[["Figure"], None]
    size: tuple[float, float]
    caption: str

    def write(self, path: Path) -> None:
        """Write it as a file."""
        write_figure(path, self.draw, self.size)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture `(height, width[, 3])` uint8 BGR: its file's name, and what is said below it."""

    name: str
    image: NDArray[np.uint8]
    caption: str

    def write(self, path: Path) -> None:
        """Write it as a file."""
        write_image(path, self.image)


@dataclass(frozen=True, eq=False)
class Findings:
    """What an experiment found.

    Parameters
    ----------
    title
        heading of the page, `index.html`.
    tables, expectations
        what was measured, and what was wanted of it: printed, on the page, and in the record.
    pictures
        each is a file, and on the page.
    details
        tables that are on the page only.
    runs
        every run's measures, for the record in the experiment's folder.
    """

    title: str
    tables: Sequence[Table]
    expectations: Sequence[Expectation]
    pictures: Sequence[Plot | Picture] = ()
    details: Sequence[Table] = ()
    runs: Any = None


def publish(name: str, command: str, out: Path, run: Callable[[], Findings]) -> None:
    """Run an experiment; print what it found, and write it with its pictures and its record into a folder.

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
    wanted = [each.cells for each in found.expectations]
    if wanted:
        print(in_columns(HEADER, wanted))
    for one in found.pictures:
        one.write(out / one.name)
    shown = [picture_file(out / one.name, one.caption) for one in found.pictures]
    measured = [table(each.header, each.rows, each.caption) for each in (*found.tables, *found.details)]
    judged = [table(HEADER, wanted)] if wanted else []
    sections: list[Section] = [("", judged), ("Figures", shown), ("Measured", measured)]
    write_page(out / "index.html", Page(found.title, sections=[each for each in sections if each[1]]))
    print(f"\npage: {out / 'index.html'}")

"""Results of an experiment: printed tables, pictures, a record as JSON, and a page."""

import textwrap
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.files import write_atomically
from ..evaluation.text_tables import in_columns
from ..runs.parallel import in_parallel
from ..view.page import Page, Section, picture_file, table, write_page
from .record import HEADER, Expectation, Record, Stopwatch, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = TypeVar("Cell", bound=Hashable)
Method = TypeVar("Method", bound=Hashable)
T = TypeVar("T")
Image = NDArray[np.uint8]

TALLEST = 4  # times as high as wide: the room for a picture
INK = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color"), "#0a0b0c"
)
STYLE: dict[Any, object] = {
    "font.family": "sans-serif", "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "axes.axisbelow": True, "grid.alpha": 0.18, "legend.frameon": False, **INK,
}  # fmt: skip


def by_seed(
    label: str,
    measure: Callable[[Cell, int], Mapping[Method, T]],
    cells: Sequence[Cell],
    seeds: Sequence[int],
) -> dict[Cell, dict[Method, list[T]]]:
    """Measure every cell with every seed, in several processes.

    `measure` gives measures by method, of a cell and a seed; it can be sent to another process. By cell and
    method, a measure for each seed comes back: what `over_seeds` takes.
    """
    measured = iter(in_parallel(label, [(measure, (cell, seed)) for cell in cells for seed in seeds]))
    found = {}
    for cell in cells:
        of_seeds = [next(measured) for _ in seeds]
        found[cell] = {method: [each[method] for each in of_seeds] for method in of_seeds[0]}
    return found


def noisy(frame: Frame, seed: int) -> Frame:
    """Return the frame with one grey level more or less in one of a thousand pixels.

    By how much figures of a real film differ between seeds of this noise is the part of them that is chance.
    """
    if frame.image is None:
        return frame
    random = np.random.default_rng([seed, frame.number])
    image = frame.image.reshape(-1, frame.image.shape[-1] if frame.image.ndim == 3 else 1).astype(np.int16)
    changed = random.choice(len(image), len(image) // 1000, replace=False)
    image[changed] += random.choice(np.array([-1, 1], np.int16), len(changed))[:, None]
    return replace(frame, image=image.clip(0, 255).astype(np.uint8).reshape(frame.image.shape))


def shaken(frames: Iterable[Frame], seed: int | None) -> Iterator[Frame]:
    """Return the frames with the noise of a seed; as they are without one."""
    return (frame if seed is None else noisy(frame, seed) for frame in frames)


def in_words(values: Sequence[float], dash: str = "–") -> str:
    """Return median and quartiles as text."""
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return f"{middle:.3g} ({low:.3g}{dash}{high:.3g})"


@dataclass(frozen=True, eq=False)
class Plot:
    """Plot: its file's name, the function that draws it, its size in inches, and its caption."""

    name: str
    draw: Callable[["Figure"], None]
    size: tuple[float, float]
    caption: str

    def write(self, path: Path) -> None:
        """Draw it on an empty figure, and write that as PNG."""
        import matplotlib
        from matplotlib.figure import Figure

        with matplotlib.rc_context(STYLE), write_atomically(path) as unfinished:
            canvas = Figure(figsize=self.size, layout="constrained")
            self.draw(canvas)
            canvas.savefig(unfinished, format="png", dpi=110)


def pictures(
    name: str,
    rows: Sequence[tuple[str, Sequence[Image]]],
    columns: Sequence[str],
    caption: str,
    width: float = 2.2,
) -> Plot:
    """Return a plot of pictures `(height, width[, 3])` uint8 BGR, all of one size, in named rows and columns.

    Each is so many inches wide.
    """
    height = width * min(rows[0][1][0].shape[0] / rows[0][1][0].shape[1], TALLEST)

    def draw(canvas: "Figure") -> None:
        grid = canvas.subplots(len(rows), len(columns), squeeze=False)
        for axes, (row, images) in zip(grid, rows, strict=True):
            for axis, image in zip(axes, images, strict=True):
                axis.imshow(image[..., ::-1] if image.ndim == 3 else image, cmap="gray", vmin=0, vmax=255)
                axis.set(xticks=[], yticks=[])
                axis.grid(visible=False)
            axes[0].set_ylabel(row.replace(": ", ":\n"), fontsize=8)
        for axis, column in zip(grid[0], columns, strict=True):
            axis.set_title(column, fontsize=9)

    return Plot(name, draw, (width * len(columns) + 0.5, (height + 0.1) * len(rows) + 0.3), caption)


@dataclass(frozen=True, eq=False)
class Findings:
    """Results of an experiment."""

    title: str  # heading of the page, `index.html`
    # tables, expectations: what was measured, and what was wanted of it: printed, on the page, and in the
    # record
    tables: Sequence[Table]
    expectations: Sequence[Expectation]
    pictures: Sequence[Plot] = ()  # each is a file, and on the page


def publish(name: str, command: str, out: Path, run: Callable[[], Findings]) -> None:
    """Run an experiment; print its results, and write them with pictures and record into a folder.

    `name` and `command`, which repeats it, are for the record. The folder is made if need be.

    Raises
    ------
    OSError
        if something cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    watch = Stopwatch()
    found = run()
    record = Record(name, found.title, command, watch.provenance(), found.expectations, found.tables)
    record.write(out / "results.json")
    for each in found.tables:
        print(*textwrap.wrap(each.caption, 110), in_columns(each.header, each.rows), "", sep="\n")
    wanted = [each.cells for each in found.expectations]
    if wanted:
        print(in_columns(HEADER, wanted))
    for one in found.pictures:
        one.write(out / one.name)
    shown = [picture_file(out / one.name, one.caption) for one in found.pictures]
    measured = [table(each.header, each.rows, each.caption) for each in found.tables]
    judged = [table(HEADER, wanted)] if wanted else []
    sections: list[Section] = [("", judged), ("Figures", shown), ("Measured", measured)]
    write_page(out / "index.html", Page(found.title, sections=[each for each in sections if each[1]]))
    print(f"\npage: {out / 'index.html'}")

"""Results of an experiment: printed tables, pictures, a record as JSON, and a page."""

import textwrap
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.files import write_atomically
from ..evaluation.text_tables import in_columns
from ..io.files import write_image
from ..runs.parallel import in_parallel
from ..view.page import Page, Section, picture_file, table, write_page
from .record import HEADER, Expectation, Record, Stopwatch, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = TypeVar("Cell", bound=Hashable)
Method = TypeVar("Method", bound=Hashable)
T = TypeVar("T")
Image = NDArray[np.uint8]

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


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture `(height, width[, 3])` uint8 BGR: its file's name and its caption."""

    name: str
    image: Image
    caption: str

    def write(self, path: Path) -> None:
        """Write it as a file."""
        write_image(path, self.image)


@dataclass(frozen=True, eq=False)
class Findings:
    """Results of an experiment."""

    title: str  # heading of the page, `index.html`
    # tables, expectations: what was measured, and what was wanted of it: printed, on the page, and in the
    # record
    tables: Sequence[Table]
    expectations: Sequence[Expectation]
    pictures: Sequence[Plot | Picture] = ()  # each is a file, and on the page


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


GAP = 4  # px
TEXT = 18  # px, height of a line
PAPER = 255
TALLEST = 4  # times as high as wide: the room for a picture


def fitting(shape: tuple[int, ...], width: int) -> tuple[int, int]:
    """Return width and height, px, of a picture `(height, width[, 3])` at a width; less if it is tall."""
    scale = min(width / shape[1], TALLEST * width / shape[0])
    return max(1, round(scale * shape[1])), max(1, round(scale * shape[0]))


def mosaic(rows: Sequence[tuple[str, Sequence[Image]]], columns: Sequence[str], width: int = 240) -> Image:
    """Lay out pictures `(height, width[, 3])` uint8, all of one size, in rows with their names above them.

    `columns` are the names above the first row. Each picture is scaled to `width` px, unless it is more
    than four times as high as wide. The sheet is `(height, width, 3)` BGR.
    """
    width, height = fitting(rows[0][1][0].shape, width)
    across, down = width + GAP, height + TEXT + GAP
    shape = (TEXT + len(rows) * down + GAP, len(columns) * across + GAP, 3)
    sheet: Image = np.full(shape, PAPER, np.uint8)
    for column, name in enumerate(columns):
        _write(sheet, name, GAP + column * across, TEXT - 5)
    for row, (name, images) in enumerate(rows):
        top = TEXT + row * down
        _write(sheet, name, GAP, top + TEXT - 5)
        for column, image in enumerate(images):
            left = GAP + column * across
            small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            if small.ndim == 2:
                small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
            sheet[top + TEXT : top + TEXT + height, left : left + width] = small
    return sheet


def _write(sheet: Image, text: str, x: int, y: int) -> None:
    cv2.putText(sheet, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)

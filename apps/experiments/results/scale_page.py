"""The parts of the page on scale that are made from records."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ..page import write_figure
from ..record import Record, Table
from ..scale.capacity import HEADER as CAPACITY
from ..scale.curve import HEADER, of_record
from ..scale.picture import draw, size
from .pages import cell, figures, measured_when, table
from .plan import of_cameras, of_observations, room

PAGE, PICTURE = Path("docs") / "scale.md", Path("docs") / "pictures" / "curves.png"
ALT = "![Time over size, log scales, a panel for each kind of size, with limits dashed]({})\n"
CURVES = "curves"
"""The record that is drawn."""

NOT_YET = "*Not recorded yet.*\n"


def scale_page(text: str, records: Mapping[str, Record], root: Path) -> str:
    """The page with its parts.

    Parameters
    ----------
    text
        of the page, with marks around each part: `<!-- curves -->` and `<!-- /curves -->`.
    records
        by name; what is not there yet is said not to be.
    root
        checkout with the code that tracks.

    Raises
    ------
    ValueError
        if the page lacks the marks, or a record what it should have.
    """
    parts: dict[str, tuple[tuple[str, ...], Callable[[], str]]] = {
        "capacity": (("capacity",), lambda: _capacity(records["capacity"], root)),
        "curves": (("curves",), lambda: _curves(records["curves"], root)),
        "cameras": (
            ("capacity", "curves"),
            lambda: _plain(of_cameras(records["capacity"], records["curves"])),
        ),
        "observations": (
            ("curves",),
            lambda: f"{_plain(of_observations(records['curves']))}\n{room(records['curves'])}\n",
        ),
    }
    for name, (needed, made) in parts.items():
        text = between(text, name, made() if all(each in records for each in needed) else NOT_YET)
    return text


def between(text: str, name: str, content: str) -> str:
    """A text with other lines between the marks of a name.

    Raises
    ------
    ValueError
        if the marks are not there.
    """
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"{PAGE}: expected {begin} and {end}")
    return f"{before}{begin}\n{content}\n{end}{after}"


def write_picture(record: Record, path: Path) -> None:
    """Draw the curves of a record.

    Raises
    ------
    OSError, ValueError
        if the file cannot be written, or there are no curves.
    """
    found = list(of_record(record).values())
    write_figure(path, lambda canvas: draw(canvas, found), size(found))


def _capacity(record: Record, root: Path) -> str:
    (found,) = (each for each in record.tables if tuple(each.header) == CAPACITY)
    return f"{found.caption}\n\n{_plain(found)}\n{measured_when(record, root)}\n"


def _curves(record: Record, root: Path) -> str:
    parts = [f"{measured_when(record, root)}\n"]
    for each in record.tables:
        if tuple(each.header) != HEADER:  # every point is in the picture, and in the record
            parts += [f"{each.caption}\n", _plain(each)]
    return "\n".join([ALT.format(PICTURE.relative_to(PAGE.parent)), figures(record), *parts])


def _plain(found: Table) -> str:
    return table(found.header, [[cell(each) for each in row] for row in found.rows])

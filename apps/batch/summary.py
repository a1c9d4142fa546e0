"""What became of all films of a batch: `summary.csv` for tables, `index.html` to look at."""

import csv
import io
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args
from urllib.parse import quote

from markupsafe import Markup

from ...models.files import read_text, write_text
from ..view.page import Page, Part, paragraph, templates_in, write_page
from .job import INDEX, SUMMARY
from .sources import plain_name

State = Literal["waiting", "complete", "interrupted", "lost", "failed"]
"""Of a film: not begun; all there; ended by Ctrl-C; lost permanently, of a camera; ended by an error."""


@dataclass(frozen=True)
class FilmStatus:
    """What became of a film: its state, what went wrong, figures of its summary, a small JPEG in base 64."""

    state: State
    error: str = ""
    frames: int | None = None
    missing: int | None = None
    tracks: int | None = None
    seconds: float | None = None
    frames_per_second: float | None = None
    thumbnail: str = ""


@dataclass(frozen=True)
class Line:
    """A film's line: its source without password, its folder in that of the batch, what became of it."""

    source: str
    folder: str
    status: FilmStatus


STATUS_FIELDS = ("state", "frames", "missing", "tracks", "seconds", "frames_per_second", "error")
COLUMNS = ("source", "folder", *STATUS_FIELDS)
NUMBERS = {"frames": int, "missing": int, "tracks": int, "seconds": float, "frames_per_second": float}

MOST_BYTES = 1 << 28
"""Of a summary that is read: a million films."""

MOST_PICTURES = 2000
"""On the page, which holds them itself: about 8 MB."""

PAUSE, SHARE = 1.0, 20
"""Seconds between two times that the files are written, and how often the time that this took: a batch of
many thousand films does not spend itself on them."""

_page = templates_in(Path(__file__).parent / "templates").get_template("films.html")


class Summary:
    """The lines of all films whose results are in a folder, by source, those of earlier batches included.

    A file of the same name that no batch has written is a FileExistsError, a line that is no film's a
    ValueError.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self.lines = {line.source: line for line in _read(out / SUMMARY)}
        self._next = 0.0

    def tell(self, line: Line) -> None:
        """Take in a line, and write both files, if they were not written just now."""
        self.lines[line.source] = line
        if time.monotonic() >= self._next:
            self.write()

    def write(self) -> None:
        """Write both files, each of them whole or not at all."""
        began = time.monotonic()
        self._out.mkdir(parents=True, exist_ok=True)
        rows = io.StringIO(newline="")
        writer = csv.writer(rows, lineterminator="\n")
        writer.writerow(COLUMNS)
        for line in self.lines.values():
            status = asdict(line.status)
            writer.writerow([line.source, line.folder, *(_cell(status[name]) for name in STATUS_FIELDS)])
        write_text(self._out / SUMMARY, rows.getvalue())
        write_index(self._out, list(self.lines.values()))
        took = time.monotonic() - began
        self._next = time.monotonic() + max(PAUSE, SHARE * took)


def _cell(value: object) -> object:
    """Numbers with as many digits as mean something; nothing where there is none."""
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else value


def _read(path: Path) -> list[Line]:
    if not path.exists():
        return []
    text = read_text(path, "expected the summary of a batch", MOST_BYTES)
    reader = csv.DictReader(io.StringIO(text, newline=""))
    if tuple(reader.fieldnames or ()) != COLUMNS:
        raise FileExistsError(f"{path}: no batch has written it: move it, or choose another folder")
    lines: dict[str, Line] = {}
    try:
        for row in reader:
            line = _line(row)
            if line.folder in lines:
                raise ValueError(f"got the folder {line.folder} twice, expected one for each film")
            lines[line.folder] = line
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}") from None
    return list(lines.values())


def _line(row: Mapping[str, Any]) -> Line:
    values: dict[str, Any] = {name: row[name] or "" for name in COLUMNS}
    source, folder, state = values["source"], values["folder"], values["state"]
    # where results are written
    if not source or folder != plain_name(folder) or state not in get_args(State):
        got = f"{source},{folder},{state}"[:60]
        raise ValueError(f"got {got!r}, expected a source, the name of its folder, and a state")
    for name, kind in NUMBERS.items():
        try:
            values[name] = kind(values[name])
        except ValueError:
            values[name] = None
    return Line(source, folder, FilmStatus(**{name: values[name] for name in STATUS_FIELDS}))


def write_index(out: Path, lines: Sequence[Line]) -> None:
    """Write the page over all films: how many are in which state, and each with its picture and its links."""
    states = Counter[str](line.status.state for line in lines)
    counted = {state: str(count) for state, count in sorted(states.items())}
    frames = sum(line.status.frames or 0 for line in lines)
    parts: list[Part] = []
    if len(lines) > MOST_PICTURES:
        parts.append(paragraph(f"Only the first {MOST_PICTURES} videos have images."))
    entries = [_entry(out, line, number < MOST_PICTURES) for number, line in enumerate(lines)]
    parts.append(Markup(_page.render(entries=entries)))
    cards = {"films": str(len(lines)), **counted, "frames": f"{frames:,}"}
    write_page(out / INDEX, Page(out.resolve().name, cards=cards, sections=[("Films", parts)]))


def _entry(out: Path, line: Line, pictured: bool) -> dict[str, Any]:
    status = line.status
    numbers = [
        f"{status.frames} frames" if status.frames is not None else "",
        f"{status.missing} missing" if status.missing else "",
        f"{status.tracks} tracks" if status.tracks is not None else "",
        f"{status.frames_per_second:.3g} a second" if status.frames_per_second is not None else "",
    ]
    files = {"film": "view.html", "video": "overlay.mp4", "tracks": "tracks.csv"}
    return {
        "name": line.folder,
        "source": line.source,
        "state": status.state,
        "error": status.error,
        "numbers": ", ".join(filter(None, numbers)),
        "picture": status.thumbnail if pictured else "",
        "links": {
            name: quote(f"{line.folder}/{file}")
            for name, file in files.items()
            if (out / line.folder / file).exists()
        },
    }

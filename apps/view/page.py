"""What a page consists of, and how it is written: cards, tables, pictures, plots, and a film to play.

A page is one HTML file that holds its film, pictures, plots, data and style itself. It asks nothing of any
network, follows the reader's light or dark setting, and prints. What is not `Markup` already is escaped.
"""

import base64
import json
import os
import sys
import webbrowser
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...models.files import write_text
from ..io.row_log import RowLog
from .film import Film

Array = NDArray[Any]
Image = NDArray[np.uint8]

VIEW = "view.html"

LINKED = {
    VIEW: "film with what was found",
    "overlay.mp4": "video",
    "events.html": "zones and lines",
    "tracks.csv": "tracks",
    "events.csv": "events",
    "structure.ply": "shape",
}
"""Files beside a page that people look at, and what a link to them says."""

BLUE, ORANGE, GREEN, RED = "#2f7fc1", "#d9822b", "#3a9a5b", "#d64545"

SEEN, PREDICTED = 0, 1
"""Kinds of spans."""

MOST_FRAMES = 20_000
"""Of a curve over the frames of a run; beyond, it is of the means of as many frames each as need be."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a plot.

    Parameters
    ----------
    values
        `(n,)`; NaN gives a gap.
    label
        name in the legend; empty for a single line.
    colour
        CSS colour.
    band
        `(n,)` lower and upper bounds.
    x
        `(n,)`; `None` for one value per frame of the run.
    style
        line, steps, or dots.
    colours
        CSS colour of each dot.
    """

    values: Array
    label: str = ""
    colour: str = BLUE
    band: tuple[Array, Array] | None = None
    x: Array | None = None
    style: Literal["line", "steps", "dots"] = "line"
    colours: Sequence[str] | None = None


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot, which the page draws.

    Parameters
    ----------
    name
        title of the plot.
    unit
        of the vertical axis.
    lines
        of one axis.
    caption
        below it.
    axis
        name of the horizontal axis with its unit; `None` for that of the run, with a cursor at the current
        frame.
    shaded
        intervals of the horizontal axis that are marked: beginning and end.
    dotted
        positions on it that are marked.
    is_map
        whether both axes have the same scale and the vertical one points down, as in images.
    """

    name: str
    unit: str
    lines: Sequence[Line]
    caption: str = ""
    axis: str | None = None
    shaded: Sequence[tuple[float, float]] = ()
    dotted: Sequence[float] = ()
    is_map: bool = False


def rates(seconds: Sequence[float]) -> Array:
    """Frames a second `(n,)`, each over the 25 frames around, of the seconds that every frame took.

    NaN where these took no time: at its end, a run with a lag answers many frames at once.
    """
    spent, at = np.concatenate([[0.0], np.cumsum(seconds)]), np.arange(len(seconds))
    first, after = np.maximum(at - 12, 0), np.minimum(at + 13, len(seconds))
    took = spent[after] - spent[first]
    each: Array = np.where(took > 1e-9, (after - first) / np.maximum(took, 1e-9), np.nan)
    return each


Part = Markup | Plot
Section = tuple[str, Sequence[Part]]
"""Heading, which may be empty, and parts."""


@dataclass(frozen=True, eq=False)
class TimelineRow:
    """A row over the frames of the film: its identity, label, colour as CSS has it, and spans.

    These are `(n, 3)`: first and last index of frames in the film, and `SEEN` or `PREDICTED`.
    """

    identity: int
    label: str
    colour: str
    spans: NDArray[np.int64]


def spans_of(seen: NDArray[np.bool_], frames: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """The spans of a thing that is there in `frames` `(n,)`, ascending, or in all, and `seen` in some."""
    if frames is None:
        frames = np.arange(len(seen))
    ends = np.flatnonzero((np.diff(frames) > 1) | np.diff(seen))
    first, last = np.append(0, ends + 1), np.append(ends, len(seen) - 1)
    return np.stack([frames[first], frames[last], np.where(seen[first], SEEN, PREDICTED)], axis=1)


@dataclass(frozen=True, eq=False)
class Page:
    """Content of a page, in order.

    Parameters
    ----------
    title
        heading.
    cards
        key numbers by name, in large letters.
    notes
        warnings, one sentence each.
    film
        video to play; `None` for a page without one.
    layers
        drawings over the video, in order: for each script in `templates/layers` its data, which may be JSON
        and arrays.
    timeline
        rows of the timeline below the video.
    plots
        over the frames of the run.
    sections
        tables, pictures and further plots, under headings.
    parameters
        all settings of the run; nested mappings become dotted names.
    numbers, times
        of all frames of the run: 1-based, and s.
    over
        horizontal axis of plots: times or frame numbers.
    """

    title: str
    cards: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    film: Film | None = None
    layers: Mapping[str, Any] = field(default_factory=dict)
    timeline: Sequence[TimelineRow] = ()
    plots: Sequence[Plot] = ()
    sections: Sequence[Section] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    numbers: Sequence[int] = ()
    times: Sequence[float] = ()
    over: Literal["time", "frame"] = "time"


class FrameRecord:
    """Numbers, times (s) and seconds of work of all frames of a run, and numbers of missing ones."""

    def __init__(self, log: RowLog) -> None:
        self.numbers: list[int] = log["number"].tolist()
        self.times: list[float] = log["time"].tolist()
        self.seconds: list[float] = log["seconds"].tolist()
        self.missing: list[int] = log["number"][log["missing"]].tolist()

    def page(self, title: str, summary: Mapping[str, Any], film: Film | None, **parts: Any) -> Page:
        """A page of these frames, with notes and parameters of the summary, and parts as of `Page`."""
        return Page(
            title,
            film=film,
            parameters=summary["parameters"],
            numbers=self.numbers,
            times=self.times,
            **{"notes": summary["notes"], **parts},
        )

    def spans(self, stretches: Iterable[tuple[int, int]]) -> list[tuple[float, float]]:
        """Times of the first and the last frame of stretches, which are given by numbers."""
        time_of = dict(zip(self.numbers, self.times, strict=True))
        return [(time_of[first], time_of[last]) for first, last in stretches]


# --- parts of sections ---


def paragraph(text: str) -> Markup:
    """A paragraph of plain text."""
    return Markup(_parts.paragraph(text))


def table(header: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "") -> Markup:
    """A table; numbers are rounded to four digits and set to the right. Rows are as long as the header."""
    lines = list(rows)
    for row in lines:
        if len(row) != len(header):
            raise ValueError(f"rows: got a row of {len(row)} cells, expected {len(header)}: {row!r}")
    return Markup(_parts.table(header, lines, caption))


def coloured(colour: str, text: object) -> Markup:
    """A cell of a table: a text behind a dot of a colour, CSS colour."""
    return Markup('<i style="background:{}"></i>{}').format(colour, text)


def flat(settings: Mapping[str, object], above: str = "") -> list[tuple[object, ...]]:
    """Name and value of every setting, mappings inside with dotted names."""
    rows: list[tuple[object, ...]] = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{above}{name}.")
        else:
            rows.append((f"{above}{name}", value))
    return rows


def picture(image: Image, caption: str = "") -> Markup:
    """A picture, `(height, width[, 3])` uint8, BGR: JPEG, or PNG for few values, which JPEG would smear."""
    few = image.ndim == 2 and len(np.unique(image)) <= 16
    kind, options = ("png", []) if few else ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 88])
    inlined = Markup(_parts.image(kind, encoded(image, f".{kind}", options), caption))
    return Markup(_parts.captioned(inlined, caption))


def picture_file(path: Path, caption: str) -> Markup:
    """A picture from a PNG file."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return Markup(_parts.captioned(Markup(_parts.image("png", data, caption)), caption))


def encoded(image: Image, kind: str, options: Sequence[int] = ()) -> str:
    """A picture as a file of that kind (`.png`, `.jpg`) with OpenCV's options, in base 64."""
    done, data = cv2.imencode(kind, image, options)
    if not done:
        raise ValueError(f"image: got {image.shape} {image.dtype}, which cannot be stored as {kind}")
    return base64.b64encode(data.tobytes()).decode("ascii")


# --- frames in words ---

MOST_LISTED = 20


def listed(numbers: Sequence[object], thing: str = "frame") -> str:
    """For instance "frames 3, 4, 7"; long lists are cut short."""
    text = shortened(numbers)
    return f"{thing}{'s' if len(numbers) > 1 or ' ' in text else ''} {text}"


def shortened(numbers: Sequence[object]) -> str:
    """For instance "3, 4, 7"; of long lists the beginning."""
    return ", ".join(map(str, numbers[:MOST_LISTED])) + (", …" if len(numbers) > MOST_LISTED else "")


def periods(all_numbers: Sequence[int], chosen: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of every run of chosen frames among all of them, both in order."""
    inside = np.isin(np.array(all_numbers), chosen)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    return [(all_numbers[first], all_numbers[after - 1]) for first, after in edges.reshape(-1, 2).tolist()]


def listed_periods(ranges: Sequence[tuple[int, int]]) -> str:
    """For instance "frames 5 to 7, 20"."""
    return listed([f"{first} to {last}" if last > first else str(first) for first, last in ranges])


def notes_on_missing(numbers: Sequence[int]) -> list[str]:
    """A sentence about frames without anything to see, if there are any."""
    return [f"Missing, unreadable or blank, and only predicted: {listed(numbers)}."] if numbers else []


# --- the page ---


def write_page(path: Path, page: Page) -> None:
    """Write a page as one HTML file, whole or not at all."""
    film = page.film
    plots: list[Plot] = list(page.plots)
    sections = []
    for heading, parts in page.sections:
        placed = []
        for part in parts:
            if isinstance(part, Plot):
                plots.append(part)
                placed.append(Markup(_parts.plot(len(plots) - 1)))
            else:
                placed.append(part)
        sections.append((heading, placed))
    bins = _Bins.of(len(page.numbers))
    data: dict[str, Any] = {
        "title": page.title,
        "over": page.over,
        "run": {
            "numbers": bins.means(page.numbers),
            "times": bins.means(page.times),
            "frames": len(page.numbers),
            "each": bins.width,
        },
        "plots": [_plot_data(plot, bins) for plot in plots],
        "rows": [
            {
                "id": row.identity,
                "label": row.label,
                "colour": row.colour,
                "spans": row.spans.astype(np.int32),
            }
            for row in page.timeline
        ],
        "layers": page.layers,
    }
    inlined = ""
    if film is not None:
        data |= {
            "size": film.size,
            "numbers": film.numbers.astype(np.int32),
            "times": film.times,
            "moments": film.moments,
        }
        if film.path is not None:
            inlined = base64.b64encode(film.path.read_bytes()).decode("ascii")
    text = _environment.get_template("page.html").render(
        page=page,
        links={
            name: text for name, text in LINKED.items() if name != path.name and (path.parent / name).exists()
        },
        sections=sections,
        parameters=table(("parameter", "value"), flat(page.parameters)) if page.parameters else None,
        with_data=bool(film is not None or plots),
        data=_json(data),
        film=Markup(inlined),
    )
    write_text(path, text)


@dataclass(frozen=True)
class _Bins:
    """Frames of a run in bins of equal width, one frame each unless they are many."""

    count: int
    width: int

    @classmethod
    def of(cls, count: int) -> "_Bins":
        return cls(count, max(1, -(-count // MOST_FRAMES)))

    def means(self, values: Iterable[Any]) -> NDArray[np.float64]:
        """Mean of the known values `(n,)` in each bin; NaN where there is none."""
        series = np.array(list(values), np.float64)
        if len(series) != self.count:
            raise ValueError(f"values: got {len(series)}, expected one for each of {self.count} frames")
        if self.width == 1:
            return series
        starts, known = np.arange(0, self.count, self.width), np.isfinite(series)
        total = np.add.reduceat(np.where(known, series, 0), starts)
        number = np.add.reduceat(known.astype(np.float64), starts)
        return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _plot_data(plot: Plot, bins: _Bins) -> dict[str, Any]:
    def values(line: Line, given: Array) -> NDArray[np.float32]:
        return (bins.means(given) if line.x is None else np.asarray(given)).astype(np.float32)

    lines = [
        {
            "label": line.label,
            "colour": line.colour,
            "style": line.style,
            "values": values(line, line.values),
            "band": None if line.band is None else [values(line, bound) for bound in line.band],
            "x": None if line.x is None else np.asarray(line.x, np.float64),
            "colours": line.colours,
        }
        for line in plot.lines
    ]
    caption = plot.caption
    if plot.axis is None and bins.width > 1:
        caption = f"{caption} Means over {bins.width} frames each.".strip()
    return {
        "name": plot.name,
        "unit": plot.unit,
        "lines": lines,
        "caption": caption,
        "axis": plot.axis,
        "shaded": [list(each) for each in plot.shaded],
        "dotted": list(plot.dotted),
        "isMap": plot.is_map,
    }


def _json(data: Any) -> Markup:
    """JSON in which an array is its type, shape and bytes in base 64, and nothing ends a script."""
    text = json.dumps(data, default=_packed, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _packed(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray):
        raise TypeError(f"got {type(value).__name__}, expected what JSON takes, or an array")
    array = np.ascontiguousarray(value)
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    name = f"{array.dtype.kind}{array.dtype.itemsize}"
    return {"array": name, "shape": array.shape, "bytes": base64.b64encode(array.tobytes()).decode("ascii")}


def templates_in(folder: Path) -> jinja2.Environment:
    """Templates of HTML: what is not `Markup` is escaped, and names that are not given are errors."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )


_TEMPLATES = Path(__file__).parent / "templates"
_environment = templates_in(_TEMPLATES)
_environment.globals["source"] = lambda name: Markup((_TEMPLATES / name).read_text(encoding="utf-8"))
_environment.filters["rounded"] = lambda value: (
    f"{value:.4g}" if isinstance(value, float | np.floating) else value
)
_environment.tests["numeric"] = lambda value: (
    isinstance(value, int | float | np.number) and not isinstance(value, bool)
)
_parts: Any = _environment.get_template("parts.html").module


def open_page(folder: Path) -> Path:
    """Show the page of a run or batch in the browser, where there is a screen, and return its path.

    A folder that holds none is a ValueError.
    """
    pages = (VIEW, "index.html")
    page = next((folder / name for name in pages if (folder / name).is_file()), None)
    if page is None:
        raise ValueError(
            f"{folder}: holds none of {', '.join(pages)}, expected the folder of a run's results"
        )
    # Windows and macOS need no variable that says where a browser may be shown
    screens = map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    if sys.platform in ("win32", "darwin") or any(screens):
        webbrowser.open(page.resolve().as_uri())  # without a browser nothing happens, and the page is named
    return page

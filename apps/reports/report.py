"""Self-contained HTML pages: the report of a run, and the parts that other pages are put together from.

A page holds its pictures, plots and style itself, asks nothing of any network, and follows the reader's light
or dark setting.
"""

import base64
import html
import io
import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import cv2
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...models.core.atomic_files import write_atomically
from ...models.core.frame import Frame
from ..drawing.boxes import identity_colour
from ..drawing.mosaic import fitting

Image = NDArray[np.uint8]

MOST_SNAPSHOTS = 8
SNAPSHOT_WIDTH = 480  # px; wider pictures are kept smaller
MOST_POINTS = 256  # of a track's path
MOST_ROWS = 100  # of the table of tracks
MOST_BINS = 600  # of a plot over time
SERIES = ("numbers", "times", "n_tracks", "foreground_share", "log_evidence", "seconds")  # per frame
INK = "#0a0b0c"  # stands for the reader's text colour in plots


class Html(str):
    """Text that is HTML already and must not be escaped."""

    __slots__ = ()


Section = tuple[str, Sequence[Html]]
"""Heading, which may be empty, and parts."""


class Located(Protocol):
    """Something with an identity and a box `(x, y, width, height)` px: a track, or the truth."""

    @property
    def identity(self) -> int:
        """Who it is."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Where it is: x, y of the top-left corner from 0, width, height, px."""


# What a run leaves behind


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A frame and what was made of it: pictures `(height, width[, 3])` uint8, BGR, all of one size."""

    number: int
    time: float
    picture: Image
    background: Image
    foreground: Image
    overlay: Image

    @cached_property
    def saved(self) -> list[Any]:
        """Number, time and the pictures in base 64, worked out once however often a run is saved."""
        pictures = (self.picture, self.background, self.foreground, self.overlay)
        return [self.number, self.time, *map(_encoded, pictures)]


@dataclass(eq=False)
class TrackHistory:
    """One track's life, in memory that does not grow with its length."""

    first: int
    last: int = 0
    n_frames: int = 0
    width: float = 0.0  # sums over frames, px
    height: float = 0.0
    foot: tuple[float, float] = (0.0, 0.0)  # where it was last
    path: list[tuple[float, float]] = field(default_factory=list)
    stride: int = 1

    def add(self, number: int, box: tuple[float, float, float, float]) -> None:
        """The track has `box` in frame `number`."""
        x, y, width, height = map(float, box)
        self.foot = (x + width / 2, y + height)
        if self.n_frames % self.stride == 0:
            self.path.append(self.foot)
            if len(self.path) > MOST_POINTS:
                del self.path[1::2]
                self.stride *= 2
        self.last = number
        self.n_frames += 1
        self.width += width
        self.height += height


@dataclass(eq=False)
class RunRecord:
    """What a report needs of a run, gathered frame by frame.

    Of a stream of any length it keeps at most eight evenly spaced snapshots (whenever there are more, every
    second one goes and the distance doubles), five numbers a frame, and per track a path of bounded length.
    """

    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    n_tracks: "array[float]" = field(default_factory=lambda: array("d"))
    foreground_share: "array[float]" = field(default_factory=lambda: array("d"))
    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    seconds: "array[float]" = field(default_factory=lambda: array("d"))
    tracks: dict[int, TrackHistory] = field(default_factory=dict)
    snapshots: list[Snapshot] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    stride: int = 1  # frames between snapshots
    next_snapshot: int = 0  # after how many frames it is due

    def add(
        self,
        frame: Frame,
        tracks: Sequence[Located],
        foreground: Image,
        background: Callable[[], Image],
        overlay: Callable[[], Image],
        log_evidence: float,
        seconds: float,
    ) -> None:
        """Take in one frame.

        Parameters
        ----------
        frame
            the frame; a missing one is counted, its numbers are left out of the plots.
        tracks
            tracks shown in this frame.
        foreground
            `(height, width)` uint8, 0 or 255.
        background, overlay
            called for the few frames of which pictures are kept; `(height, width[, 3])` uint8, BGR.
        log_evidence
            of the whole frame, nats; NaN where it was not worked out.
        seconds
            that the frame's processing took.
        """
        seen = frame.image is not None
        count = len(self.numbers)
        self.numbers.append(frame.number)
        self.times.append(frame.time)
        self.n_tracks.append(len(tracks))
        self.foreground_share.append(
            float(np.count_nonzero(foreground)) / foreground.size if seen else np.nan
        )
        self.log_evidence.append(log_evidence / foreground.size if seen else np.nan)
        self.seconds.append(seconds)
        for track in tracks:
            history = self.tracks.setdefault(track.identity, TrackHistory(frame.number))
            history.add(frame.number, track.box)
        if frame.image is None:
            self.missing.append(frame.number)
        elif count >= self.next_snapshot:
            pictures = (frame.image, background(), foreground, overlay())
            self.snapshots.append(Snapshot(frame.number, frame.time, *map(small, pictures)))
            if len(self.snapshots) > MOST_SNAPSHOTS:
                del self.snapshots[1::2]
                self.stride *= 2
            self.next_snapshot = count + self.stride

    def saved(self) -> dict[str, Any]:
        """Everything as plain JSON; the snapshots' pictures in base 64."""
        return {
            "series": {name: base64.b64encode(getattr(self, name).tobytes()).decode() for name in SERIES},
            "tracks": [[identity, asdict(history)] for identity, history in self.tracks.items()],
            "snapshots": [each.saved for each in self.snapshots],
            "missing": self.missing,
            "stride": self.stride,
            "next_snapshot": self.next_snapshot,
        }

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> "RunRecord":
        """The record of which `saved` was kept."""
        record = cls(
            missing=list(data["missing"]), stride=data["stride"], next_snapshot=data["next_snapshot"]
        )
        for name in SERIES:
            getattr(record, name).frombytes(base64.b64decode(data["series"][name]))
        for identity, history in data["tracks"]:
            path = [(x, y) for x, y in history.pop("path")]
            record.tracks[identity] = TrackHistory(path=path, **history)
        for number, time, *pictures in data["snapshots"]:
            record.snapshots.append(Snapshot(number, time, *map(_decoded, pictures)))
        return record


def _encoded(image: Image) -> str:
    """A picture in base 64: masks as PNG, photographs as JPEG, as which the page holds them anyway."""
    kind, options = (".png", []) if image.ndim == 2 else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 95])
    done, data = cv2.imencode(kind, image, options)
    if not done:
        raise ValueError(f"image: got {image.shape} {image.dtype}, which cannot be stored as {kind}")
    return base64.b64encode(data.tobytes()).decode("ascii")


def _decoded(text: str) -> Image:
    data = np.frombuffer(base64.b64decode(text), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)


def small(image: Image, most: int = SNAPSHOT_WIDTH) -> Image:
    """A copy that is at most so many px wide, and four times as high."""
    size = fitting(image.shape, most)
    if size[1] >= image.shape[0]:
        return image.copy()
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


# The report of a run


def write_report(
    path: Path,
    record: RunRecord,
    background: Image,
    parameters: Mapping[str, object],
    metrics: Mapping[str, object] | None = None,
    title: str = "Background and tracks",
) -> None:
    """Write the report of a run as one HTML file.

    Parameters
    ----------
    path
        file to write; it appears when it is complete.
    record
        what the run left behind, with one frame at least.
    background
        `(height, width[, 3])` uint8, BGR: the picture of the background at the end.
    parameters
        every setting of the run; mappings inside become dotted names.
    metrics
        figures against the ground truth, if there was one.
    title
        heading of the page.

    Raises
    ------
    ValueError
        if the record holds no frame.
    OSError
        if the file cannot be written.
    """
    if not record.numbers:
        raise ValueError("record: got no frame, expected one at least")
    sections: list[Section] = []
    if metrics:
        sections.append(("Against the ground truth", [table(("measure", "value"), flat(metrics))]))
    sections.append(("Pictures over time", [_strip(record.snapshots)]))
    text = "Where the feet went, on the background at the end: from the ring to the dot with the number."
    sections.append(("Tracks", [picture(draw_tracks(background, record.tracks), text), _track_table(record)]))
    sections.append(("Over time", [_plots(record)]))
    write_run_page(path, title, _summary(record, background), (), sections, parameters)


def write_run_page(
    path: Path,
    title: str,
    summary: Html,
    notes: Iterable[str],
    sections: Iterable[Section],
    parameters: Mapping[str, object],
) -> None:
    """Write a page about a run: its summary and what is out of the ordinary first, every setting last.

    Raises
    ------
    OSError
        if the file cannot be written; nothing half-written stays behind.
    """
    beginning = [summary, *map(paragraph, notes)]
    settings = table(("parameter", "value"), flat(parameters))
    write_page(path, title, [("", beginning), *sections, ("Parameters", [settings])])


def draw_tracks(background: Image, tracks: Mapping[int, TrackHistory]) -> Image:
    """Every track's path on a picture, `(height, width, 3)` uint8 with 960 px or more at its longer side."""
    scale = max(1.0, 960 / max(background.shape[:2]))
    size = (round(background.shape[1] * scale), round(background.shape[0] * scale))
    canvas = cv2.resize(_in_colour(background), size, interpolation=cv2.INTER_CUBIC)
    canvas = cv2.addWeighted(canvas, 0.75, np.full_like(canvas, 128), 0.25, 0)  # paler than the paths
    edge = (20, 20, 20)
    ends = {}
    for identity, history in sorted(tracks.items()):
        colour = identity_colour(identity)
        points = np.rint((np.array([*history.path, history.foot]) + 0.5) * scale).astype(np.int32)
        start, ends[identity] = ((int(x), int(y)) for x, y in (points[0], points[-1]))
        for ink, thickness in ((edge, 4), (colour, 2)):
            cv2.polylines(canvas, [points], False, ink, thickness, cv2.LINE_AA)
            cv2.circle(canvas, start, 6, ink, thickness, cv2.LINE_AA)
    for identity, (x, y) in ends.items():  # above all paths
        colour = identity_colour(identity)
        label = str(identity)
        beside = x + 9 if x + 9 + 12 * len(label) < size[0] else x - 9 - 12 * len(label)
        place = (max(beside, 2), min(max(y + 5, 14), size[1] - 4))
        for ink, radius in ((edge, 7), (colour, 5)):
            cv2.circle(canvas, (x, y), radius, ink, cv2.FILLED, cv2.LINE_AA)
        for ink, thickness in ((edge, 4), ((255, 255, 255), 1)):
            cv2.putText(canvas, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, ink, thickness, cv2.LINE_AA)
    return np.asarray(canvas, np.uint8)


def _summary(record: RunRecord, background: Image) -> Html:
    spent = sum(record.seconds)
    figures = {
        "frames": f"{len(record.numbers)}",
        "missing": f"{len(record.missing)}",
        "first and last": f"{record.numbers[0]} – {record.numbers[-1]}",
        "duration": f"{record.times[-1] - record.times[0]:.1f} s",
        "picture": f"{background.shape[1]} × {background.shape[0]} px",
        "frames a second, model": f"{len(record.numbers) / spent:.1f}" if spent > 0 else "–",
        "tracks": f"{len(record.tracks)}",
    }
    note = Html("")
    if record.missing:
        listed = ", ".join(map(str, record.missing[:20])) + (", …" if len(record.missing) > 20 else "")
        note = paragraph(f"Missing or unreadable frames, over which the chains only predicted: {listed}.")
    return Html(cards(figures) + note)


def _strip(snapshots: Sequence[Snapshot]) -> Html:
    """Rows input, background, foreground, overlay; a column per snapshot."""
    if not snapshots:
        return paragraph("No frame could be read.")
    rows = [
        ("input", [each.picture for each in snapshots]),
        ("background", [each.background for each in snapshots]),
        ("foreground", [each.foreground for each in snapshots]),
        ("overlay", [each.overlay for each in snapshots]),
    ]
    return picture_grid(rows, [f"frame {each.number}, {each.time:.1f} s" for each in snapshots])


def _track_table(record: RunRecord) -> Html:
    longest = sorted(record.tracks.items(), key=lambda item: -item[1].n_frames)[:MOST_ROWS]
    rows = [
        (
            Html(f'<i style="background:{_css(identity_colour(identity))}"></i>{identity}'),
            history.first,
            history.last,
            history.n_frames,
            f"{history.width / history.n_frames:.0f} × {history.height / history.n_frames:.0f}",
        )
        for identity, history in sorted(longest)
    ]
    if not rows:
        return paragraph("There was no track.")
    caption = (
        f"The {MOST_ROWS} longest of {len(record.tracks)} tracks." if len(record.tracks) > MOST_ROWS else ""
    )
    return table(("identity", "first frame", "last frame", "frames", "mean size, px"), rows, caption)


def _plots(record: RunRecord) -> Html:
    """Four curves over the time of the video."""
    times = np.array(record.times)
    count = len(times)
    width = -(-count // MOST_BINS)
    starts = np.arange(0, count, width)
    widths = np.diff(starts, append=count)

    def mean(values: Iterable[float]) -> NDArray[np.float64]:
        series = np.array(list(values), np.float64)
        known = np.isfinite(series)
        total = np.add.reduceat(np.where(known, series, 0), starts)
        number = np.add.reduceat(known.astype(np.float64), starts)
        return np.where(number > 0, total / np.maximum(number, 1), np.nan)

    spent = np.add.reduceat(np.array(record.seconds), starts)
    curves = [
        ("tracks", mean(record.n_tracks)),
        ("foreground, %", 100 * mean(record.foreground_share)),
        ("log evidence\na pixel, nats", mean(record.log_evidence)),
        ("frames a second, model", np.where(spent > 0, widths / np.maximum(spent, 1e-9), np.nan)),
    ]

    def draw(canvas: Figure) -> None:
        axes = canvas.subplots(len(curves), sharex=True)
        for axis, (name, values) in zip(axes, curves, strict=True):
            known = np.isfinite(values)
            axis.plot(
                times[starts][known], values[known], color="#2f7fc1", linewidth=1.2, drawstyle="steps-post"
            )
            axis.set_ylabel(name)
            axis.margins(x=0.01, y=0.12)
            if not name.startswith("log"):
                axis.set_ylim(bottom=0)
        axes[0].yaxis.get_major_locator().set_params(integer=True)
        axes[-1].set_xlabel("time in the video, s")
        canvas.align_ylabels()

    note = "" if width == 1 else f"Means over {width} frames each."
    return figure(draw, (11, 7.5), note)


# Parts of a page


def cards(figures: Mapping[str, str]) -> Html:
    """Values in large letters above their names."""
    each = (
        f"<div><b>{_escaped(value)}</b><span>{_escaped(name)}</span></div>" for name, value in figures.items()
    )
    return Html(f'<div class="cards">{"".join(each)}</div>')


def flat(settings: Mapping[str, object], above: str = "") -> list[tuple[object, ...]]:
    """Name and value of every setting, mappings inside with dotted names."""
    rows: list[tuple[object, ...]] = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{above}{name}.")
        else:
            rows.append((f"{above}{name}", value))
    return rows


def paragraph(text: str) -> Html:
    """A paragraph of plain text."""
    return Html(f"<p>{_escaped(text)}</p>")


def strong(value: object) -> Html:
    """A table cell that stands out."""
    return Html(f"<strong>{_escaped(_formatted(value))}</strong>")


def table(header: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "") -> Html:
    """A table; numbers are rounded to four digits and set to the right, `Html` cells are taken as they are.

    Raises
    ------
    ValueError
        if a row has another number of cells than the header.
    """
    lines = []
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"rows: got a row of {len(row)} cells, expected {len(header)}: {row!r}")
        cells = (f"<td{_alignment(cell)}>{_escaped(_formatted(cell))}</td>" for cell in row)
        lines.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(f'<th scope="col">{_escaped(name)}</th>' for name in header)
    above = f"<caption>{_escaped(caption)}</caption>" if caption else ""
    body = "\n".join(lines)
    return Html(
        f'<div class="wide"><table>{above}<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def picture(image: Image, caption: str = "") -> Html:
    """A picture, `(height, width[, 3])` uint8, BGR."""
    below = f"<figcaption>{_escaped(caption)}</figcaption>" if caption else ""
    return Html(f"<figure>{_inlined(image, caption)}{below}</figure>")


def picture_grid(rows: Sequence[tuple[str, Sequence[Image]]], columns: Sequence[str]) -> Html:
    """Pictures in named rows under named columns.

    Raises
    ------
    ValueError
        if a row has another number of pictures than there are columns.
    """
    lines = []
    for name, images in rows:
        if len(images) != len(columns):
            raise ValueError(f"rows: got {len(images)} pictures in row {name!r}, expected {len(columns)}")
        cells = (
            f"<td>{_inlined(image, f'{name}, {column}')}</td>"
            for image, column in zip(images, columns, strict=True)
        )
        lines.append(f'<tr><th scope="row">{_escaped(name)}</th>{"".join(cells)}</tr>')
    head = "".join(f'<th scope="col">{_escaped(column)}</th>' for column in columns)
    body = "\n".join(lines)
    return Html(
        f'<div class="wide"><table class="grid"><thead><tr><td></td>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def figure(draw: Callable[[Figure], None], size: tuple[float, float], caption: str = "") -> Html:
    """A plot as inline SVG, in the reader's text colour.

    Parameters
    ----------
    draw
        draws on an empty matplotlib figure; no global state is touched.
    size
        `(width, height)` inches.
    """
    with _plot_style(caption):
        canvas = Figure(figsize=size, layout="constrained")
        draw(canvas)
        written = io.StringIO()
        canvas.savefig(written, format="svg", transparent=True, metadata={"Date": None})
    svg = written.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # names that every plot shares would clash on a page with several
    svg = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", svg)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{_escaped(caption or "plot")}" ', 1)
    below = f"<figcaption>{_escaped(caption)}</figcaption>" if caption else ""
    return Html(f"<figure>{svg}{below}</figure>")


def write_figure(path: Path, draw: Callable[[Figure], None], size: tuple[float, float]) -> None:
    """Write a plot as PNG, whole or not at all; parameters as of `figure`.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    with _plot_style(path.name):
        canvas = Figure(figsize=size, layout="constrained")
        draw(canvas)
        with write_atomically(path) as unfinished:
            canvas.savefig(unfinished, format="png", dpi=110)


def _plot_style(salt: str) -> AbstractContextManager[None]:
    """Settings of matplotlib; the salt makes the same page on every run."""
    style: dict[Any, object] = {
        "svg.fonttype": "none",
        "svg.hashsalt": salt or "plot",
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.alpha": 0.18,
        "legend.frameon": False,
    }
    inked = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return matplotlib.rc_context(style | dict.fromkeys(inked, INK))


def write_page(path: Path, title: str, sections: Iterable[Section]) -> None:
    """Write a page of sections as one HTML file.

    Raises
    ------
    OSError
        if the file cannot be written; nothing half-written stays behind.
    """
    body = "\n".join(
        f"<section>{f'<h2>{_escaped(heading)}</h2>' if heading else ''}\n{chr(10).join(parts)}\n</section>"
        for heading, parts in sections
    )
    page = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_escaped(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{_escaped(title)}</h1>\n{body}\n</body>\n</html>\n"
    )
    unfinished = path.with_name(path.name + ".part")
    try:
        unfinished.write_text(page, encoding="utf-8")
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise


STYLE = """
:root { color-scheme: light dark; --line: rgba(128, 128, 128, .35); --soft: rgba(128, 128, 128, .1); }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1320px; margin: 0 auto; padding: 1rem 1.5rem 4rem; }
h1 { font-size: 1.6rem; margin: 1rem 0; }
h2 { font-size: 1.15rem; margin: 2.4rem 0 .8rem; padding-bottom: .25rem; }
h2, th, td { border-bottom: 1px solid var(--line); }
p { max-width: 75ch; }
.cards { display: flex; flex-wrap: wrap; gap: .6rem; }
.cards div { background: var(--soft); border-radius: 6px; padding: .5rem .9rem; }
.cards b { display: block; font-size: 1.2rem; font-variant-numeric: tabular-nums; }
.cards span, caption, figcaption { opacity: .75; font-size: .9rem; }
caption { text-align: left; padding: .2rem 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0; }
th, td { text-align: left; padding: .25rem .9rem .25rem 0; vertical-align: top; }
td.number { text-align: right; }
td i { display: inline-block; width: .8em; height: .8em; border-radius: 50%; margin-right: .5em; }
table.grid th, table.grid td { border: 0; padding: .15rem; vertical-align: middle; }
table.grid th { font-weight: normal; font-size: .9rem; }
table.grid th[scope=row] { padding-right: .6rem; }
table.grid tbody td { min-width: 150px; }
figure { margin: .6rem 0; }
img { max-width: 100%; height: auto; display: block; border-radius: 3px; }
table.grid img { width: 100%; outline: 1px solid var(--line); }
svg { max-width: 100%; height: auto; }
"""


def _inlined(image: Image, description: str) -> Html:
    """An image as part of the page: JPEG, or PNG for pictures of few values, which JPEG would smear."""
    few = image.ndim == 2 and len(np.unique(image)) <= 16
    kind, options = ("png", []) if few else ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 88])
    done, data = cv2.imencode(f".{kind}", image, options)
    if not done:
        raise ValueError(f"image: got {image.shape} {image.dtype}, which cannot be stored as {kind}")
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return Html(f'<img src="data:image/{kind};base64,{text}" alt="{_escaped(description)}">')


def _in_colour(image: Image) -> Image:
    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def _escaped(text: str) -> str:
    return text if isinstance(text, Html) else html.escape(text)


def _formatted(value: object) -> str:
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return value if isinstance(value, str) else str(value)


def _alignment(value: object) -> str:
    numeric = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return ' class="number"' if numeric else ""


def _css(colour: tuple[int, int, int]) -> str:
    blue, green, red = colour
    return f"rgb({red}, {green}, {blue})"

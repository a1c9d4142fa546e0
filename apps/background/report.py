"""The report of a background run as one page: pictures, tracks, numbers over time."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ..drawing.boxes import identity_colour
from ..events.drawing import draw_zones
from ..events.report import Happened
from ..events.zones import Zones
from ..reports.frame_lists import shortened
from ..reports.page import Section, cards, flat, paragraph, picture, picture_grid, table, write_run_page
from ..reports.plots import figure
from .record import RunRecord, Snapshot, TrackHistory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Image = NDArray[np.uint8]

MOST_ROWS = 100  # of the table of tracks
MOST_BINS = 600  # of a plot over time


def write_report(
    path: Path,
    record: RunRecord,
    background: Image,
    parameters: Mapping[str, object],
    metrics: Mapping[str, object] | None = None,
    title: str = "Background and tracks",
    detections: Mapping[str, int] | None = None,
    happened: Happened | None = None,
    coming: Sequence[str] = (),
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
    detections
        how many `boxes` a detector has found, and in how many `frames` it looked, if it was given.
    happened
        what happened to zones and lines, if there were any.
    coming
        names of files that will lie beside it, to be linked.

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
    sections.append(("Pictures over time", [_strip(record.snapshots.kept)]))
    text = "Where the feet went, on the background at the end: from the ring to the dot with the number."
    drawn = draw_tracks(background, record.tracks, None if happened is None else happened.zones)
    sections.append(("Tracks", [picture(drawn, text), _track_table(record)]))
    if happened is not None:
        sections += happened.sections()
    sections.append(("Over time", [_plots(record)]))
    summary = _summary(record, background, detections)
    write_run_page(path, title, summary, (), sections, parameters, coming)


def draw_tracks(background: Image, tracks: Mapping[int, TrackHistory], zones: Zones | None = None) -> Image:
    """Every track's path on a picture, `(height, width, 3)` uint8 with 960 px or more at its longer side."""
    scale = max(1.0, 960 / max(background.shape[:2]))
    size = (round(background.shape[1] * scale), round(background.shape[0] * scale))
    canvas = cv2.resize(_in_colour(background), size, interpolation=cv2.INTER_CUBIC)
    canvas = cv2.addWeighted(canvas, 0.75, np.full_like(canvas, 128), 0.25, 0)  # paler than the paths
    if zones is not None:
        draw_zones(canvas, zones, scale)
    edge = (20, 20, 20)
    ends = {}
    for identity, history in sorted(tracks.items()):
        colour = identity_colour(identity)
        points = np.rint((np.array([*history.path.kept, history.foot]) + 0.5) * scale).astype(np.int32)
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


def _summary(record: RunRecord, background: Image, detections: Mapping[str, int] | None) -> Markup:
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
    if detections is not None:
        figures["detections, grey in the pictures"] = f"{detections['boxes']}"
        figures["frames with a detector"] = f"{detections['frames']}"
    note = Markup("")
    if record.missing:
        missing = shortened(record.missing)
        note = paragraph(f"Missing or unreadable frames, over which the chains only predicted: {missing}.")
    return Markup(cards(figures) + note)


def _strip(snapshots: Sequence[Snapshot]) -> Markup:
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


def _track_table(record: RunRecord) -> Markup:
    longest = sorted(record.tracks.items(), key=lambda item: -item[1].n_frames)[:MOST_ROWS]
    rows = [
        (
            Markup(f'<i style="background:{_css(identity_colour(identity))}"></i>{identity}'),
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


def _plots(record: RunRecord) -> Markup:
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

    def draw(canvas: "Figure") -> None:
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


def _in_colour(image: Image) -> Image:
    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def _css(colour: tuple[int, int, int]) -> str:
    blue, green, red = colour
    return f"rgb({red}, {green}, {blue})"

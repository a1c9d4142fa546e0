"""The page of a background run: objects and outlines over the film, tracks, numbers over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import GivenBoxes
from ...models.numerics.evenly_spaced import evenly_spaced
from ..events.page import ZoneEvents
from ..events.watch import Event
from ..io.row_log import RowLog
from ..io.tracks import TrackedObject
from ..io.zones import Zones
from ..view.film import LONGEST_SIDE, Film, Row
from ..view.overlay import css_colour, draw_zones, identity_colour
from ..view.page import (
    FrameRecord,
    Line,
    Page,
    Plot,
    Section,
    TimelineRow,
    coloured,
    flat,
    listed,
    paragraph,
    picture,
    rates,
    spans_of,
    table,
)

MOST_POINTS = 256
"""Of a track's path."""


@dataclass(frozen=True, eq=False)
class TrackHistory:
    """The life of a track: numbers of its first and last frame, and in how many it is reported.

    Width and height are means over these, px; `path (n, 2)` px is where its feet were in the first frame, in
    some between, and in the last one.
    """

    first: int
    last: int
    n_frames: int
    width: float
    height: float
    path: NDArray[np.float64]


class RunRecord(FrameRecord):
    """Numbers of all frames `(n_frames,)` of a run's log, and the tracks by identity."""

    def __init__(self, log: RowLog) -> None:
        super().__init__(log)
        self.n_tracks, self.foreground_share, self.log_evidence = (
            log[name] for name in ("objects", "foreground", "log_evidence")
        )
        ids, frames = log.objects("id"), np.repeat(log["number"], log["objects"])
        x, y, width, height = (log.objects(name) for name in ("x", "y", "width", "height"))
        feet = np.stack([x + width / 2, y + height], axis=1)
        order = np.argsort(ids, kind="stable")
        self.tracks: dict[int, TrackHistory] = {}
        for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(ids) else ():
            path = feet[rows[evenly_spaced(len(rows), MOST_POINTS)]]
            self.tracks[int(ids[rows[0]])] = TrackHistory(
                int(frames[rows[0]]),
                int(frames[rows[-1]]),
                len(rows),
                float(width[rows].mean()),
                float(height[rows].mean()),
                path,
            )


Image = NDArray[np.uint8]

OF_TRACKS = ("id", "box", "confidence", "velocity", "seen", "covariance")
OF_OUTLINES = ("outline", "corners")

MOST_ROWS = 100
"""Of the table of tracks."""
LEAST_SIDE = 960
"""px of the longer side of the picture with all paths."""


def view_row_of(
    foreground: NDArray[np.uint8], tracks: Sequence[TrackedObject], given: GivenBoxes | None = None
) -> Row:
    """What is drawn on a frame, in px of the source: objects, outlines of the foreground, given boxes."""
    outlines = _outlines(foreground)
    covariances = np.array([track.position_covariance for track in tracks], np.float32).reshape(-1, 4)
    boxes = np.zeros((0, 4)) if given is None else given.xyxy
    return {
        "id": np.array([track.identity for track in tracks], np.int32),
        "box": np.array([track.box for track in tracks], np.float32).reshape(-1, 4),
        "confidence": np.array([track.confidence for track in tracks], np.float32),
        "velocity": np.array([track.velocity for track in tracks], np.float32).reshape(-1, 2),
        "seen": np.array([track.seen for track in tracks], np.uint8),
        "covariance": covariances[:, [0, 1, 3]],
        "outline": np.concatenate([np.zeros((0, 2), np.int16), *outlines]),
        "corners": np.array([len(outline) for outline in outlines], np.int32),
        "given": np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]]).astype(np.float32),
    }


def _outlines(foreground: NDArray[np.uint8]) -> list[NDArray[np.int16]]:
    """Polygons around the foreground, and around its holes."""
    near = max(1.0, max(foreground.shape) / LONGEST_SIDE)  # px of the source: about one of the film
    found, _ = cv2.findContours(foreground, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    polygons = [cv2.approxPolyDP(contour, near, closed=True)[:, 0].astype(np.int16) for contour in found]
    return [polygon for polygon in polygons if len(polygon) > 2]


def background_page(
    title: str,
    record: RunRecord,
    summary: Mapping[str, Any],
    film: Film | None,
    background: Image | None,
    zone_events: ZoneEvents | None = None,
) -> Page:
    """Fill the page of a run.

    The film has columns of `view_row_of`, and is `None` if no frame could be read; `background` is the
    picture `(height, width[, 3])` uint8, BGR, at the end.
    """
    zones = None if zone_events is None else zone_events.zones
    sections: list[Section] = []
    if summary["metrics"]:
        sections.append(("Against the ground truth", [table(("measure", "value"), flat(summary["metrics"]))]))
    tracks: list[Any] = [_track_table(record)]
    if background is not None:
        text = "Paths of the feet on the last background image: from the ring to the dot with the identity."
        tracks.insert(0, picture(draw_paths(background, record.tracks, zones), text))
    sections.append(("Tracks", tracks))
    if zone_events is not None:
        sections += zone_events.sections()
    layers, timeline = ({}, []) if film is None else over_the_film(film, zone_events)
    missing = [f"Missing or unreadable, and only predicted: {listed(record.missing)}."] * bool(record.missing)
    return record.page(
        title,
        summary,
        film,
        cards=_cards(record, summary),
        notes=[*summary["notes"], *missing],
        layers=layers,
        timeline=timeline,
        plots=_plots(record),
        sections=sections,
    )


def _cards(record: RunRecord, summary: Mapping[str, Any]) -> dict[str, str]:
    spent, times = sum(record.seconds), record.times
    width, height = summary["size"]
    cards = {
        "frames": f"{summary['frames']}",
        "missing": f"{summary['missing_frames']}",
        "first and last": f"{summary['first_frame']} – {summary['last_frame']}",
        "duration": f"{times[-1] - times[0]:.1f} s" if times else "–",
        "picture": f"{width} × {height} px",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, model": f"{len(record.numbers) / spent:.1f}" if spent > 0 else "–",
        "tracks": f"{summary['tracks']}",
    }
    if (given := summary["detections"]) is not None:
        cards |= {"detections": f"{given['boxes']}", "frames with a detector": f"{given['frames']}"}
    return cards


def _plots(record: RunRecord) -> list[Plot]:
    times, evidence = np.array(record.times), np.array(record.log_evidence)
    known = np.isfinite(evidence)  # it is not worked out for every frame
    return [
        Plot("tracks", "", [Line(np.array(record.n_tracks), style="steps")]),
        Plot("foreground", "%", [Line(100 * np.array(record.foreground_share))]),
        Plot("log evidence a pixel", "nats", [Line(evidence[known], x=times[known])]),
        Plot("frames a second, model", "", [Line(rates(record.seconds))]),
    ]


def _track_table(record: RunRecord) -> Any:
    if not record.tracks:
        return paragraph("There was no track.")
    longest = sorted(record.tracks.items(), key=lambda item: -item[1].n_frames)[:MOST_ROWS]
    rows = [
        (
            coloured(css_colour(identity_colour(identity)), identity),
            history.first,
            history.last,
            history.n_frames,
            f"{history.width:.0f} × {history.height:.0f}",
        )
        for identity, history in sorted(longest)
    ]
    count = len(record.tracks)
    caption = f"The {MOST_ROWS} longest of {count} tracks." if count > MOST_ROWS else ""
    return table(("identity", "first frame", "last frame", "frames", "mean size, px"), rows, caption)


def draw_paths(background: Image, tracks: Mapping[int, TrackHistory], zones: Zones | None = None) -> Image:
    """Every track's path on a picture, `(height, width, 3)` uint8 with 960 px or more at its longer side."""
    scale = max(1.0, LEAST_SIDE / max(background.shape[:2]))
    size = (round(background.shape[1] * scale), round(background.shape[0] * scale))
    canvas = cv2.cvtColor(background, cv2.COLOR_GRAY2BGR) if background.ndim == 2 else background
    canvas = cv2.resize(canvas, size, interpolation=cv2.INTER_CUBIC)
    canvas = cv2.addWeighted(canvas, 0.75, np.full_like(canvas, 128), 0.25, 0)  # paler than the paths
    if zones is not None:
        draw_zones(canvas, zones, scale)
    edge = (20, 20, 20)
    ends = {}
    for identity, history in sorted(tracks.items()):
        colour = identity_colour(identity)
        points = np.rint((history.path + 0.5) * scale).astype(np.int32)
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


def over_the_film(
    film: Film, zone_events: ZoneEvents | None = None
) -> tuple[dict[str, Any], list[TimelineRow]]:
    """What is drawn over a film with columns of `view_row_of`, and a row for each object."""
    layer = {name: film.columns[name] for name in (*OF_TRACKS, *OF_OUTLINES, "given")}
    for name, of in (("count", "id"), ("polygons", "corners"), ("givenCount", "given")):
        layer[name] = film.counts[of].astype(np.int32)
    zones, events = (Zones(), ()) if zone_events is None else (zone_events.zones, zone_events.events)
    shown = [event for event in events if film.numbers[0] <= event.moment.frame <= film.numbers[-1]]
    shown.sort(key=lambda event: event.moment.time)  # a stay that ends is known late
    layers = {"events": list(map(_plain, shown)), "zones": zones.plain(), "tracks": layer}
    return layers, _timeline(film)


def _timeline(film: Film) -> list[TimelineRow]:
    """A row for each object of the film."""
    ids, counts = film.columns["id"], film.counts["id"]
    order = np.argsort(ids, kind="stable")
    frames = np.repeat(np.arange(len(counts)), counts)[order]
    seen = film.columns["seen"][order].astype(np.bool_)
    identities, starts = np.unique(ids[order], return_index=True)
    ends = np.append(starts, len(ids))[1:]
    return [
        TimelineRow(
            identity,
            str(identity),
            css_colour(identity_colour(identity)),
            spans_of(seen[start:end], frames[start:end]),
        )
        for identity, start, end in zip(identities.tolist(), starts, ends, strict=True)
    ]


def _plain(event: Event) -> dict[str, object]:
    lasted = "" if event.duration is None else f"{event.duration:.1f} s"
    return {
        "frame": event.moment.frame,
        "time": event.moment.time,
        "id": event.identity,
        "kind": event.kind.value,
        "zone": event.zone,
        "more": event.direction or lasted,
    }

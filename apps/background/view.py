"""The background application's part of `view.html`: tracked objects and outlines of the foreground."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..drawing.boxes import css_colour, identity_colour
from ..events.report import Happened
from ..events.watch import Event
from ..events.zones import Zones
from ..io.mot import TrackedObject
from ..view.film import LONGEST_SIDE, Film, Row
from ..view.page import Plot, TimelineRow, View, spans_of

OF_TRACKS = ("id", "box", "confidence", "velocity", "seen", "covariance")
OF_OUTLINES = ("outline", "corners")


def drawn_of(foreground: NDArray[np.uint8], tracks: Sequence[TrackedObject]) -> Row:
    """What is drawn on a frame: objects, and the foreground's outlines, in px of the source.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, 0 or 255.
    tracks
        objects of the frame.
    """
    outlines = _outlines(foreground)
    covariances = np.array([track.position_covariance for track in tracks], np.float32).reshape(-1, 4)
    return {
        "id": np.array([track.identity for track in tracks], np.int32),
        "box": np.array([track.box for track in tracks], np.float32).reshape(-1, 4),
        "confidence": np.array([track.confidence for track in tracks], np.float32),
        "velocity": np.array([track.velocity for track in tracks], np.float32).reshape(-1, 2),
        "seen": np.array([track.seen for track in tracks], np.uint8),
        "covariance": covariances[:, [0, 1, 3]],
        "outline": np.concatenate([np.zeros((0, 2), np.int16), *outlines]),
        "corners": np.array([len(outline) for outline in outlines], np.int32),
        "foreground": np.array([np.count_nonzero(foreground) / foreground.size], np.float32),
    }


def _outlines(foreground: NDArray[np.uint8]) -> list[NDArray[np.int16]]:
    """Polygons around the foreground, and around its holes."""
    near = max(1.0, max(foreground.shape) / LONGEST_SIDE)  # px of the source: about one of the film
    found, _ = cv2.findContours(foreground, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    polygons = [cv2.approxPolyDP(contour, near, closed=True)[:, 0].astype(np.int16) for contour in found]
    return [polygon for polygon in polygons if len(polygon) > 2]


def tracks_view(film: Film, happened: Happened | None = None) -> View:
    """The page of a film with what `drawn_of` gives, and with what `happened` to zones that were watched."""
    ids, counts = film.columns["id"], film.counts["id"]
    order = np.argsort(ids, kind="stable")
    frames = np.repeat(np.arange(len(counts)), counts)[order]
    seen = film.columns["seen"][order].astype(np.bool_)
    identities, starts = np.unique(ids[order], return_index=True)
    ends = np.append(starts, len(ids))[1:]
    rows = [
        TimelineRow(
            identity,
            str(identity),
            css_colour(identity_colour(identity)),
            spans_of(seen[start:end], frames[start:end]),
        )
        for identity, start, end in zip(identities.tolist(), starts, ends, strict=True)
    ]
    layer = {name: film.columns[name] for name in (*OF_TRACKS, *OF_OUTLINES)}
    layer |= {"count": counts.astype(np.int32), "polygons": film.counts["corners"].astype(np.int32)}
    plots = [Plot("tracks", "", counts), Plot("foreground", "%", 100 * film.columns["foreground"])]
    zones, events = (Zones(), ()) if happened is None else (happened.zones, happened.events)
    shown = [event for event in events if film.numbers[0] <= event.moment.frame <= film.numbers[-1]]
    shown.sort(key=lambda event: event.moment.time)  # a stay that ends is known late
    return View({"events": list(map(_plain, shown)), "zones": zones.plain(), "tracks": layer}, rows, plots)


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

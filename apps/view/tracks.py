"""The background application's part of `view.html`: tracked objects and outlines of the foreground."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..drawing.boxes import identity_colour
from ..io.mot import TrackedObject
from .film import Film, Row
from .page import SEEN, Plot, TimelineRow, View


def drawn_of(foreground: NDArray[np.uint8], tracks: Sequence[TrackedObject]) -> Row:
    """What is drawn on a frame: boxes with identities, and the foreground's outlines, in px of the source."""
    outlines = _outlines(foreground)
    return {
        "id": np.array([track.identity for track in tracks], np.int32),
        "box": np.array([track.box for track in tracks], np.float32).reshape(-1, 4),
        "outline": np.concatenate([np.zeros((0, 2), np.int16), *outlines]),
        "corners": np.array([len(outline) for outline in outlines], np.int32),
        "foreground": np.array([np.count_nonzero(foreground) / foreground.size], np.float32),
    }


def _outlines(foreground: NDArray[np.uint8]) -> list[NDArray[np.int16]]:
    """Polygons around the foreground, and around its holes."""
    near = max(foreground.shape) / 640  # px that nobody sees in the film
    found, _ = cv2.findContours(foreground, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    polygons = [cv2.approxPolyDP(contour, near, closed=True)[:, 0].astype(np.int16) for contour in found]
    return [polygon for polygon in polygons if len(polygon) > 2]


def tracks_view(film: Film) -> View:
    """The page of a film with what `drawn_of` gives."""
    ids, counts = film.columns["id"], film.counts["id"]
    frames = np.repeat(np.arange(len(counts)), counts)
    rows = []
    for identity in np.unique(ids).tolist():
        there = frames[ids == identity]
        rows.append(TimelineRow(identity, str(identity), _css(identity), _spans(there)))
    layer = {
        "ids": ids,
        "boxes": film.columns["box"],
        "counts": counts.astype(np.int32),
        "outline": film.columns["outline"],
        "corners": film.columns["corners"],
        "polygons": film.counts["corners"].astype(np.int32),
    }
    plots = [Plot("tracks", "", counts), Plot("foreground", "%", 100 * film.columns["foreground"])]
    return View({"tracks": layer}, rows, plots)


def _spans(frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """First, last and kind of runs of frames."""
    breaks = np.flatnonzero(np.diff(frames) > 1) + 1
    runs = np.split(frames, breaks)
    return np.array([(run[0], run[-1], SEEN) for run in runs])


def _css(identity: int) -> str:
    blue, green, red = identity_colour(identity)
    return f"#{red:02x}{green:02x}{blue:02x}"

"""`rsmcm structure --engine recursive-bp`: shape and camera frame by frame, also of live sources."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.points.point_tracker import PointTracker
from ...chains.reconstruction import Numbers, Reconstruction, recursive_reconstruction
from ...chains.structure.recursive_structure import RecursiveStructure, Structure
from ...inference import Belief, MultiChain
from ...models.core.frame import Frame
from ...models.core.identities import find
from ...models.points.point_tracks import NO_POINTS, PointTracks
from ..io.row_log import RowLog
from ..io.sources.open_source import Source
from ..runs.loop import Application, Columns, Engine, Start
from ..view.film import Film, Row
from ..view.overlay import Draw, PointsOverlay
from ..view.page import Page
from .diagnosis import no_shape
from .files import GREY, colours_at, write_cameras, write_ply, write_tracks
from .job import StructureJob
from .page import facts_of, in_words, nothing_page, structure_page

LOOKED_AT = 300
"""Last frames whose motion is told where there is no shape."""
PER_PIXEL, BESIDE = 60.0, 4e8
"""Bytes of working memory."""


class RecursiveRun(Application[StructureJob]):
    """Run of a point tracker and `RecursiveStructure`."""

    name = "structure"
    files = ("structure.ply", "cameras.json", "tracks.npz")
    blank_is_missing = False

    def bytes_needed(self, source: Source) -> tuple[float, float]:
        """Return bytes a pixel and bytes beside them."""
        return PER_PIXEL, BESIDE

    def build(self, start: Start) -> Engine:
        """Connect both chains at one feature node."""
        points = PointTracks()
        self._tracker, self._shape = PointTracker(), RecursiveStructure()
        model = MultiChain().connect(self._tracker, points).connect(self._shape, points)
        self._engine = start.filter(model)
        return self._engine

    def columns(self, belief: Belief) -> Columns:
        """Return the camera and the points seen in the frame; NaN while there is no shape."""
        frame, structure, seen = belief.frame, self._structure(belief.states), NO_POINTS
        if belief.states:
            view = belief[self._tracker].view
            if view is not None and view.time == frame.time:
                seen = view.points
        camera, covariance = np.full((2, 4), np.nan), np.full((4, 4), np.nan)
        if structure is not None:
            camera, covariance = structure.motion.camera, structure.motion.camera_covariance
        return Columns(
            {"camera": camera, "camera_covariance": covariance},
            {"id": seen.identities, "place": seen.positions, "colour": colours_at(frame, seen.positions)},
            view_row=partial(_view_row, structure, seen.identities, seen.positions),
            live={"points": len(seen.identities), "of the shape": 0 if structure is None else len(structure)},
        )

    def drawing(self) -> Draw:
        """Draw dots where points are seen, and rings where they are expected."""
        return lambda image, row, number, time, *, missing: PointsOverlay()(
            image, row, number, time, missing=missing
        )

    def finish(self, log: RowLog) -> dict[str, Any]:
        """Write shape, cameras and tracks of the points of the last shape."""
        structure, out = self._structure(self._engine.state.states), self.job.out
        self._frames = [
            Frame(None, time, number)
            for number, time in zip(log["number"].tolist(), log["time"].tolist(), strict=True)
        ]
        self._found: Reconstruction | None = None
        if structure is None:
            diagnosis = no_shape("the motion of points has not determined a shape", _last_tracks(log))
            return {**diagnosis.facts(), "notes": list(diagnosis.sentences)}
        tracks, colours = _of_identities(log, structure.identities)
        self._found = result = recursive_reconstruction(
            structure, log["camera"], log["camera_covariance"], tracks
        )
        self._colours = colours
        write_ply(out / "structure.ply", result, colours)
        write_cameras(out / "cameras.json", result, self._frames)
        write_tracks(out / "tracks.npz", result, self._frames)
        notes = [f"The shape is known up to an affine map only: {result.reason}."] if result.reason else []
        return {
            "tracks": len(np.unique(log.objects("id"))),
            **facts_of(result),
            "shape": result.geometry,
            "shape_reason": result.reason or None,
            "shape_since_frame": self._frames[int(np.flatnonzero(result.determined)[0])].number,
            "diagnosis": None,
            "notes": notes,
        }

    def page(self, log: RowLog, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Return the page: points over the film and in space."""
        title = f"{summary['source']}: structure from motion"
        if self._found is None or film is None:
            return nothing_page(title, self._frames, {}, summary, film)
        return structure_page(title, self._frames, self._found, self._colours, summary, film)

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """Describe the number of points and how well they fit."""
        return in_words(summary)

    def _structure(self, states: Mapping[str, Any]) -> Structure | None:
        return states[self._shape.name].structure if states else None


def _view_row(structure: Structure | None, identities: NDArray[np.int64], places: Numbers) -> Row:
    """What is seen, and the points of the shape that are not, where it expects them."""
    hidden, expected = np.zeros(0, np.int64), np.zeros((0, 2))
    if structure is not None:
        away = ~np.isin(structure.identities, identities)
        hidden = structure.identities[away]
        camera = structure.motion.camera
        expected = structure.shape[away] @ camera[:, :3].T + camera[:, 3]
    return {
        "id": np.concatenate([identities, hidden]).astype(np.int32),
        "points": np.concatenate([places, expected]).astype(np.float32),
        "seen": np.arange(len(identities) + len(hidden)) < len(identities),
    }


def _of_identities(log: RowLog, identities: NDArray[np.int64]) -> tuple[Numbers, NDArray[np.uint8]]:
    """Places `(n_frames, n, 2)` px of points, NaN where not seen, and their median colours `(n, 3)`."""
    frame = np.repeat(np.arange(len(log)), log["objects"])
    point, known = find(identities, log.objects("id"))
    point = point[known]
    tracks = np.full((len(log), len(identities), 2), np.nan)
    tracks[frame[known], point] = log.objects("place")[known]
    colours = np.full((len(identities), 3), GREY, np.uint8)
    of_seen = log.objects("colour")[known]
    for k in np.unique(point):
        colours[k] = np.rint(np.median(of_seen[point == k], axis=0))
    return tracks, colours


def _last_tracks(log: RowLog) -> Numbers:
    """Tracks `(n_frames, n_tracks, 2)` px of the last frames."""
    counts = log["objects"][-LOOKED_AT:]
    total = int(counts.sum())
    if not total:
        return np.full((len(counts), 1, 2), np.nan)
    identities, column = np.unique(log.objects("id")[-total:], return_inverse=True)
    tracks = np.full((len(counts), len(identities), 2), np.nan)
    tracks[np.repeat(np.arange(len(counts)), counts), column] = log.objects("place")[-total:]
    return tracks

"""What the report of a background run needs, gathered frame by frame."""

import base64
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..reports.evenly_spaced import EvenlySpaced
from ..reports.page import encoded
from ..reports.snapshots import MOST_SNAPSHOTS, small

Image = NDArray[np.uint8]

MOST_POINTS = 256  # of a track's path
SERIES = ("numbers", "times", "n_tracks", "foreground_share", "log_evidence", "seconds")  # per frame


class Located(Protocol):
    """Something with an identity and a box `(x, y, width, height)` px: a track, or the truth."""

    @property
    def identity(self) -> int:
        """Who it is."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Where it is: x, y of the top-left corner from 0, width, height, px."""


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
    path: EvenlySpaced[tuple[float, float]] = field(default_factory=lambda: EvenlySpaced(MOST_POINTS))

    def add(self, number: int, box: tuple[float, float, float, float]) -> None:
        """The track has `box` in frame `number`."""
        x, y, width, height = map(float, box)
        self.foot = (x + width / 2, y + height)
        self.path.add(lambda: self.foot)
        self.last = number
        self.n_frames += 1
        self.width += width
        self.height += height


@dataclass(eq=False)
class RunRecord:
    """What a report needs of a run, gathered frame by frame.

    Of a stream of any length it keeps at most eight evenly spaced snapshots, six numbers a frame, and per
    track a path of bounded length.
    """

    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    n_tracks: "array[float]" = field(default_factory=lambda: array("d"))
    foreground_share: "array[float]" = field(default_factory=lambda: array("d"))
    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    seconds: "array[float]" = field(default_factory=lambda: array("d"))
    tracks: dict[int, TrackHistory] = field(default_factory=dict)
    snapshots: EvenlySpaced[Snapshot] = field(default_factory=lambda: EvenlySpaced(MOST_SNAPSHOTS))
    missing: list[int] = field(default_factory=list)

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
        image = frame.image
        seen = image is not None
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
        if image is None:
            self.missing.append(frame.number)
            self.snapshots.add(None)
            return

        def snapshot() -> Snapshot:
            pictures = (image, background(), foreground, overlay())
            return Snapshot(frame.number, frame.time, *map(small, pictures))

        self.snapshots.add(snapshot)

    def expect(self, n_frames: int | None) -> None:
        """Say how many frames there will be: most pictures that are made are then kept."""
        self.snapshots.stride = max(1, (n_frames or 0) // (2 * MOST_SNAPSHOTS))

    def saved(self) -> dict[str, Any]:
        """Everything as plain JSON; the snapshots' pictures in base 64."""
        return {
            "series": {name: base64.b64encode(getattr(self, name).tobytes()).decode() for name in SERIES},
            "tracks": [[identity, asdict(history)] for identity, history in self.tracks.items()],
            "snapshots": {**vars(self.snapshots), "kept": [each.saved for each in self.snapshots.kept]},
            "missing": self.missing,
        }

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> "RunRecord":
        """The record of which `saved` was kept."""
        kept = [
            Snapshot(number, time, *map(_decoded, pictures))
            for number, time, *pictures in data["snapshots"]["kept"]
        ]
        record = cls(
            missing=list(data["missing"]), snapshots=EvenlySpaced(**{**data["snapshots"], "kept": kept})
        )
        for name in SERIES:
            getattr(record, name).frombytes(base64.b64decode(data["series"][name]))
        for identity, history in data["tracks"]:
            path = {**history["path"], "kept": [(x, y) for x, y in history["path"]["kept"]]}
            record.tracks[identity] = TrackHistory(**{**history, "path": EvenlySpaced(**path)})
        return record


def _encoded(image: Image) -> str:
    """A picture in base 64: masks as PNG, photographs as JPEG, as which the page holds them anyway."""
    return (
        encoded(image, ".png") if image.ndim == 2 else encoded(image, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, 95])
    )


def _decoded(text: str) -> Image:
    data = np.frombuffer(base64.b64decode(text), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)

"""What the page of a background run needs, gathered frame by frame."""

import base64
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.numerics.evenly_spaced import EvenlySpaced

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
    """What the page needs of a run, frame by frame: six numbers each, and a bounded path a track."""

    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    n_tracks: "array[float]" = field(default_factory=lambda: array("d"))
    foreground_share: "array[float]" = field(default_factory=lambda: array("d"))
    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    seconds: "array[float]" = field(default_factory=lambda: array("d"))
    tracks: dict[int, TrackHistory] = field(default_factory=dict)
    missing: list[int] = field(default_factory=list)

    def add(
        self,
        frame: Frame,
        tracks: Sequence[Located],
        foreground: Image,
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
        log_evidence
            of the whole frame, nats; NaN where it was not worked out.
        seconds
            that the frame's processing took.
        """
        seen = frame.image is not None
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
        if not seen:
            self.missing.append(frame.number)

    def saved(self) -> dict[str, Any]:
        """Everything as plain JSON."""
        return {
            "series": {name: base64.b64encode(getattr(self, name).tobytes()).decode() for name in SERIES},
            "tracks": [[identity, asdict(history)] for identity, history in self.tracks.items()],
            "missing": self.missing,
        }

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> "RunRecord":
        """The record of which `saved` was kept."""
        record = cls(missing=list(data["missing"]))
        for name in SERIES:
            getattr(record, name).frombytes(base64.b64decode(data["series"][name]))
        for identity, history in data["tracks"]:
            path = {**history["path"], "kept": [(x, y) for x, y in history["path"]["kept"]]}
            record.tracks[identity] = TrackHistory(**{**history, "path": EvenlySpaced(**path)})
        return record

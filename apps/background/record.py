"""What the page of a background run says of frames and tracks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.evenly_spaced import evenly_spread
from ..runs.row_log import RowLog

MOST_POINTS = 256
"""Of a track's path."""


@dataclass(frozen=True, eq=False)
class TrackHistory:
    """The life of a track.

    Parameters
    ----------
    first, last
        numbers of its first and last frame.
    n_frames
        in which it is reported.
    width, height
        of its box, means over these, px.
    path
        `(n, 2)` px: where its feet were in the first frame, in some between, and in the last one.
    """

    first: int
    last: int
    n_frames: int
    width: float
    height: float
    path: NDArray[np.float64]


class RunRecord:
    """Numbers of all frames `(n_frames,)`, and the tracks by identity.

    Parameters
    ----------
    log
        the rows of the run.
    """

    def __init__(self, log: RowLog) -> None:
        self.numbers: list[int] = log["number"].tolist()
        self.times: list[float] = log["time"].tolist()
        self.missing: list[int] = log["number"][log["missing"]].tolist()
        self.n_tracks, self.seconds = log["objects"], log["seconds"].tolist()
        self.foreground_share, self.log_evidence = log["foreground"], log["log_evidence"]
        ids, frames = log.objects("id"), np.repeat(log["number"], log["objects"])
        x, y, width, height = (log.objects(name) for name in ("x", "y", "width", "height"))
        feet = np.stack([x + width / 2, y + height], axis=1)
        order = np.argsort(ids, kind="stable")
        self.tracks: dict[int, TrackHistory] = {}
        for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(ids) else ():
            path = feet[rows[evenly_spread(len(rows), MOST_POINTS)]]
            self.tracks[int(ids[rows[0]])] = TrackHistory(
                int(frames[rows[0]]),
                int(frames[rows[-1]]),
                len(rows),
                float(width[rows].mean()),
                float(height[rows].mean()),
                path,
            )

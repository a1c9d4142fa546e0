"""A background run's record, as its page takes it."""

import numpy as np
from rsmcm.apps.background.record import RunRecord
from rsmcm.apps.scenes import TruthBox
from rsmcm.models.core.frame import Frame

PICTURE = np.arange(8 * 10 * 3, dtype=np.uint8).reshape(8, 10, 3)
MASK = np.where(np.arange(80).reshape(8, 10) < 20, 255, 0).astype(np.uint8)


SUMMARY = {
    "frames": 20,
    "first_frame": 1,
    "last_frame": 20,
    "missing_frames": 0,
    "size": [10, 8],
    "frames_per_second": 25.0,
    "tracks": 1,
    "metrics": None,
    "detections": None,
    "notes": [],
    "parameters": {"engine": "recursive-bp", "background": {"noise": 30.0}, "source": "<b>&.avi"},
}
"""What the page takes from `summary.json`."""


def recorded(n_frames: int, missing: frozenset[int] = frozenset()) -> RunRecord:
    """A run with one track; a quarter of the picture is foreground."""
    record = RunRecord()
    for number in range(1, n_frames + 1):
        frame = Frame(None if number in missing else PICTURE, number / 25, number)
        tracks = [TruthBox(3, "pedestrian", (number % 7, 1.0, 2.0, 4.0))]
        record.add(frame, tracks, MASK, -160.0, 0.01)
    return record

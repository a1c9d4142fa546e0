"""Rows of a run, and what the page of a background run takes of them."""

import tempfile
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path

import numpy as np
from rsmcm.apps.background.page import RunRecord
from rsmcm.apps.io.row_log import RowLog, Values
from rsmcm.apps.io.tracks import TrackedBox, columns_of

PICTURE = np.arange(8 * 10 * 3, dtype=np.uint8).reshape(8, 10, 3)


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


def log_of(rows: Iterable[Values], objects: Iterable[Values] = ()) -> RowLog:
    """A log of frames 1, 2, ... at 25 a second, each of which took 10 ms, with these columns beside."""
    log = RowLog(Path(tempfile.mkdtemp()) / "rows")
    for number, (row, of) in enumerate(zip_longest(rows, objects, fillvalue={}), start=1):
        usual = {"number": np.int64(number), "time": number / 25, "missing": np.bool_(False), "seconds": 0.01}
        log.append({**usual, **row}, of)
    return log


def recorded(n_frames: int, missing: frozenset[int] = frozenset()) -> RunRecord:
    """A run with one track; a quarter of the picture is foreground."""
    numbers = range(1, n_frames + 1)
    rows = [
        {
            "missing": np.bool_(number in missing),
            "foreground": np.nan if number in missing else 0.25,
            "log_evidence": np.nan if number in missing else -2.0,
        }
        for number in numbers
    ]
    tracks = [TrackedBox(3, (number % 7, 1.0, 2.0, 4.0)) for number in numbers]
    return RunRecord(log_of(rows, [columns_of([track]) for track in tracks]))

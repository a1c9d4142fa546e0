"""What the page of a background run takes from its rows: as much whatever the stream's length."""

import numpy as np
import pytest
from rsmcm.apps.background.page import MOST_POINTS, RunRecord
from rsmcm.apps.io.tracks import TrackedBox, columns_of

from ...support.records import log_of


@pytest.mark.parametrize("n_frames", [1, 2, 255, 256, 257, 700])
def test_path_of_a_track_is_bounded_and_ends_where_it_ended(n_frames: int) -> None:
    row = {"foreground": 0.0, "log_evidence": np.nan}
    boxes = [columns_of([TrackedBox(3, (float(k), 0.0, 2.0, 4.0))]) for k in range(1, n_frames + 1)]
    history = RunRecord(log_of([row] * n_frames, boxes)).tracks[3]
    assert len(history.path) == min(n_frames, MOST_POINTS)
    assert history.path[0].tolist() == [2.0, 4.0]
    assert history.path[-1].tolist() == [n_frames + 1.0, 4.0]
    assert (history.first, history.last, history.n_frames) == (1, n_frames, n_frames)
    assert (history.width, history.height) == (2, 4)


def test_tracks_that_come_and_go() -> None:
    row = {"foreground": 0.0, "log_evidence": np.nan}
    there = [[1], [1, 2], [], [2, 1], [2]]
    boxes = [columns_of([TrackedBox(k, (k, 0.0, k, 4.0)) for k in of]) for of in there]
    record = RunRecord(log_of([row] * 5, boxes))
    lives = {k: (track.first, track.last, track.n_frames, track.width) for k, track in record.tracks.items()}
    assert lives == {1: (1, 4, 3, 1), 2: (2, 5, 3, 2)}
    assert record.n_tracks.tolist() == [1, 2, 0, 2, 1]

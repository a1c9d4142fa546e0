"""Track files as frames."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.io.sources.open_source import Selection
from rsmcm.apps.io.track_files import frames_of_tracks, read_track_file

TRACKS = np.arange(60, dtype=np.float64).reshape(5, 6, 2)
TRACKS[1, 2] = TRACKS[:, 4] = np.nan


def saved(folder: Path, **arrays: Any) -> Path:
    path = folder / "tracks.npz"
    np.savez(path, **arrays)
    return path


def test_selected_frames_as_frames(tmp_path: Path) -> None:
    tracks, numbers = read_track_file(saved(tmp_path, tracks=TRACKS), Selection(2, 5, 3))
    np.testing.assert_array_equal(tracks, TRACKS[[1, 4]])
    first, last = frames_of_tracks(tracks, numbers)
    assert (first.number, last.number) == (2, 5)
    assert (first.time, last.time) == (1 / 25, 4 / 25)
    assert first.points is not None
    assert last.points is not None
    assert first.points.identities.tolist() == [0, 1, 3, 5]
    assert last.points.identities.tolist() == [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(first.points.positions, TRACKS[1, [0, 1, 3, 5]])


def test_a_frame_without_any_point_is_not_missing() -> None:
    (frame,) = frames_of_tracks(np.full((1, 3, 2), np.nan))
    assert not frame.missing


def test_a_selection_beyond_the_end(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"start: got 6, but .*tracks\.npz has only 5 frames"):
        read_track_file(saved(tmp_path, tracks=TRACKS), Selection(6))

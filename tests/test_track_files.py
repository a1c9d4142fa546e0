"""Track files: what is read, and what is refused in one line."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.sources import Selection
from rsmcm.apps.track_files import frames_of_tracks, read_track_file

TRACKS = np.arange(60, dtype=np.float64).reshape(5, 6, 2)
TRACKS[1, 2] = TRACKS[:, 4] = np.nan


def saved(folder: Path, **arrays: Any) -> Path:
    path = folder / "tracks.npz"
    np.savez(path, **arrays)
    return path


def changed(index: Any, value: float) -> np.ndarray[Any, Any]:
    tracks = TRACKS.copy()
    tracks[index] = value
    return tracks


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16, np.int32, np.uint8, ">f8"])
def test_any_real_type(kind: Any, tmp_path: Path) -> None:
    whole = np.nan_to_num(TRACKS).astype(kind)
    tracks, numbers = read_track_file(saved(tmp_path, tracks=whole, other=[1]), Selection())
    assert tracks.dtype == np.float64
    np.testing.assert_array_equal(tracks, whole)
    assert numbers == range(1, 6)


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


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({}, "got arrays none, expected 'tracks' (n_frames, n_points, 2) px"),
        ({"track": TRACKS, "x": [1]}, "got arrays 'track', 'x', expected 'tracks'"),
        ({"tracks": TRACKS[0]}, "got tracks (6, 2) float64, expected"),
        ({"tracks": np.zeros((5, 6, 3))}, "got tracks (5, 6, 3) float64"),
        ({"tracks": TRACKS.astype(complex)}, "got tracks (5, 6, 2) complex128"),
        ({"tracks": TRACKS.astype(str)}, "got tracks (5, 6, 2) <U"),
        ({"tracks": TRACKS > 3}, "got tracks (5, 6, 2) bool"),
        ({"tracks": np.array([None])}, "got an array of objects, expected"),
        ({"tracks": changed((3, 0, 1), np.inf)}, "got [36.0, inf] at frame 4, point 0, expected finite px"),
        ({"tracks": changed((3, 0), -np.inf)}, "got [-inf, -inf] at frame 4, point 0"),
        ({"tracks": changed((3, 0, 1), 1e300)}, "1e+300] at frame 4, point 0, expected finite px up to"),
        ({"tracks": changed((0, 5, 0), np.nan)}, "got [nan, 11.0] at frame 1, point 5, expected both"),
    ],
)
def test_what_is_refused(arrays: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = saved(tmp_path, **arrays)
    with pytest.raises(ValueError, match=r"^[^\n]*tracks\.npz: [^\n]*$") as raised:
        read_track_file(path, Selection())
    assert words in str(raised.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = saved(tmp_path, tracks=TRACKS)
    whole = path.read_bytes()
    single = io.BytesIO()
    np.save(single, TRACKS)
    for content, words in (
        (b"", "no readable .npz"),
        (b"nonsense", "no readable .npz"),
        (whole[: len(whole) // 2], "no readable .npz"),
        (whole[:100] + bytes(200) + whole[300:], "no readable .npz"),
        (single.getvalue(), "got a single array"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"tracks\.npz") as raised:
            read_track_file(path, Selection())
        assert words in str(raised.value), content[:20]
        assert "\n" not in str(raised.value)
    with pytest.raises(FileNotFoundError):
        read_track_file(tmp_path / "nowhere.npz", Selection())
    with pytest.raises(IsADirectoryError):
        read_track_file(tmp_path, Selection())


def test_a_selection_beyond_the_end(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"start: got 6, but .*tracks\.npz has only 5 frames"):
        read_track_file(saved(tmp_path, tracks=TRACKS), Selection(6))

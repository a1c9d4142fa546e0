"""Landmark files as people give them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.face_files import GivenLandmarks, read_landmarks


def saved(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int16])
@pytest.mark.parametrize("shape", [(5, 2), (1, 5, 2), (3, 5, 2)])
def test_landmarks_of_one_frame_or_more(tmp_path: Path, kind: type, shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape)).reshape(shape).astype(kind)
    landmarks = read_landmarks(saved(tmp_path / "l.npy", array))
    assert landmarks.dtype == np.float64
    np.testing.assert_array_equal(landmarks, array.reshape(-1, 5, 2))


def test_missing_landmarks_stay_missing(tmp_path: Path) -> None:
    array = np.ones((2, 4, 2))
    array[0, 1] = np.nan
    np.testing.assert_array_equal(read_landmarks(saved(tmp_path / "l.npy", array)), array)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.zeros((2, 5, 3)), "got (2, 5, 3) float64, expected (n_frames, n_landmarks, 2) px"),
        (np.zeros(6), "got (6,) float64"),
        (np.zeros((1, 0, 2)), "got (1, 0, 2)"),
        (np.zeros((4, 2)).astype(str), "expected (n_frames, n_landmarks, 2) px"),
        (np.zeros((4, 2), complex), "complex128"),
        (np.full((4, 2), None), "an array of objects"),
        (np.where(np.arange(8).reshape(4, 2) == 5, np.nan, 1.0), "[1.0, nan] at landmark 2 of frame 0"),
        (np.where(np.arange(8).reshape(1, 4, 2) > 5, np.inf, 1.0), "[inf, inf] at landmark 3 of frame 0"),
        (np.full((4, 2), 1e9), "expected finite px up to 1e+07"),
    ],
)
def test_wrong_landmarks(tmp_path: Path, wrong: Any, words: str) -> None:
    path = saved(tmp_path / "l.npy", wrong)
    with pytest.raises(ValueError, match=r"l\.npy: got") as raised:
        read_landmarks(path)
    assert words in str(raised.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    text, archive = tmp_path / "text.npy", tmp_path / "archive.npy"
    text.write_text("1 2\n3 4\n")
    with archive.open("wb") as file:
        np.savez(file, landmarks=np.zeros((1, 4, 2)))
    empty = tmp_path / "empty.npy"
    empty.touch()
    cut = saved(tmp_path / "cut.npy", np.zeros((4, 2)))
    cut.write_bytes(cut.read_bytes()[:-9])
    for path, words in (
        (text, "no readable .npy"),
        (archive, "got an .npz"),
        (empty, "no readable"),
        (cut, "no"),
    ):
        with pytest.raises(ValueError, match=words):
            read_landmarks(path)
    with pytest.raises(FileNotFoundError):
        read_landmarks(tmp_path / "nowhere.npy")


def test_which_row_belongs_to_which_frame() -> None:
    rows = np.arange(3 * 4 * 2).reshape(3, 4, 2).astype(float)
    landmarks = GivenLandmarks(rows, start=11, step=5)
    found = [landmarks.of_frame(number) for number in (11, 16, 21, 26)]
    for row, of_frame in zip(rows, found, strict=False):
        np.testing.assert_array_equal(of_frame, row)
    assert found[3] is None
    assert landmarks.of_frame(6) is None


def test_error_is_the_mean_over_what_is_there() -> None:
    rows = np.zeros((2, 3, 2))
    rows[1, 2] = np.nan
    landmarks = GivenLandmarks(rows)
    assert landmarks.error(2, np.array([[3.0, 4.0], [np.nan, np.nan], [9.0, 9.0]])) == 5
    assert np.isnan(landmarks.error(2, np.full((3, 2), np.nan)))
    assert np.isnan(landmarks.error(3, np.zeros((3, 2)))), "no row"
    assert np.isnan(GivenLandmarks(rows[:1]).error(1, np.ones((3, 2)))), "a start is no truth"


def test_size_is_that_of_the_box() -> None:
    assert GivenLandmarks(np.array([[[0, 0], [8, 1], [4, 2], [np.nan, np.nan]]])).size == 4

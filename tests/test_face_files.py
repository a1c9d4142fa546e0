"""Landmark files as people give them, and arrays that grow on disk."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.face_files import GivenLandmarks, RowWriter, read_landmarks


def saved(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


# --- landmarks ----------------------------------------------------------------------------------------------


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


# --- arrays that grow ---------------------------------------------------------------------------------------


@given(
    shapes=st.lists(st.lists(st.integers(0, 3), max_size=3).map(tuple), min_size=1, max_size=3),
    n_rows=st.integers(1, 5),
)
def test_what_is_written_is_read(tmp_path_factory: Any, shapes: list[tuple[int, ...]], n_rows: int) -> None:
    path = tmp_path_factory.mktemp("rows") / "rows.npz"
    random = np.random.default_rng(0)
    kinds = (np.float64, np.float32, np.int64, np.bool_)
    arrays = {
        f"array{k}": (9 * random.random((n_rows, *shape))).astype(kinds[k % 4])
        for k, shape in enumerate(shapes)
    }
    with RowWriter(path) as writer:
        for row in range(n_rows):
            writer.append({name: array[row] for name, array in arrays.items()})
        writer.finish({"whole": np.arange(4)})
    assert [each.name for each in path.parent.iterdir()] == ["rows.npz"]
    with np.load(path, allow_pickle=False) as content:
        assert set(content.files) == {*arrays, "whole"}
        np.testing.assert_array_equal(content["whole"], np.arange(4))
        for name, array in arrays.items():
            assert content[name].dtype == array.dtype
            np.testing.assert_array_equal(content[name], array)


def test_views_are_written_as_they_are_seen(tmp_path: Path) -> None:
    """Slices and transposes lie otherwise in memory."""
    array = np.arange(24.0).reshape(4, 6)
    with RowWriter(tmp_path / "rows.npz") as writer:
        writer.append({"slice": array[:, 1:3], "turned": array.T})
        writer.finish({})
    with np.load(tmp_path / "rows.npz") as content:
        np.testing.assert_array_equal(content["slice"][0], array[:, 1:3])
        np.testing.assert_array_equal(content["turned"][0], array.T)


def test_a_row_of_another_form(tmp_path: Path) -> None:
    with RowWriter(tmp_path / "rows.npz") as writer:
        writer.append({"a": np.zeros(3), "b": 1})
        with pytest.raises(ValueError, match=r"a: got \(2,\) float64, expected \(3,\) float64"):
            writer.append({"a": np.zeros(2), "b": 1})
        with pytest.raises(ValueError, match="float32"):
            writer.append({"a": np.zeros(3, np.float32), "b": 1})
        with pytest.raises(ValueError, match="row: got a, expected a, b"):
            writer.append({"a": np.zeros(3)})
    assert list(tmp_path.iterdir()) == []


def test_nothing_appears_without_an_end(tmp_path: Path) -> None:
    with RowWriter(tmp_path / "rows.npz") as writer:
        writer.append({"a": 1.0})
    assert list(tmp_path.iterdir()) == []


def test_memory_does_not_grow(tmp_path: Path) -> None:
    """200 rows of 0.8 MB; copying takes 16 MB at a time."""
    with RowWriter(tmp_path / "rows.npz") as writer:
        row = np.zeros((100_000,))
        tracemalloc.start()
        for _ in range(200):
            writer.append({"a": row})
        writer.finish({})
        highest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert highest < 50e6
    assert (tmp_path / "rows.npz").stat().st_size > 160e6

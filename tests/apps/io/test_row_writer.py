"""Arrays that grow on disk."""

import errno
import itertools
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.io.row_writer import RowWriter


@given(
    shapes=st.lists(st.lists(st.integers(0, 3), max_size=3).map(tuple), min_size=1, max_size=3),
    n_rows=st.integers(1, 5),
    every=st.integers(1, 6),
)
def test_what_is_written_is_read(
    tmp_path_factory: Any, shapes: list[tuple[int, ...]], n_rows: int, every: int
) -> None:
    path = tmp_path_factory.mktemp("rows") / "rows.npz"
    random = np.random.default_rng(0)
    kinds = (np.float64, np.float32, np.int64, np.bool_)
    arrays = {
        f"array{k}": (9 * random.random((n_rows, *shape))).astype(kinds[k % 4])
        for k, shape in enumerate(shapes)
    }
    with RowWriter(path, {"whole": np.arange(4)}) as writer:
        for row in range(n_rows):
            writer.append(row + 1, {name: array[row] for name, array in arrays.items()})
            if row % every == 0:
                writer.checkpoint()
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
    with RowWriter(tmp_path / "rows.npz", {}) as writer:
        writer.append(1, {"slice": array[:, 1:3], "turned": array.T})
    with np.load(tmp_path / "rows.npz") as content:
        np.testing.assert_array_equal(content["slice"][0], array[:, 1:3])
        np.testing.assert_array_equal(content["turned"][0], array.T)


def test_a_row_of_another_form(tmp_path: Path) -> None:
    with RowWriter(tmp_path / "rows.npz", {}) as writer:
        writer.append(1, {"a": np.zeros(3), "b": 1})
        with pytest.raises(ValueError, match=r"a: got \(2,\) float64, expected \(3,\) float64"):
            writer.append(1, {"a": np.zeros(2), "b": 1})
        with pytest.raises(ValueError, match="float32"):
            writer.append(1, {"a": np.zeros(3, np.float32), "b": 1})
        with pytest.raises(ValueError, match="row: got a, expected a, b"):
            writer.append(1, {"a": np.zeros(3)})
    with np.load(tmp_path / "rows.npz") as content:
        assert content["a"].shape == (1, 3), "what was whole"


def interrupted(path: Path, at: int) -> None:
    with RowWriter(path, {"k": 1}) as writer:
        for number in range(1, 10):
            writer.append(number, {"a": float(number)})
            if number % 3 == 0:
                writer.checkpoint()
            if number == at:
                raise KeyboardInterrupt


@pytest.mark.parametrize("at", [3, 5, 6])
def test_interrupted_and_gone_on_with(tmp_path: Path, at: int) -> None:
    """The same bytes as in one go; after the interruption, what was done is readable."""
    path, whole = tmp_path / "rows.npz", tmp_path / "whole.npz"
    with pytest.raises(KeyboardInterrupt):
        interrupted(path, at)
    with np.load(path) as content:
        np.testing.assert_array_equal(content["a"], np.arange(1.0, at + 1))
    with RowWriter(path, {"k": 1}, resume_after=3) as writer:
        for number in range(4, 10):
            writer.append(number, {"a": float(number)})
    with RowWriter(whole, {"k": 1}) as writer:
        for number in range(1, 10):
            writer.append(number, {"a": float(number)})
    assert path.read_bytes() == whole.read_bytes()
    assert {each.name for each in tmp_path.iterdir()} == {"rows.npz", "whole.npz"}


def test_memory_does_not_grow(tmp_path: Path) -> None:
    """200 rows of 0.8 MB; copying takes 16 MB at a time."""
    with RowWriter(tmp_path / "rows.npz", {}) as writer:
        row = np.zeros((100_000,))
        tracemalloc.start()
        for number in range(200):
            writer.append(number + 1, {"a": row})
        writer.close(finished=True)
        highest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert highest < 50e6
    assert (tmp_path / "rows.npz").stat().st_size > 160e6


def test_a_checkpoint_that_fails_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk at the second array; when there is room again, everything is written."""
    copy, calls = shutil.copyfileobj, itertools.count(1)

    def failing(*arguments: Any) -> None:
        if next(calls) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        copy(*arguments)

    with RowWriter(tmp_path / "rows.npz", {}) as writer:
        for number in (1, 2):
            writer.append(number, {"a": float(number), "b": -float(number)})
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "copyfileobj", failing)
            with pytest.raises(OSError, match="No space left"):
                writer.checkpoint()
    with np.load(tmp_path / "rows.npz") as content:
        np.testing.assert_array_equal(content["a"], [1, 2])
        np.testing.assert_array_equal(content["b"], [-1, -2])

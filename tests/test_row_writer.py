"""Arrays that grow on disk."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.row_writer import RowWriter


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

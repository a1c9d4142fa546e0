"""The log of rows: what was appended is there, and a run that goes on cuts it at its saved state."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.io.row_log import remove_rows
from rsmcm.apps.runs import RowLog


def row(number: int) -> dict[str, Any]:
    return {"number": np.int64(number), "time": number / 25, "pose": np.full((2, 3), number, np.float32)}


def objects(number: int) -> dict[str, NDArray[Any]]:
    count = (number * 7) % 4
    return {"id": np.arange(count), "box": np.full((count, 4), float(number))}


def written(folder: Path, first: int, last: int, state: int | None = None) -> None:
    """Frames first to last; the state is saved after frame `state`, and then the process dies."""
    log = RowLog(folder, first - 1)
    for number in range(first, last + 1):
        log.append(row(number), objects(number))
        if number == state:
            log.checkpoint()
    if state is None:
        log.checkpoint()
        log.__exit__()


def assert_whole(folder: Path, last: int) -> None:
    with RowLog(folder, last) as log:
        assert len(log) == last
        for number, (found, there) in enumerate(log.frames(), start=1):
            for name, value in row(number).items():
                np.testing.assert_array_equal(found[name], value)
            for name, values in objects(number).items():
                np.testing.assert_array_equal(there[name] if len(values) else values, values)
        assert log["pose"].shape == (last, 2, 3)
        assert log["pose"].dtype == np.float32
        assert log["objects"].tolist() == [len(objects(number)["id"]) for number in range(1, last + 1)]


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_a_log_that_is_cut_and_goes_on_is_as_in_one_go(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("log") / "rows"
    first = 1
    for _ in range(data.draw(st.integers(0, 3))):
        state = data.draw(st.integers(first, first + 6))
        written(folder, first, state + data.draw(st.integers(0, 5)), state)
        first = state + 1
    written(folder, first, first + 4)
    assert_whole(folder, first + 4)


def test_a_run_that_is_killed_as_soon_as_it_is_resumed_loses_nothing(tmp_path: Path) -> None:
    written(tmp_path / "rows", 1, 9, state=9)
    for _ in range(2):
        RowLog(tmp_path / "rows", 5).__exit__()  # cut, and no row was appended
    written(tmp_path / "rows", 6, 9)
    assert_whole(tmp_path / "rows", 9)


def test_columns_can_be_looked_at_while_the_run_goes_on(tmp_path: Path) -> None:
    with RowLog(tmp_path / "rows") as log:
        for number in range(1, 4):
            log.append(row(number), objects(number))
        log.checkpoint()
        log.append(row(4), objects(4))
        assert np.load(tmp_path / "rows" / "frame.time.npy").tolist() == [1 / 25, 2 / 25, 3 / 25]
        assert log["time"].tolist() == [1 / 25, 2 / 25, 3 / 25, 4 / 25]
    remove_rows(tmp_path / "rows")
    assert not (tmp_path / "rows").exists()


def test_another_row_is_refused(tmp_path: Path) -> None:
    with RowLog(tmp_path / "rows") as log:
        log.append(row(1), {})
        with pytest.raises(ValueError, match=r"frame\.pose\.npy: got \(3, 3\) float32, expected \(2, 3\)"):
            log.append({**row(2), "pose": np.zeros((3, 3), np.float32)}, {})


def test_tables_and_arrays(tmp_path: Path) -> None:
    with RowLog(tmp_path / "rows") as log:
        for number in (1, 2):
            log.append({**row(number), "missing": np.bool_(False), "level": 0.5 * number}, objects(number))
        log.write_table(tmp_path / "level.csv")
        log.write_arrays(
            tmp_path / "poses.npz", {"names": np.array(["a"])}, {"poses": "pose", "two": np.ones(2)}
        )
    assert (tmp_path / "level.csv").read_text() == "number,time,level\n1,0.04,0.5\n2,0.08,1.0\n"
    with np.load(tmp_path / "poses.npz") as arrays:
        assert {name: arrays[name].shape for name in arrays} == {
            "names": (1,),
            "poses": (2, 2, 3),
            "two": (2,),
        }


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("number", lambda column: column[::-1].copy(), "got numbers that do not ascend"),
        ("number", lambda column: column.astype(float), r"got \(5,\) float64"),
        ("objects", lambda column: column - 3, "got counts beyond 0"),
        ("pose", lambda column: column[:2], r"got \(2, 2, 3\) float32, expected 4 rows"),
        ("time", lambda column: np.array("x"), r"got \(\) <U1, expected 4 rows"),
        ("time", lambda column: np.array([None]), "got other content"),
    ],
)
def test_forged_columns_are_refused_by_name(name: str, change: Any, message: str, tmp_path: Path) -> None:
    written(tmp_path / "rows", 1, 5)
    path = tmp_path / "rows" / f"frame.{name}.npy"
    np.save(path, change(np.load(path)), allow_pickle=True)
    with pytest.raises(ValueError, match=rf"frame\.{name}\.npy: {message}"):
        RowLog(tmp_path / "rows", 4)

"""The rows of a run: a value a column of every frame, and of every object in it, in a file a column.

A run that goes on cuts the log at its saved state; what a run says of all frames is read from its columns.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from ...models.files import LAST_FRAME, fitting, naming, write_atomically, write_text

Values = Mapping[str, Any]
"""By the names of columns, what a frame or its objects have there."""

COLUMNS = "rows"
"""Folder of the columns, as long as a run is not finished."""

HEADER = 256
"""Bytes of a file before its numbers: as many whatever the number of rows, which is not known beforehand."""

EXPECTED = "expected rows of a run"

_FRAME, _OBJECT = "frame", "object"
_TYPES = {"number": np.int64, "objects": np.int64, "missing": np.bool_}


class _Column:
    """An `.npy` file that grows along its first axis; `np.load` takes it after every `complete`."""

    def __init__(self, path: Path, dtype: np.dtype[Any], shape: tuple[int, ...], count: int = 0) -> None:
        self.path, self.dtype, self.shape, self.count = path, dtype, shape, count
        self._file: BinaryIO = path.open("r+b" if count else "w+b")
        # the header first: a file longer than it says can be read, a shorter one cannot
        self._file.write(self._header())
        self._file.flush()
        self._file.truncate(HEADER + count * self.width)
        self._file.seek(0, os.SEEK_END)

    @classmethod
    def like(cls, path: Path, values: NDArray[Any]) -> Self:
        """An empty column for rows such as these."""
        return cls(path, values.dtype, values.shape[1:])

    @property
    def width(self) -> int:
        """Bytes of a row."""
        return self.dtype.itemsize * int(np.prod(self.shape))

    def append(self, values: NDArray[Any]) -> None:
        """Append rows; ValueError if they have another shape or type than those before."""
        if values.shape[1:] != self.shape or values.dtype != self.dtype:
            raise ValueError(
                f"{self.path}: got {values.shape[1:]} {values.dtype}, expected {self.shape} "
                f"{self.dtype} like the rows before"
            )
        self._file.write(values.tobytes())
        self.count += len(values)

    def complete(self) -> None:
        """Have all rows on the disk, and their number in the header."""
        self._file.flush()
        self._file.seek(0)
        self._file.write(self._header())
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.seek(0, os.SEEK_END)

    def values(self) -> NDArray[Any]:
        """All rows, on the disk as long as nobody looks at them."""
        self._file.flush()
        if not self.count * self.width:
            return np.zeros((self.count, *self.shape), self.dtype)
        whole = np.memmap(self.path, self.dtype, "r", HEADER, (self.count, *self.shape))
        return whole.view(np.ndarray)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def _header(self) -> bytes:
        """What `np.lib.format` has before the numbers, padded to `HEADER` bytes."""
        descr, shape = np.lib.format.dtype_to_descr(self.dtype), (self.count, *self.shape)
        text = repr({"descr": descr, "fortran_order": False, "shape": shape})
        room = HEADER - np.lib.format.MAGIC_LEN - 2
        padded = text.ljust(room - 1) + "\n"
        return np.lib.format.magic(1, 0) + room.to_bytes(2, "little") + padded.encode("latin1")


class RowLog:
    """All rows of a run. `log["time"]` is a column of all frames, `log.objects("id")` one of all objects.

    Columns are on disk and read on access, so that a run may have any length. Columns and their types are
    those of the first row, or of the first object. Rows after frame `resume_after`, where a resumed run
    continues, are removed.
    """

    def __init__(self, folder: Path, resume_after: int = 0) -> None:
        self._folder = folder
        self._frames: dict[str, _Column] = {}
        self._objects: dict[str, _Column] = {}
        folder.mkdir(exist_ok=True)
        paths = sorted(folder.glob("*.npy"))
        if resume_after and paths:
            rows = self._rows(resume_after)
            forms = {path: _form_of(path, rows.get(path.stem.partition(".")[0], 0)) for path in paths}
            for path, form in forms.items():
                kind, _, name = path.stem.partition(".")
                if rows.get(kind):
                    columns = self._frames if kind == _FRAME else self._objects
                    columns[name] = _Column(path, *form, rows[kind])
                else:
                    path.unlink()
        else:
            for path in paths:
                path.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with ExitStack() as stack:
            for column in (*self._frames.values(), *self._objects.values()):
                stack.callback(column.close)

    def __len__(self) -> int:
        return self._frames["number"].count if self._frames else 0

    def __contains__(self, name: str) -> bool:
        return name in self._frames

    def __getitem__(self, name: str) -> NDArray[Any]:
        if not self._frames:
            return np.zeros(0, _TYPES.get(name, np.float64))
        return self._frames[name].values()

    @property
    def numbers(self) -> list[str]:
        """Names of the application's own columns with one number per frame."""
        usual = {"number", "time", "missing", "seconds", "objects"}
        return [name for name, column in self._frames.items() if not column.shape and name not in usual]

    def write_table(self, path: Path) -> None:
        """Write number, time and the application's own columns of all frames as CSV."""
        names = ["number", "time", *self.numbers]
        rows = zip(*(self[name].tolist() for name in names), strict=True)
        write_text(path, "".join(f"{','.join(map(str, row))}\n" for row in [names, *rows]))

    def objects(self, name: str) -> NDArray[Any]:
        """Return a column of all objects; empty if there was none."""
        return self._objects[name].values() if name in self._objects else np.zeros(0)

    def append(self, row: Values, objects: Values) -> None:
        """Append a frame, whose `row` has its `number`, with its objects: arrays of equal length.

        It is a ValueError if it has other columns, shapes or types than those before.
        """
        count = len(next(iter(objects.values()))) if objects else 0
        with naming(self._folder):
            rows = {name: np.asarray(value)[None] for name, value in {**row, "objects": count}.items()}
            if not self._frames:
                self._frames = {name: _Column.like(self._path(_FRAME, name), rows[name]) for name in rows}
            if count and not self._objects:
                things = {name: np.asarray(values) for name, values in objects.items()}
                self._objects = {
                    name: _Column.like(self._path(_OBJECT, name), things[name]) for name in things
                }
            if rows.keys() != self._frames.keys():
                raise ValueError(f"row: got {', '.join(rows)}, expected {', '.join(self._frames)}")
            for name, column in self._frames.items():
                column.append(rows[name])
            for name, column in self._objects.items() if count else ():
                column.append(np.asarray(objects[name]))

    def frames(self) -> Iterator[tuple[dict[str, Any], dict[str, NDArray[Any]]]]:
        """Yield rows with their objects, as they were appended."""
        columns = {name: column.values() for name, column in self._frames.items()}
        things = {name: column.values() for name, column in self._objects.items()}
        stop = 0
        for index, count in enumerate(columns["objects"].tolist() if columns else ()):
            start, stop = stop, stop + count
            row = {name: values[index] for name, values in columns.items()}
            yield row, {name: values[start:stop] for name, values in things.items()}

    def checkpoint(self) -> None:
        """Return when everything is on disk."""
        with naming(self._folder):
            for column in (*self._frames.values(), *self._objects.values()):
                column.complete()

    def write_arrays(
        self, path: Path, constants: Mapping[str, NDArray[Any]], columns: Mapping[str, str | NDArray[Any]]
    ) -> None:
        """Write an `.npz` of constant arrays, and arrays with one entry per frame.

        `columns`: by the name of the array, the name of a column of the log, or the values themselves.
        """
        of_frames = {name: self[of] if isinstance(of, str) else of for name, of in columns.items()}
        with write_atomically(path) as unfinished:
            np.savez(unfinished, allow_pickle=False, **constants, **of_frames)

    def _rows(self, last: int) -> dict[str, int]:
        """How many rows of each kind there are up to a frame; a `ValueError` names a file without them."""
        paths = [self._path(_FRAME, name) for name in ("number", "objects")]
        numbers, counts = (_mapped(path) for path in paths)
        for path, column in zip(paths, (numbers, counts), strict=True):
            if column.ndim != 1 or column.dtype != np.int64:
                raise ValueError(f"{path}: got {column.shape} {column.dtype}, {EXPECTED}")
        kept = int(np.count_nonzero(numbers <= last))
        if (np.diff(numbers) <= 0).any():
            raise ValueError(f"{paths[0]}: got numbers that do not ascend, {EXPECTED}")
        if not ((counts[:kept] >= 0) & (counts[:kept] <= LAST_FRAME)).all():
            raise ValueError(f"{paths[1]}: got counts beyond 0 to {LAST_FRAME}, {EXPECTED}")
        return {_FRAME: kept, _OBJECT: int(counts[:kept].sum())}

    def _path(self, kind: str, name: str) -> Path:
        return self._folder / f"{kind}.{name}.npy"


def _mapped(path: Path) -> NDArray[Any]:
    """The rows of a file, on the disk; a `ValueError` names it if it is damaged."""
    with fitting(path, EXPECTED):
        array: NDArray[Any] = np.lib.format.open_memmap(path, "r")
    return array


def _form_of(path: Path, count: int) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of the rows of a file that has so many; a `ValueError` names one that has less."""
    rows = _mapped(path)
    if not rows.ndim or len(rows) < count:
        raise ValueError(f"{path}: got {rows.shape} {rows.dtype}, expected {count} rows of a run")
    return rows.dtype, rows.shape[1:]


def remove_rows(folder: Path) -> None:
    """Remove the folder of a finished run's columns, if it is there."""
    if folder.exists():
        for path in folder.glob("*.npy"):
            path.unlink()
        folder.rmdir()

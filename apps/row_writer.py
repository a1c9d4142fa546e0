"""Arrays that grow by a row a frame, in an `.npz` file."""

import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from .results import naming, write_atomically

CHUNK = 1 << 24
"""Bytes that are copied at a time."""


class RowWriter:
    """An `.npz` file whose arrays grow by a row a frame, of which one row at a time is in memory.

    Rows are collected in nameless files beside it, which vanish with the process. Nothing is compressed:
    numbers of a tracker hardly shrink.

    Parameters
    ----------
    path
        of the file, which appears when `finish` is called.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._columns: dict[str, tuple[IO[bytes], NDArray[Any]]] = {}
        self._n_rows = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file, _first in self._columns.values():
            file.close()

    def append(self, row: Mapping[str, Any]) -> None:
        """Append an entry to every array.

        Raises
        ------
        ValueError
            if it has other names, shapes or types than the first row.
        OSError
            if it cannot be written.
        """
        entries = {name: np.asarray(value) for name, value in row.items()}
        with naming(self._path):
            if not self._columns:
                for name, entry in entries.items():
                    self._columns[name] = (tempfile.TemporaryFile(dir=self._path.parent), entry)  # noqa: SIM115
            if entries.keys() != self._columns.keys():
                raise ValueError(f"row: got {', '.join(entries)}, expected {', '.join(self._columns)}")
            for name, entry in entries.items():
                file, first = self._columns[name]
                if (entry.shape, entry.dtype) != (first.shape, first.dtype):
                    raise ValueError(
                        f"{name}: got {entry.shape} {entry.dtype}, expected {first.shape} {first.dtype} "
                        "like the rows before"
                    )
                file.write(entry.tobytes())
        self._n_rows += 1

    def finish(self, constants: Mapping[str, Any]) -> None:
        """Write the file, whole or not at all: the arrays that grew, and others that did not.

        Raises
        ------
        OSError
            if it cannot be written.
        """
        with (
            write_atomically(self._path) as unfinished,
            zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as archive,
        ):
            for name, value in constants.items():
                with archive.open(f"{name}.npy", "w") as entry:
                    np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)
            for name, (file, first) in self._columns.items():
                header = {
                    "descr": np.lib.format.dtype_to_descr(first.dtype),
                    "fortran_order": False,
                    "shape": (self._n_rows, *first.shape),
                }
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array_header_1_0(entry, header)
                    file.seek(0)
                    shutil.copyfileobj(file, entry, CHUNK)
                file.close()  # gives its space back at once

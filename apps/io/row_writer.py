"""Arrays that grow by a row a frame, in an `.npz` file."""

import shutil
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from ...models.files import naming, sync, write_atomically
from .segments import drop_segments, join_segments, segment_name

CHUNK = 1 << 24
"""Bytes that are copied at a time."""


class RowWriter:
    """An `.npz` file whose arrays grow by a row a frame, and that survives the end of its process.

    Like those of `SegmentedVideo`, rows go to segments, `name.partNNNNNNNNN.npz`, that are complete at each
    checkpoint; closing joins them. One row at a time is in memory: until a checkpoint, rows are in nameless
    files beside the segments. Nothing is compressed: numbers of a tracker hardly shrink. The same rows make
    the same bytes.

    Parameters
    ----------
    path
        of the file, which appears at the end.
    constants
        other arrays that the file holds.
    resume_after
        number of the frame after which this run goes on; 0 for a new one.
    """

    def __init__(self, path: Path, constants: Mapping[str, Any], resume_after: int = 0) -> None:
        self._path = path
        self._constants = constants
        self._columns: dict[str, tuple[IO[bytes], NDArray[Any]]] = {}
        self._n_rows = 0  # since the last checkpoint
        self._last = 0  # number of the last frame
        drop_segments(path, behind=resume_after)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(finished=kind is None)

    def append(self, number: int, row: Mapping[str, Any]) -> None:
        """Append an entry of the frame with this number to every array.

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
        self._last = number

    def checkpoint(self) -> None:
        """Complete what was written so far.

        Raises
        ------
        OSError
            if it cannot be written.
        """
        if not self._n_rows:
            return
        segment = segment_name(self._path, self._last)
        with write_atomically(segment) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
            for name, (file, first) in self._columns.items():
                with _entry(archive, name) as entry:
                    _write_header(entry, (self._n_rows, *first.shape), first.dtype)
                    file.seek(0)
                    shutil.copyfileobj(file, entry, CHUNK)
        for file, _first in self._columns.values():  # only now: if the segment failed, it is tried again
            file.seek(0)
            file.truncate()
        sync(segment)
        self._n_rows = 0

    def close(self, *, finished: bool) -> None:
        """Write the file, whole or not at all; when the run is finished, remove the segments.

        Raises
        ------
        OSError
            if it cannot be written.
        """
        try:
            self.checkpoint()
        finally:
            for file, _first in self._columns.values():
                file.close()
        join_segments(self._path, self._join, finished=finished)

    def _join(self, segments: Sequence[Path], path: Path) -> None:
        """Write constants, and all rows of each array, one segment after the other."""
        with ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(path, "w"))
            for name, value in self._constants.items():
                with _entry(archive, name) as entry:
                    np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)
            parts = [stack.enter_context(zipfile.ZipFile(segment)) for segment in segments]
            for member in parts[0].namelist():
                headers = []
                for part in parts:
                    with part.open(member) as file:
                        headers.append(_read_header(file))
                (_, *form), dtype = headers[0]
                rows = sum(shape[0] for shape, _ in headers)
                with _entry(archive, member.removesuffix(".npy")) as entry:
                    _write_header(entry, (rows, *form), dtype)
                    for part in parts:
                        with part.open(member) as file:
                            _read_header(file)
                            shutil.copyfileobj(file, entry, CHUNK)


def _entry(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    """A member to write to; it bears no date, so that equal arrays make equal files."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True)


def _write_header(entry: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(entry, header)


def _read_header(entry: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a member, which is read up to its numbers."""
    np.lib.format.read_magic(entry)
    shape, _, dtype = np.lib.format.read_array_header_1_0(entry)
    return shape, dtype

"""Files that are written whole or not at all."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED = ".unfinished-"
"""How the name of a file begins while it is written."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Give an error of the system the name of the file, which `write` leaves out (a full disk).

    Raises
    ------
    OSError
        that was raised inside, naming `path`.
    """
    try:
        yield
    except OSError as error:
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """Yield the name of a file to write instead, which becomes `path` when all went well.

    The file lies in the same folder, has the same suffix, and is this process' own. After an error it is
    gone, and `path` is as before.

    Raises
    ------
    OSError
        if the file cannot be written (no space, no permission); it names `path`.
    """
    unfinished = path.with_name(f"{UNFINISHED}{os.getpid()}-{path.name}")
    try:
        with naming(path):
            yield unfinished
            os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def sync(path: Path) -> None:
    """Return when a file has reached the disk, where it outlives a power cut.

    Raises
    ------
    OSError
        if it cannot be written; it names `path`.
    """
    with naming(path), path.open("rb+") as file:
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all; lines end as in `text` on every system.

    What UTF-8 lacks, from names of files that are no UTF-8, is written as Python and JSON escape it.

    Raises
    ------
    OSError
        if the file cannot be written; it names `path`.
    """
    with write_atomically(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")

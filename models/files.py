"""Files: how much they may hold, reading text from anybody, and writing that is whole or not at all."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MOST_NUMBERS = 1 << 25
"""Of one file of arrays: 34 million, such as 10,000 frames of 1,600 points, and 270 MB as float64."""

MOST_TEXT = 1 << 25  # bytes of one text file: 900,000 boxes of ground truth, or a mesh of 400,000 vertices
MOST_SETTINGS = 1 << 20  # bytes of one file that people write by hand: parameters, correspondences, joints
LAST_FRAME = 10**9  # the highest number of a frame: a camera reaches it after a year
UNFINISHED = ".unfinished-"  # how the name of a file begins while it is written


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Give an error of the system the name of the file, which `write` leaves out (a full disk)."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error


@contextmanager
def fitting(path: Path, expected: str) -> Iterator[None]:
    """Have whatever the content of a file leads to said in one line, as a `ValueError` that names the file.

    For what Python and numpy do with it, which check indices and shapes themselves: they raise almost
    anything. Errors of the system and of memory, and those that name its folder, stay as they are.
    """
    try:
        yield
    except (OSError, MemoryError):
        raise
    except Exception as error:
        if str(path) in str(error) or f"{path.parent}{os.sep}" in str(error):
            raise
        said = " ".join(str(error).split())[:80] or type(error).__name__
        raise ValueError(f"{path}: got other content ({said}), {expected}") from error


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """Yield the name of a file to write instead, which becomes `path` when all went well.

    The file lies in the same folder, has the same suffix, and is this process' own. After an error it is
    gone, and `path` is as before. An `OSError` (no space, no permission) names `path`.
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
    """Return when a file has reached the disk, where it outlives a power cut; an `OSError` names `path`."""
    with naming(path), path.open("rb+") as file:
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text as of `write_atomically`; lines end as in `text` on every system.

    What UTF-8 lacks, from names of files that are no UTF-8, is written as Python and JSON escape it.
    """
    with write_atomically(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def read_text(path: Path, expected: str, most: int = MOST_TEXT) -> str:
    """Read a text file; bytes that are not UTF-8 become replacement characters, a byte order mark goes.

    `expected` says what the file should hold, for messages; `most` bytes it may hold.

    Raises
    ------
    ValueError
        naming the file, if it is longer, or binary.
    """
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path}: got more than {most} bytes, {expected}")
    if b"\0" in content:
        raise ValueError(f"{path}: got binary data, {expected}")
    return content.decode("utf-8-sig", "replace")

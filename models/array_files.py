"""Files of arrays, `.npy`, `.npz`, `.mat`, from anybody: headers are judged first, nothing is unpickled."""

import math
import os
import warnings
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .core.checks import Sizes, check_of
from .files import MOST_NUMBERS

SINGLE = ""  # the name of the one array of an `.npy` file

NUMBER = 8  # bytes: what a number takes at most; longer ones, and texts, count as several
LONGEST_HEADER = 10_000  # bytes
KINDS = "biufcSU"  # of numpy's types: numbers and text
ARCHIVE = (b"PK\x03\x04", b"PK\x05\x06")  # how a zip file begins, and one without members
PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # as numpy does; other ways unpack without bounds
ENCRYPTED = 1  # flag of a member
MATLAB = (b"MATL", bytes(4))  # how a file of MATLAB 5 and later begins, and one of MATLAB 4 with doubles
MATLAB_KINDS = ("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))

Arrays = dict[str, NDArray[Any]]


def read_fields(path: Path, expected: str, kinds: Mapping[str, Any]) -> Arrays:
    """Read those arrays of an unpacked `.npz` that have kinds, as `models.core.checks` has them.

    A `ValueError` in one line names the file, if one is not there, or is none of its kind.
    """
    arrays = read_arrays(path, expected, most=path.stat().st_size, only=kinds)
    require_fields(path, expected, kinds, arrays)
    return arrays


def require_fields(path: Path, expected: str, kinds: Mapping[str, Any], arrays: Arrays) -> None:
    """Raise the `ValueError` of `read_fields`; names of sizes hold for all arrays."""
    sizes: Sizes = {}
    try:
        for name, kind in kinds.items():
            check_of(kind)(arrays.get(name), name, sizes)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}, {expected}") from None


def read_arrays(
    path: Path,
    expected: str,
    most: int = MOST_NUMBERS,
    shape_only: Collection[str] = (),
    only: Collection[str] | None = None,
) -> Arrays:
    """Read all arrays of a file.

    Parameters
    ----------
    path
        `.npz`, or `.npy` with one array, which is called `SINGLE`, or a `.mat` of MATLAB up to 7.2, of which
        all that is no array of numbers is left out; the content tells which, not the name.
    expected
        what the file should hold, for messages: "expected ...".
    most
        numbers that it may hold in all.
    shape_only
        names of arrays of which only shape and type are wanted: they come as zeros that take no memory, and
        do not count.
    only
        names of the arrays to read of an `.npz`; default: all.

    Raises
    ------
    ValueError
        in one line that names the file and says what is wrong: it is no such file, it is damaged, or it holds
        objects or more than `most` numbers.
    """
    with path.open("rb") as file:
        try:
            return _arrays(file, most, shape_only, only)
        except _WrongError as error:
            wrong = str(error)
        except Exception as error:  # broken bytes make zip and numpy raise almost anything
            wrong = f"a damaged file ({' '.join(str(error).split())[:80] or type(error).__name__})"
    raise ValueError(f"{path}: got {wrong}, {expected}")


class _WrongError(Exception):
    """What is wrong with a file, in our own words."""


def _arrays(file: IO[bytes], most: int, shape_only: Collection[str], only: Collection[str] | None) -> Arrays:
    beginning = file.read(4)
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    if np.lib.format.MAGIC_PREFIX.startswith(beginning) and beginning:
        return {SINGLE: _array(file, "array", size, most)}
    if beginning in MATLAB:
        return _of_matlab(file, size, most)
    if beginning not in ARCHIVE:
        raise _WrongError("neither .npy nor .npz")
    arrays: Arrays = {}
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if only is not None and name not in only:
                continue
            if name in arrays:
                raise _WrongError(f"array {name[:60]!r} twice")
            # a comment would be the next member, when a length is damaged
            if member.compress_type not in PACKED or member.flag_bits & ENCRYPTED or member.comment:
                raise _WrongError(f"array {name[:60]!r} packed in a way that is not numpy's")
            with archive.open(member) as stream:
                if name in shape_only:
                    shape, dtype = _header(stream, f"array {name[:60]!r}")
                    arrays[name] = np.broadcast_to(np.zeros((), dtype), shape)
                    continue
                arrays[name] = _array(stream, f"array {name[:60]!r}", member.file_size, most)
            most -= _numbers(arrays[name].shape, arrays[name].dtype)
    return arrays


def _of_matlab(file: IO[bytes], size: int, most: int) -> Arrays:
    """The arrays of numbers of a file of MATLAB; `size` is the file's."""
    from scipy.io import loadmat, whosmat

    if file.read(8).startswith(b"MATLAB 7"):
        raise _WrongError("a file of MATLAB 7.3 (HDF5), which save(..., '-v7') writes so that it can be read")
    file.seek(0)
    wanted = [(name, shape) for name, shape, kind in whosmat(file) if kind in MATLAB_KINDS]  # type: ignore[arg-type]
    numbers = sum(math.prod(shape) for _, shape in wanted)
    if numbers > most or size > NUMBER * most + LONGEST_HEADER:
        raise _WrongError(f"{numbers} numbers in {size} bytes, more than are taken")
    file.seek(0)
    content = loadmat(file, variable_names=[name for name, _ in wanted])  # type: ignore[arg-type]
    return {name: np.asarray(content[name]) for name, _ in wanted}


def _array(stream: IO[bytes], what: str, size: int, most: int) -> NDArray[Any]:
    """The array of a stream of `size` bytes."""
    if size > NUMBER * most + LONGEST_HEADER:
        raise _WrongError(f"{what} of {size} bytes, more than are taken")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers of older versions
        shape, dtype = _header(stream, what)
        if _numbers(shape, dtype) > most:
            raise _WrongError(f"{what} {shape} {dtype}, more numbers than are taken")
        stated, held = math.prod(shape) * dtype.itemsize, size - stream.tell()
        if stated != held:
            raise _WrongError(f"{what} {shape} {dtype} with {held} bytes instead of {stated}")
        stream.seek(0)
        array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array


def _header(stream: IO[bytes], what: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of the array of a stream, which is read up to its numbers."""
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream, LONGEST_HEADER)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream, LONGEST_HEADER)
    if dtype.hasobject:
        raise _WrongError(f"{what} of objects")
    if dtype.kind not in KINDS:
        raise _WrongError(f"{what} of {dtype}")
    if min(shape, default=0) < 0:
        raise _WrongError(f"{what} of shape {shape}")
    return shape, dtype


def _numbers(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    return math.prod(shape) * max(1, -(-dtype.itemsize // NUMBER))

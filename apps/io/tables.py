"""Tables that others have written, as lines of text, read row by row, or as JSON.

What is wrong with a row is one line: `FILE, line 3: got ..., expected ...`.
"""

import csv
import hashlib
import json
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from reprlib import repr as brief
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from ...models.files import LAST_FRAME, read_text

LONGEST_LINE = 10_000  # characters of a table: beyond, it is none

MOST_JSON = 1 << 29
"""Bytes of a file of JSON, which is held in memory: boxes of some hours."""


class Row(NamedTuple):
    """A row of a table: its values by the names of columns, and where it stands in the file, as "line" 3."""

    path: str | Path
    unit: str
    place: int
    values: dict[str, Any]

    def wrong(self, got: str, expected: str) -> ValueError:
        """What to raise for something wrong in the row."""
        return ValueError(f"{self.path}, {self.unit} {self.place}: got {got}, expected {expected}")


class Column(NamedTuple):
    """A column of text under a header.

    Parameters
    ----------
    names
        that it may have there; the first that is there goes.
    kind
        what its values are: any finite number, "frame", a whole one from 1 to `LAST_FRAME`, or "text".
    empty
        whether a number may be left out, which is NaN then.
    """

    names: tuple[str, ...]
    kind: str = "number"
    empty: bool = False

    def read(self, name: str, text: str, row: Row) -> float | str:
        """The value that a text says; ValueError, naming the place, if it is none of this column."""
        if self.kind == "text":
            return text.strip()
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            if self.empty and not text.strip():
                return math.nan
            raise row.wrong(f"{name} {text[:30]!r}", "a number")
        if self.kind == "frame" and not is_frame(number):
            raise row.wrong(f"frame {number:g}", f"a whole number from 1 to {LAST_FRAME}")
        return number


def is_frame(value: float) -> bool:
    """Whether a number is one of a frame."""
    return 1 <= value <= LAST_FRAME and value % 1 == 0


def rows_of_frame(frames: NDArray[np.int64], number: int) -> slice:
    """Which rows of a table are of a frame, given the ascending frames of all rows."""
    first, end = np.searchsorted(frames, [number, number + 1])
    return slice(int(first), int(end))


def digest(path: Path, pattern: str = "*") -> str:
    """The sha256 of a file, by which it is known again; of a folder, that of its files of a pattern."""
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    whole = hashlib.sha256()
    for each in sorted(path.glob(pattern)):
        whole.update(f"{each.name} {digest(each)}\n".encode())
    return whole.hexdigest()


def first_line(path: Path, forms: str) -> str:
    """The first line of a file that is not empty, by which its form is known; `forms` are expected.

    Raises
    ------
    ValueError
        naming the file, if there is none or it is no text.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        line = next((line for line in lines_of(file) if line.strip()), "")
    if not line:
        raise ValueError(f"{path}: holds nothing, expected {forms}")
    if "\0" in line:
        raise ValueError(f"{path}: got binary data, expected {forms}")
    return line


def lines_of(file: TextIO) -> Iterator[str]:
    """Lines of a text, cut where one is too long."""
    return iter(lambda: file.readline(LONGEST_LINE), "")


def csv_rows(
    path: Path, columns: Mapping[str, Column], needed: Sequence[Collection[str]], expected: str
) -> Iterator[Row]:
    """Rows of a text under a header that names its columns, between commas, semicolons or tabs.

    Parameters
    ----------
    path
        of the file.
    columns
        that are read, by the names of values.
    needed, expected
        the header has to name all columns of one of these; this in words.

    Raises
    ------
    ValueError
        naming file and line, if it is no such text.
    """
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = _csv_lines(path, file)
        header = next(lines, "")
        delimiter = max(",;\t", key=header.count)
        names = next(csv.reader([header], delimiter=delimiter))
        written = [name.strip().lower() for name in names]
        there = {
            key: written.index(name)
            for key, column in columns.items()
            if (name := next((name for name in column.names if name in written), None)) is not None
        }
        if not any(there.keys() >= set(each) for each in needed):
            raise ValueError(f"{path}, line 1: got columns {', '.join(names)[:80]!r}, expected {expected}")
        for number, fields in enumerate(csv.reader(lines, delimiter=delimiter), start=2):
            if any(fields):
                row = Row(path, "line", number, {})
                for key, index in there.items():
                    if index >= len(fields):
                        raise row.wrong(f"{len(fields)} columns", f"{key} in column {index + 1}")
                    row.values[key] = columns[key].read(key, fields[index], row)
                yield row


def _csv_lines(path: Path, file: TextIO) -> Iterator[str]:
    for number, line in enumerate(lines_of(file), start=1):
        if "\0" in line or len(line) >= LONGEST_LINE:
            raise ValueError(f"{path}, line {number}: got no text of short lines, expected CSV")
        if line.count('"') % 2:
            raise ValueError(f"{path}, line {number}: got a quote that does not end, expected one line each")
        yield line


def read_json(path: Path, expected: str) -> Any:
    """Read a file of JSON, of which messages say what is expected.

    Raises
    ------
    ValueError
        naming the file, and the line if that is known, if it is broken or too large.
    """
    text = read_text(path, f"expected {expected}", MOST_JSON)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        got = "more behind the end" if error.msg == "Extra data" else "no JSON, or a part of it"
        raise ValueError(f"{path}, line {error.lineno}: got {got}, expected {expected}") from None
    except (ValueError, RecursionError):  # a number of thousands of digits, lists without end
        raise ValueError(f"{path}: got no value that such a file has, expected {expected}") from None


def json_rows(path: Path, unit: str, items: object, needed: Sequence[str], expected: str) -> Iterator[Row]:
    """The objects of a list, a row each; each has the names that are needed."""
    if not isinstance(items, list):
        raise ValueError(f"{path}: got {brief(items)}, expected {expected}")
    for place, item in enumerate(items, start=1):
        row = Row(path, unit, place, item)
        if not isinstance(item, dict):
            raise row.wrong(brief(item), "an object in braces")
        for name in needed:
            if name not in item:
                raise row.wrong(f"no {name}", ", ".join(needed))
        yield row


class Pictures:
    """Tells the number of a frame from what a row says of its image: the number, or the name of a picture.

    Parameters
    ----------
    film
        its name.
    pictures
        names of its pictures in order, if it consists of such; those of a video are told by the last number
        in their names, from 1.
    """

    def __init__(self, film: str, pictures: Sequence[str]) -> None:
        self._film = film
        self._numbers = {name: number for number, name in enumerate(pictures, start=1)}

    def frame(self, row: Row, image: object) -> int:
        """The number of the frame of an image; ValueError, naming the row, if it is none of the film."""
        number = image_id(row, image)
        if isinstance(number, str):
            name = PurePosixPath(number.replace("\\", "/")).name
            if self._numbers:
                if name in self._numbers:
                    return self._numbers[name]
                raise row.wrong(f"image {name[:80]!r}", f"a picture of {self._film}")
            digits = re.findall(r"[0-9]{1,20}", name.rpartition(".")[0] or name)
            number = int(digits[-1]) if digits else 0
        if not is_frame(number):
            raise row.wrong(f"image {str(image)[:80]!r}", f"a frame from 1 to {LAST_FRAME}")
        return number


def image_id(row: Row, value: object) -> int | str:
    """A number or a name of an image; ValueError, naming the row, if it is neither."""
    if isinstance(value, int | str) and not isinstance(value, bool):
        return value
    raise row.wrong(f"image {brief(value)}", "a number or a name")

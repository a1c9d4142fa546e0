"""Detections in text: MOT's `det.txt`, and CSV with a header."""

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TextIO

from ....models.files import LAST_FRAME
from ..mot import LONGEST_LINE, read_lines
from .table import Columns, Detections, whole_frame

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "frame": ("frame", "frame_number"),
    "left": ("left", "x", "x1", "xmin", "x_min"),
    "top": ("top", "y", "y1", "ymin", "y_min"),
    "width": ("width", "w"),
    "height": ("height", "h"),
    "right": ("right", "x2", "xmax", "x_max"),
    "bottom": ("bottom", "y2", "ymax", "y_max"),
    "confidence": ("confidence", "score", "conf"),
    "class": ("class", "class_name", "label", "class_id", "category"),
}
"""Names that a column may have in a header; the first that is there goes."""

NEEDED = (("frame", "left", "top", "width", "height"), ("frame", "left", "top", "right", "bottom"))
EXPECTED = "frame and either x, y, width, height or left, top, right, bottom"


def read_mot(path: Path) -> Detections:
    """Read detections in MOT format: frame, -1, left, top, width, height, score, in px from 1.

    What follows the score is not read; a file without scores ends after the height.

    Raises
    ------
    ValueError
        naming file and line, if a line is no such box.
    OSError
        if the file cannot be read.
    """
    columns = Columns(path, "line")
    for number, (frame, _, x, y, width, height, *others) in read_lines(path):
        left, top = x - 1, y - 1
        xyxy = (left, top, left + width, top + height)
        columns.add(number, int(frame), xyxy, others[0] if others else None, None)
    return columns.table()


def read_csv(path: Path) -> Detections:
    """Read detections in CSV with a header that names the columns; frames count from 1, px from 0.

    Raises
    ------
    ValueError
        naming file and line, if a line is no such box.
    OSError
        if the file cannot be read.
    """
    columns = Columns(path, "line")
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = short_lines(path, file)
        header = next(lines, "")
        delimiter = max(",;\t", key=header.count)
        place = _places(path, next(csv.reader([header], delimiter=delimiter)))
        number = 1
        try:
            for number, fields in enumerate(csv.reader(lines, delimiter=delimiter), start=2):
                if fields:
                    frame, xyxy, confidence, class_name = _row(columns, number, fields, place)
                    columns.add(number, frame, xyxy, confidence, class_name)
        except csv.Error as error:
            raise ValueError(f"{path}, line {number}: {error}") from None
    return columns.table()


def short_lines(path: Path, file: TextIO) -> Iterator[str]:
    """Lines of a bounded length."""
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), start=1):
        if "\0" in line or len(line) >= LONGEST_LINE:
            raise ValueError(f"{path}, line {number}: got no text of short lines, expected CSV")
        if '"' in line and line.count('"') % 2:
            raise ValueError(f"{path}, line {number}: got a quote that does not end, expected one line each")
        yield line


def _places(path: Path, header: list[str]) -> dict[str, int]:
    """Where each column stands."""
    written = [name.strip().lower() for name in header]
    place = {}
    for column, names in COLUMNS.items():
        there = [written.index(name) for name in names if name in written]
        if there:
            place[column] = there[0]
    if not any(all(name in place for name in needed) for needed in NEEDED):
        raise ValueError(f"{path}, line 1: got columns {', '.join(header)[:80]!r}, expected {EXPECTED}")
    return place


def _row(
    columns: Columns, number: int, fields: list[str], place: Mapping[str, int]
) -> tuple[int, tuple[float, float, float, float], float | None, str | None]:
    """Frame, edges, score and class of a line."""
    values = {}
    for name, index in place.items():
        if index >= len(fields):
            raise columns.wrong(number, f"{len(fields)} columns", f"{name} in column {index + 1}")
        if name != "class":
            try:
                values[name] = float(fields[index])
            except ValueError:
                values[name] = math.nan
            if not math.isfinite(values[name]):
                raise columns.wrong(number, f"{name} {fields[index][:30]!r}", "a number")
    if not whole_frame(values["frame"]):
        raise columns.wrong(number, f"frame {values['frame']:g}", f"a whole number from 1 to {LAST_FRAME}")
    left, top = values["left"], values["top"]
    if "width" in values and "height" in values:
        right, bottom = left + values["width"], top + values["height"]
    else:
        right, bottom = values["right"], values["bottom"]
    name_of_class = fields[place["class"]].strip() if "class" in place else None
    return int(values["frame"]), (left, top, right, bottom), values.get("confidence"), name_of_class

"""Keypoints in CSV: a point a line."""

import csv
import math
from collections.abc import Mapping
from pathlib import Path

from ....models.core.keypoints import KEYPOINTS, KNOWN, POINTS
from ....models.files import LAST_FRAME
from ..detections.table import whole_frame
from ..detections.text import short_lines
from .table import Keypoints, Persons

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "frame": ("frame", "frame_number"),
    "person": ("person", "person_id", "track_id"),
    "joint": ("joint", "keypoint", "landmark", "name"),
    "x": ("x",),
    "y": ("y",),
    "score": ("score", "confidence", "conf", "visibility"),
}
"""Names that a column may have in a header; the first that is there goes."""

NEEDED = ("frame", "joint", "x", "y")


def read_csv(path: Path) -> Keypoints:
    """Read points in CSV with a header that names the columns; frames count from 1, px from 0.

    Columns are frame, joint, x, y, and perhaps person and score. An empty place is a point not found.

    Raises
    ------
    ValueError
        naming file and line, if a line is no such point.
    OSError
        if the file cannot be read.
    """
    persons = Persons(path)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = short_lines(path, file)
        header = next(lines, "")
        delimiter = max(",;\t", key=header.count)
        number = 1
        try:
            columns = _columns(path, next(csv.reader([header], delimiter=delimiter)))
            for number, fields in enumerate(csv.reader(lines, delimiter=delimiter), start=2):
                if any(fields):
                    _take(persons, f"line {number}", fields, columns)
        except csv.Error as error:
            raise ValueError(f"{path}, line {number}: {error}") from None
    return persons.table()


def _columns(path: Path, header: list[str]) -> dict[str, int]:
    """Where each column stands."""
    written = [name.strip().lower() for name in header]
    columns = {}
    for column, names in COLUMNS.items():
        there = [written.index(name) for name in names if name in written]
        if there:
            columns[column] = there[0]
    if not all(name in columns for name in NEEDED):
        got = ", ".join(header)[:80]
        raise ValueError(
            f"{path}, line 1: got columns {got!r}, expected {', '.join(NEEDED)}, and perhaps person and score"
        )
    return columns


def _take(persons: Persons, place: str, fields: list[str], columns: Mapping[str, int]) -> None:
    """Add a line's point to those of its person."""
    values = {}
    for name, index in columns.items():
        if index >= len(fields):
            raise persons.wrong(place, f"{len(fields)} columns", f"{name} in column {index + 1}")
        values[name] = fields[index].strip()
    joint = values["joint"].lower().replace(" ", "_")
    if joint not in KNOWN:
        raise persons.wrong(place, f"joint {values['joint'][:40]!r}", f"one of {', '.join(KEYPOINTS)}")
    frame = _number(persons, place, "frame", values["frame"])
    if not whole_frame(frame):
        raise persons.wrong(place, f"frame {frame:g}", f"a whole number from 1 to {LAST_FRAME}")
    points = persons.of(int(frame), values.get("person"), place)
    if not (values["x"] or values["y"]):
        return
    x, y, score = (_number(persons, place, name, values.get(name, "1")) for name in ("x", "y", "score"))
    if joint in POINTS and not math.isnan(points[POINTS.index(joint), 0]):
        raise persons.wrong(place, f"{joint} of frame {frame:g} a second time", "once, or a column person")
    persons.write(points, joint, (x, y, score), place)


def _number(persons: Persons, place: str, name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise persons.wrong(place, f"{name} {text[:30]!r}", "a number")
    return number

"""Files of detections of any of the usual forms."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from ..mot import LONGEST_LINE
from .coco import read_coco
from .table import Detections
from .text import read_csv, read_mot

FORMS = "MOT's det.txt, CSV with a header, or COCO's JSON"


def read_detections(
    path: str | Path, classes: Sequence[str] = (), *, film: str = "the film", pictures: Sequence[str] = ()
) -> Detections:
    """Read what a detector has found in the frames of a film; the content tells the file's form.

    Parameters
    ----------
    path
        MOT's `det.txt` (`read_mot`), CSV with a header (`read_csv`), or COCO's JSON (`read_coco`).
    classes
        names of classes to keep; all where there are none.
    film, pictures
        name of the film, and of its pictures in order, if it consists of such: COCO's JSON may name them.

    Raises
    ------
    ValueError
        naming file and line, if it is no such file, or is damaged or empty; or naming what classes there are,
        if there is none of a name.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    line = first_line(path, FORMS)
    if line.lstrip()[0] in "[{":
        found = read_coco(path, film, pictures)
    elif "frame" in line.lower():
        found = read_csv(path)
    elif line.lstrip()[0] in "+-.0123456789":
        found = read_mot(path)
    else:
        raise ValueError(f"{path}, line 1: got {line.strip()[:60]!r}, expected {FORMS}")
    if not found.looked:
        raise ValueError(f"{path}: holds no detections")
    return found.of_classes(classes) if classes else found


def first_line(path: Path, forms: str) -> str:
    """The first line of a file that is not empty, by which its form is known.

    Raises
    ------
    ValueError
        naming the file and what is expected, the `forms`, if there is none or it is no text.
    OSError
        if the file cannot be read.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        line = next((line for line in iter(lambda: file.readline(LONGEST_LINE), "") if line.strip()), "")
    if not line:
        raise ValueError(f"{path}: holds nothing, expected {forms}")
    if "\0" in line:
        raise ValueError(f"{path}: got binary data, expected {forms}")
    return line


def digest(path: Path) -> str:
    """The sha256 of a file's content, by which it is known again."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

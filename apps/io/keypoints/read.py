"""Files of keypoints of any of the usual forms."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from ..detections.read import digest, first_line
from .coco import read_coco
from .openpose import ENDING, read_openpose
from .table import Keypoints
from .text import read_csv

FORMS = "CSV with a header, COCO's JSON of results, or the folder of OpenPose's JSON"


def read_keypoints(path: str | Path, *, film: str = "the film", pictures: Sequence[str] = ()) -> Keypoints:
    """Read the points that a detector has found of persons in a film; the content tells the form.

    Parameters
    ----------
    path
        CSV with a header (`read_csv`), COCO's JSON of results (`read_coco`), or the folder of OpenPose's JSON
        (`read_openpose`).
    film, pictures
        name of the film, and of its pictures in order, if it consists of such.

    Raises
    ------
    ValueError
        naming file and place, if it is no such file, or is damaged or empty.
    OSError
        if it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        return read_openpose(path, film, pictures)
    line = first_line(path, FORMS)
    if line.lstrip()[0] in "[{":
        return read_coco(path, film, pictures)
    if "frame" in line.lower():
        return read_csv(path)
    raise ValueError(f"{path}, line 1: got {line.strip()[:60]!r}, expected {FORMS}")


def digest_of(path: Path) -> str:
    """The sha256 of a file's content, or of all files of a folder that were read."""
    if not path.is_dir():
        return digest(path)
    whole = hashlib.sha256()
    for file in sorted(path.glob(f"*{ENDING}")):
        whole.update(f"{file.name} {digest(file)}\n".encode())
    return whole.hexdigest()

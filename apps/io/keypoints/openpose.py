"""Keypoints as OpenPose writes them: a folder with a JSON file a frame."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from reprlib import repr as brief
from typing import Any

import numpy as np

from ....models.core.keypoints import SKELETONS
from ....models.files import MOST_SETTINGS, read_text
from ..detections.coco import Pictures
from .coco import triples
from .table import Keypoints, Persons

ENDING = "_keypoints.json"

HAND_POINTS = 21

BODIES = (25, 18)
"""Numbers of points of its bodies: BODY_25, and COCO with a neck."""


def read_openpose(folder: Path, film: str, pictures: Sequence[str]) -> Keypoints:
    """Read `NAME_keypoints.json` of every frame; px count from 0.

    Of films, OpenPose numbers frames from 0, with the last number in the name; of a folder of pictures, NAME
    is that of the picture. Bodies have 25 or 18 points. Where hands were found as well (21 points), their
    centre is the mean of those.

    Parameters
    ----------
    folder
        with these files.
    film, pictures
        name of the film, and of its pictures in order, if it consists of such.

    Raises
    ------
    ValueError
        naming the file, if one is no such file, or of a picture that the film does not have; or if there is
        none.
    OSError
        if one cannot be read.
    """
    persons = Persons(folder)
    stems = {Path(name).stem: name for name in pictures}
    frame_of = Pictures(folder, film, pictures)
    paths = sorted(path for path in folder.iterdir() if path.name.endswith(ENDING))
    if not paths:
        raise ValueError(f"{folder}: got no file NAME{ENDING}, expected the folder of OpenPose's results")
    for number, path in enumerate(paths, start=1):
        name = path.name.removesuffix(ENDING)
        known = frame_of("file", number, stems.get(name, name)) if pictures else None
        frame = known or _frame(persons, name)
        for who, person in enumerate(_people(path)):
            _take(persons, frame, who, person, f"{path.name}, person {who + 1}")
    return persons.table()


def _frame(persons: Persons, name: str) -> int:
    digits = name.rpartition("_")[2]
    if not (digits.isdecimal() and digits.isascii() and len(digits) <= 12):
        raise persons.wrong(
            f"{name}{ENDING}", "a name without a number", f"such as film_000000000012{ENDING}"
        )
    return int(digits) + 1


def _people(path: Path) -> list[Any]:
    """The people of a frame."""
    expected = "expected the JSON of OpenPose: version and people"
    text = read_text(path, expected, MOST_SETTINGS)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"{path}: got no JSON, or a part of it, {expected}") from None
    people = content.get("people") if isinstance(content, dict) else None
    if not isinstance(people, list):
        raise ValueError(f"{path}: got {brief(content)}, {expected}")
    return people


def _take(persons: Persons, frame: int, who: int, person: Any, place: str) -> None:
    """Add the points of a person."""
    if not isinstance(person, Mapping) or not isinstance(person.get("pose_keypoints_2d"), list):
        raise persons.wrong(place, brief(person), "an object with pose_keypoints_2d")
    points, body = persons.of(frame, who, place), person["pose_keypoints_2d"]
    n_points = next((count for count in BODIES if len(body) == 3 * count), BODIES[0])
    for name, triple in zip(SKELETONS[n_points], triples(persons, place, body, n_points), strict=True):
        persons.write(points, name, triple, place)
    for side in ("left", "right"):
        hand = person.get(f"hand_{side}_keypoints_2d")
        if hand:
            found = np.array(triples(persons, place, hand, HAND_POINTS))
            found = found[found[:, 2] > 0]
            if len(found):
                x, y, score = found.mean(axis=0).tolist()
                persons.write(points, f"{side}_hand", (x, y, score), place)

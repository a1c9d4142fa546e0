"""Keypoints in COCO's JSON: a list of results, one a person."""

from collections.abc import Sequence
from pathlib import Path
from reprlib import repr as brief

from ....models.core.keypoints import COCO
from ..detections.coco import Pictures, fields_of, image_id
from ..detections.json_stream import JsonStream
from .table import Keypoints, Persons

EXPECTED = "keypoints in COCO's form: a list of image_id, keypoints, score"


def read_coco(path: Path, film: str, pictures: Sequence[str]) -> Keypoints:
    """Read a list of results; `keypoints` are x, y (px from 0) and score of 17 points.

    Parameters
    ----------
    path
        of the file.
    film, pictures
        as of `detections.coco.read_coco`: `image_id` is the number of a frame, or names a picture.

    Raises
    ------
    ValueError
        naming the file and where in it, if it is no such file, or names a picture that the film does not
        have.
    OSError
        if the file cannot be read.
    """
    frame_of, persons = Pictures(path, film, pictures), Persons(path)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        stream = JsonStream(path, file, EXPECTED)
        for number, item in enumerate(stream.items(), start=1):
            found = fields_of(path, "result", number, item, ("image_id", "keypoints"))
            frame = frame_of("result", number, image_id(path, "result", number, found["image_id"]))
            place = f"result {number}"
            points = persons.of(frame, number, place)
            numbers = triples(persons, place, found["keypoints"], len(COCO))
            for name, triple in zip(COCO, numbers, strict=True):
                persons.write(points, name, triple, place)
        stream.end()
    return persons.table()


def triples(persons: Persons, place: str, values: object, n_points: int) -> list[tuple[float, float, float]]:
    """x, y and score of points that stand in a row.

    Raises
    ------
    ValueError
        naming the place, if that is not what is there.
    """
    if not isinstance(values, list) or len(values) != 3 * n_points:
        got = f"{len(values)} numbers" if isinstance(values, list) else brief(values)
        raise persons.wrong(place, got, f"x, y and score of {n_points} points")
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError, OverflowError):
        raise persons.wrong(place, brief(values), "numbers") from None
    return list(zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True))

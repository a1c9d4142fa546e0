"""Detections in COCO's JSON: lists of results, and data sets with images, annotations and categories."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from reprlib import repr as brief
from typing import Any

from ....models.files import LAST_FRAME
from .json_stream import JsonStream
from .table import Columns, Detections, whole_frame

ImageId = int | str

EXPECTED = (
    "detections in COCO's form: a list of image_id, category_id, bbox, score, or images, annotations and "
    "categories"
)


def read_coco(path: Path, film: str, pictures: Sequence[str]) -> Detections:
    """Read detections in COCO's form; boxes are left, top, width, height, in px from 0.

    A list of results has the number of the frame as `image_id`, or the name of a picture. Classes are
    numbers there. A data set (`images`, `annotations`, `categories`) names its images, and lists those in
    which nothing was found. Outlines (`segmentation`) are not read.

    Parameters
    ----------
    path
        of the file.
    film
        name of the film.
    pictures
        names of its pictures in order, if it consists of such; those of a video are told by the last number
        in their names, from 1.

    Raises
    ------
    ValueError
        naming the file and where in it, if it is no such file, or names a picture that the film does not
        have.
    OSError
        if the file cannot be read.
    """
    frame_of = Pictures(path, film, pictures)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        stream = JsonStream(path, file, EXPECTED)
        if stream.peek() == "[":
            columns = Columns(path, "result")
            for place, item in enumerate(stream.items(), start=1):
                _add(columns, place, item, partial(frame_of, "result", place))
            stream.end()
            return columns.table()
        return _data_set(path, stream, frame_of)


def _data_set(path: Path, stream: JsonStream, frame_of: "Pictures") -> Detections:
    columns = Columns(path, "annotation")
    images: dict[ImageId, int] | None = None
    categories: dict[str, str] = {}
    codes: dict[ImageId, int] = {}  # of images, in the order in which annotations mention them
    mentioned: list[int] = []  # where each was mentioned first
    for key in stream.entries():
        if key == "images":
            images = {}
            for place, item in enumerate(stream.items(), start=1):
                image = fields_of(path, "image", place, item, ("id", "file_name"))
                images[image_id(path, "image", place, image["id"])] = frame_of(
                    "image", place, str(image["file_name"])
                )
        elif key == "annotations":
            for place, item in enumerate(stream.items(), start=1):

                def code(image: ImageId, place: int = place) -> int:
                    if image not in codes:
                        mentioned.append(place)
                    return codes.setdefault(image, len(codes))

                _add(columns, place, item, code)
        elif key == "categories":
            for place, item in enumerate(stream.items(), start=1):
                category = fields_of(path, "category", place, item, ("id", "name"))
                categories[str(category["id"])] = str(category["name"])
        else:
            stream.value()
    stream.end()
    if images is None:
        raise ValueError(f"{path}: got an object without images, expected images, annotations, categories")
    frames: list[int] = []
    for named, place in zip(codes, mentioned, strict=True):
        if named not in images:
            raise columns.wrong(place, f"image_id {named!r}", "one of the images listed")
        frames.append(images[named])
    return columns.table(frozenset(images.values()), frames.__getitem__, categories)


def _add(columns: Columns, place: int, item: Any, key_of: Callable[[ImageId], int]) -> None:
    found = fields_of(columns.path, columns.unit, place, item, ("image_id", "bbox"))
    box, score, category = found["bbox"], found.get("score"), found.get("category_id")
    try:
        left, top, width, height = map(float, box if isinstance(box, list) else ())
    except (TypeError, ValueError, OverflowError):
        raise columns.wrong(place, f"bbox {brief(box)}", "four numbers: left, top, width, height") from None
    try:
        confidence = None if score is None else float(score)
    except (TypeError, ValueError, OverflowError):
        raise columns.wrong(place, f"score {brief(score)}", "a number") from None
    if not (category is None or isinstance(category, int | str)):
        raise columns.wrong(place, f"category_id {brief(category)}", "a number")
    frame = key_of(image_id(columns.path, columns.unit, place, found["image_id"]))
    class_name = None if category is None else str(category)
    columns.add(place, frame, (left, top, left + width, top + height), confidence, class_name)


def fields_of(path: Path, unit: str, place: int, item: Any, needed: Sequence[str]) -> Mapping[str, Any]:
    """An object that has the fields that are needed, or an error that says where it stands."""
    if not isinstance(item, dict):
        raise ValueError(f"{path}, {unit} {place}: got {brief(item)}, expected an object in braces")
    for name in needed:
        if name not in item:
            raise ValueError(f"{path}, {unit} {place}: got no {name}, expected {', '.join(needed)}")
    return item


def image_id(path: Path, unit: str, place: int, value: Any) -> ImageId:
    """A number or a name of an image, or an error that says where it stands."""
    if isinstance(value, int | str) and not isinstance(value, bool):
        return value
    raise ValueError(f"{path}, {unit} {place}: got image {brief(value)}, expected a number or a name")


class Pictures:
    """Tells the number of a frame from its number, or from the name of a picture."""

    def __init__(self, path: Path, film: str, pictures: Sequence[str]) -> None:
        self._path = path
        self._film = film
        self._numbers = {name: number for number, name in enumerate(pictures, start=1)}

    def __call__(self, unit: str, place: int, image: ImageId) -> int:
        """The number of the frame of an image that is mentioned at a place, or an error that says where."""
        if isinstance(image, str):
            name = PurePosixPath(image.replace("\\", "/")).name
            if self._numbers:
                if name in self._numbers:
                    return self._numbers[name]
                raise self._wrong(unit, place, f"{name[:80]!r}", f"a picture of {self._film}")
            digits = re.findall(r"[0-9]{1,20}", name.rpartition(".")[0] or name)
            number = int(digits[-1]) if digits else 0
        else:
            number = image
        if not whole_frame(number):
            raise self._wrong(unit, place, f"{str(image)[:80]!r}", f"a frame from 1 to {LAST_FRAME}")
        return number

    def _wrong(self, unit: str, place: int, got: str, expected: str) -> ValueError:
        return ValueError(f"{self._path}, {unit} {place}: got image {got}, expected {expected}")

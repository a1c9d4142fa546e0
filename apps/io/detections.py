"""Boxes that a detector has found in the frames of a film: in files, or by a callable as frames come."""

import re
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from reprlib import repr as brief
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.core.frame import LARGEST_SCORE, Frame, GivenBoxes
from ...models.core.short_repr import short_repr
from ..options.complaints import meant
from .point_files import MAX_COORDINATE
from .sources.open_source import Source
from .tables import Column, Pictures, Row, csv_rows, first_line, image_id, json_rows, read_json, rows_of_frame
from .tracks import mot_rows

COLUMNS = {
    "frame": Column(("frame", "frame_number"), "frame"),
    "left": Column(("left", "x", "x1", "xmin", "x_min")),
    "top": Column(("top", "y", "y1", "ymin", "y_min")),
    "width": Column(("width", "w")),
    "height": Column(("height", "h")),
    "right": Column(("right", "x2", "xmax", "x_max")),
    "bottom": Column(("bottom", "y2", "ymax", "y_max")),
    "confidence": Column(("confidence", "score", "conf")),
    "class": Column(("class", "class_name", "label", "class_id", "category"), "text"),
}
NEEDED = (("frame", "left", "top", "width", "height"), ("frame", "left", "top", "right", "bottom"))

EXPECTED_COCO = (
    "detections in COCO's form: a list of image_id, category_id, bbox, score, or images, annotations and "
    "categories"
)

Edges = tuple[float, float, float, float]
"""Left, top, right, bottom, px from 0."""

FileBox = tuple[Row, int, Edges, float | None, str | None]
"""Where a box stands in the file, its frame, its edges, and perhaps score and class."""

SHOWN_CLASSES = 10  # in a message


@short_repr
@dataclass(frozen=True, eq=False)
class Detections:
    """Detections of a video from a file; calling it with a frame returns the boxes of that frame.

    Parameters
    ----------
    path
        of the file.
    frame
        `(n,)` int64, 1-based, ascending.
    xyxy
        `(n, 4)` float64 px from 0: left, top, right, bottom.
    confidence
        `(n,)` float64; `None` if the file has none.
    class_index, class_names
        `(n,)` int32 into the names, and `(n_classes,)` text; `None` and empty if the file has none.
    place, unit
        `(n,)` int64: position of each in the file, in units such as "line".
    looked
        the frames on which the detector ran.
    """

    path: Path
    frame: NDArray[np.int64]
    xyxy: NDArray[np.float64]
    confidence: NDArray[np.float64] | None
    class_index: NDArray[np.int32] | None
    class_names: NDArray[np.str_]
    place: NDArray[np.int64]
    unit: str
    looked: range | frozenset[int]

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> GivenBoxes | None:
        """The boxes of frame `number`, possibly none; `None` if the detector did not run."""
        if number not in self.looked:
            return None
        rows = rows_of_frame(self.frame, number)
        confidence = None if self.confidence is None else self.confidence[rows]
        classes = None if self.class_index is None else self.class_names[self.class_index[rows]]
        return GivenBoxes(self.xyxy[rows], confidence, classes)

    def __call__(self, frame: Frame) -> GivenBoxes | None:
        """The boxes of a frame, by its number."""
        return self.at(frame.number)

    def of_classes(self, names: Sequence[str]) -> "Detections":
        """Only the boxes of some classes; a ValueError that lists all classes if a name does not exist."""
        if self.class_index is None:
            raise ValueError(f"--classes: got {','.join(names)!r}, but {self.path} has no classes")
        known = self.class_names.tolist()
        for name in names:
            if name not in known:
                there = ", ".join(known[:SHOWN_CLASSES]) + (", …" if len(known) > SHOWN_CLASSES else "")
                raise ValueError(f"--classes: got {name!r}, but {self.path} has {there}{meant(name, known)}")
        kept = np.isin(self.class_index, [known.index(name) for name in names])
        return replace(
            self,
            frame=self.frame[kept],
            xyxy=self.xyxy[kept],
            confidence=None if self.confidence is None else self.confidence[kept],
            class_index=self.class_index[kept],
            place=self.place[kept],
        )

    def counted(self, numbers: Collection[int]) -> dict[str, int]:
        """Number of boxes in the frames of these numbers, and number of frames on which the detector ran."""
        looked = [number for number in numbers if number in self.looked]
        return {"boxes": int(np.isin(self.frame, looked).sum()), "frames": len(looked)}

    def check(self, film: str, size: tuple[int, int], last: int | None) -> None:
        """Check that the boxes fit a video with this name, `(width, height)` px and last frame.

        Raises
        ------
        ValueError
            if a frame comes after the last one, or a box is outside the image.
        """
        end = self.looked[-1] if isinstance(self.looked, range) else max(self.looked)
        if last is not None and end > last:
            first = int(np.searchsorted(self.frame, last + 1))
            place = f", {self.unit} {self.place[first]}" if first < len(self) else ""
            number = self.frame[first] if place else end
            raise ValueError(f"{self.path}{place}: got frame {number}, but {film} has {last} frames")
        left, top, right, bottom = self.xyxy.T
        beyond = np.flatnonzero((right <= 0) | (bottom <= 0) | (left >= size[0]) | (top >= size[1]))
        if beyond.size:
            box = int(beyond[0])
            corners = ", ".join(f"{edge:g}" for edge in self.xyxy[box])
            raise ValueError(
                f"{self.path}, {self.unit} {self.place[box]}: got a box from {corners} (left, top, right, "
                f"bottom) in frame {self.frame[box]}, outside of the picture of {size[0]}x{size[1]} px"
            )


@checked
def read_detections(
    path: str | Path, classes: Sequence[str] = (), *, film: str = "the film", pictures: Sequence[str] = ()
) -> Detections:
    """Read detections of a video; the format is recognised by the content.

    Parameters
    ----------
    path
        MOT's `det.txt` (`read_mot`), CSV with a header (`read_csv`), or COCO's JSON (`read_coco`).
    classes
        names of classes to keep; default: all.
    film, pictures
        name of the video, and names of its images in order, to which COCO's JSON may refer.

    Raises
    ------
    ValueError
        with file and line, if it is not such a file, damaged or empty; or with a list of all classes, if a
        name does not exist.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    line = first_line(path, EXPECTED)
    read = next((read for begins, read in FORMS if re.match(begins, line)), None)
    if read is None:
        raise ValueError(f"{path}, line 1: got {line.strip()[:60]!r}, expected {EXPECTED}")
    found = read(path, Pictures(film, pictures))
    if not found.looked:
        raise ValueError(f"{path}: holds no detections")
    return found.of_classes(classes) if classes else found


def read_mot(path: Path, _: Pictures) -> Detections:
    """Read detections in MOT format: frame, -1, left, top, width, height, score, in px from 1.

    What follows the score is not read; a file without scores ends after the height.
    """

    def boxes() -> Iterator[FileBox]:
        for row, (frame, _, x, y, width, height, *others) in mot_rows(path):
            left, top = x - 1, y - 1
            edges = (left, top, left + width, top + height)
            yield row, int(frame), edges, others[0] if others else None, None

    return _table(path, boxes())


def read_csv(path: Path, _: Pictures) -> Detections:
    """Read detections in CSV with a header that names the columns; frames count from 1, px from 0."""

    def boxes() -> Iterator[FileBox]:
        expected = "frame and either x, y, width, height or left, top, right, bottom"
        for row in csv_rows(path, COLUMNS, NEEDED, expected):
            values = row.values
            left, top = values["left"], values["top"]
            if "width" in values and "height" in values:
                edges = (left, top, left + values["width"], top + values["height"])
            else:
                edges = (left, top, values["right"], values["bottom"])
            yield row, int(values["frame"]), edges, values.get("confidence"), values.get("class")

    return _table(path, boxes())


def read_coco(path: Path, pictures: Pictures) -> Detections:
    """Read detections in COCO's form; boxes are left, top, width, height, in px from 0.

    A list of results has the number of the frame as `image_id`, or the name of a picture. Classes are
    numbers there. A data set (`images`, `annotations`, `categories`) names its images, and lists those in
    which nothing was found. Outlines (`segmentation`) are not read.
    """
    content = read_json(path, EXPECTED_COCO)
    if isinstance(content, list):
        rows = json_rows(path, "result", content, ("image_id", "bbox"), EXPECTED_COCO)
        return _table(path, (_of_coco(row, pictures.frame(row, row.values["image_id"]), {}) for row in rows))
    if "images" not in content:
        raise ValueError(f"{path}: got an object without images, expected images, annotations, categories")
    frames: dict[int | str, int] = {}
    categories: dict[str, str] = {}
    for row in json_rows(path, "image", content["images"], ("id", "file_name"), EXPECTED_COCO):
        frame = pictures.frame(row, str(row.values["file_name"]))
        frames[image_id(row, row.values["id"])] = frame
    for row in json_rows(path, "category", content.get("categories", []), ("id", "name"), EXPECTED_COCO):
        categories[str(row.values["id"])] = str(row.values["name"])

    def boxes() -> Iterator[FileBox]:
        items = content.get("annotations", [])
        for row in json_rows(path, "annotation", items, ("image_id", "bbox"), EXPECTED_COCO):
            image = image_id(row, row.values["image_id"])
            if image not in frames:
                raise row.wrong(f"image_id {image!r}", "one of the images listed")
            yield _of_coco(row, frames[image], categories)

    return _table(path, boxes(), frozenset(frames.values()), categories.values())


def _of_coco(row: Row, frame: int, categories: Mapping[str, str]) -> FileBox:
    box, category = row.values["bbox"], row.values.get("category_id")
    try:
        left, top, width, height = map(float, box if isinstance(box, list) else ())
    except (TypeError, ValueError, OverflowError):
        raise row.wrong(f"bbox {brief(box)}", "four numbers: left, top, width, height") from None
    score = row.values.get("score")
    try:
        score = None if score is None else float(score)
    except (TypeError, ValueError, OverflowError):
        raise row.wrong(f"score {brief(score)}", "a number") from None
    if not (category is None or isinstance(category, int | str)):
        raise row.wrong(f"category_id {brief(category)}", "a number")
    name = None if category is None else categories.get(str(category), str(category))
    return row, frame, (left, top, left + width, top + height), score, name


FORMS: tuple[tuple[str, Callable[[Path, Pictures], Detections]], ...] = (
    (r"\s*[\[{]", read_coco),
    (r"(?i).*frame", read_csv),
    (r"\s*[-+.0-9]", read_mot),
)
"""How the first line of a file begins (a regular expression, the first that fits), and what reads it then."""

EXPECTED = "MOT's det.txt, CSV with a header, or COCO's JSON"


def _table(
    path: Path, boxes: Iterable[FileBox], looked: frozenset[int] | None = None, classes: Iterable[str] = ()
) -> Detections:
    """Gather boxes in any order, sorted by frame; equal ones of a frame are one.

    `looked` are the frames on which the detector ran (default: as `frames_looked_at` tells), `classes` names
    that are known without a box. What is out of range is a ValueError that names the place.
    """
    frame, place, index = array("q"), array("q"), array("i")
    xyxy, confidence = array("d"), array("d")
    names = {name: number for number, name in enumerate(dict.fromkeys(classes))}
    unit = ""
    for row, number, edges, score, name in boxes:
        left, top, right, bottom = edges
        if not (right > left and bottom > top):
            raise row.wrong(f"a box of {right - left:g} x {bottom - top:g} px", "a width and height above 0")
        if not (min(left, top) >= -MAX_COORDINATE and max(right, bottom) <= MAX_COORDINATE):
            raise row.wrong(f"a box at {left:g}, {top:g}", f"px up to {MAX_COORDINATE:g}")
        if score is not None and not abs(score) <= LARGEST_SCORE:
            raise row.wrong(f"a score of {score:g}", f"one up to {LARGEST_SCORE:g}")
        unit = row.unit
        frame.append(number)
        place.append(row.place)
        xyxy.extend(edges)
        if score is not None:
            confidence.append(score)
        if name is not None:
            index.append(names.setdefault(name, len(names)))
        if not {len(confidence), len(index)} <= {0, len(frame)}:
            raise row.wrong("scores or classes for some boxes only", "them for each or for none")
    frames, edges_of = np.array(frame, np.int64), np.array(xyxy, np.float64).reshape(-1, 4)
    columns = [frames, *edges_of.T, *([confidence] if confidence else []), *([index] if index else [])]
    first = np.sort(np.unique(np.column_stack(columns), axis=0, return_index=True)[1])
    order = first[np.argsort(frames[first], kind="stable")]
    return Detections(
        path,
        frames[order],
        edges_of[order],
        np.array(confidence, np.float64)[order] if confidence else None,
        np.array(index, np.int32)[order] if index or not frame else None,
        np.array(list(names), np.str_),
        np.array(place, np.int64)[order],
        unit,
        frames_looked_at(frames) if looked is None else looked,
    )


def frames_looked_at(numbers: NDArray[np.int64]) -> range | frozenset[int]:
    """The frames on which a detector ran, given numbers `(n,)` of those in which it found something.

    A file of boxes does not say where the detector ran and found nothing. It is taken to have run on every
    n-th frame from the first to the last that are listed, n being the least distance of two of them. Where
    that does not meet all of them, it ran irregularly, and on those that are listed. So a frame is taken for
    empty only between frames in which something was found at the same regular distance.
    """
    listed = np.unique(numbers)
    if len(listed) < 2:
        return frozenset(listed.tolist())
    steps = np.diff(listed)
    stride = int(steps.min())
    if (steps % stride).any():
        return frozenset(listed.tolist())
    return range(int(listed[0]), int(listed[-1]) + 1, stride)


@checked
def with_boxes(frames: Iterable[Frame], detector: Callable[[Frame], Any], every: int = 1) -> Iterator[Frame]:
    """Yield frames with the boxes of a detector.

    Parameters
    ----------
    frames
        in order, as from `open_source`; one without an image gets no boxes.
    detector
        function of a frame. It returns an argument of `GivenBoxes.of` (`supervision.Detections`, an array
        `(n, 4)` to `(n, 6)`), or `None` if it did not run. `Detections` of a file are such a detector.
    every
        it is called for the first of every so many frames with an image.

    Raises
    ------
    ValueError
        if `every` is below 1; or naming the frame, if what the detector returns are no boxes.
    TypeError
        if the detector cannot be called, or what comes are no frames.
    """
    return attach_detections(
        frames, detector, every, lambda frame, boxes: replace(frame, boxes=GivenBoxes.of(boxes))
    )


def attach_detections(
    frames: Iterable[Frame],
    detector: Callable[[Frame], Any],
    every: int,
    attach: Callable[[Frame, Any], Frame],
) -> Iterator[Frame]:
    """Frames with what a detector finds in them, which `attach` puts into each; as `with_boxes` otherwise."""
    if every < 1:
        raise ValueError(f"every: got {every}, expected 1 or more frames")

    def attached() -> Iterator[Frame]:
        count = 0
        for frame in frames:
            if not isinstance(frame, Frame):
                raise TypeError(
                    f"frames: got {type(frame).__name__}, expected Frame, as open_source gives them"
                )
            detections = None
            if frame.image is not None:
                detections = detector(frame) if count % every == 0 else None
                count += 1
            try:
                with_it = frame if detections is None else attach(frame, detections)
            except ValueError as error:
                raise ValueError(f"frame {frame.number}: {error}") from None
            yield with_it

    return attached()


def given_boxes(
    path: Path | None, classes: Sequence[str], source: Source, start: int, stop: int | None, step: int
) -> Detections | None:
    """Read what a detector has found in an opened source, if that is given, and check that it belongs to it.

    Parameters
    ----------
    path, classes
        as of `read_detections`; without a path there is nothing.
    start, stop, step
        which of the source's frames are taken.

    Raises
    ------
    ValueError
        if the source is live, or they are of frames or places that it does not have.
    """
    if path is None:
        return None
    check_not_live(source, "--detections")
    found = read_detections(path, classes, film=source.name, pictures=source.pictures)
    found.check(source.name, source.size, last_frame(source, start, stop, step))
    return found


def check_not_live(source: Source, option: str) -> None:
    """Make sure that a source could be looked at before; ValueError, naming the option, if it is live."""
    if source.live:
        raise ValueError(f"{option}: {source.name} is live, so nobody has seen its frames before")


def last_frame(source: Source, start: int, stop: int | None, step: int) -> int | None:
    """Number of the last frame of a source of which some are taken; `None` if that is not known."""
    if source.n_frames is None or not source.counted:
        return None
    last = start + source.n_frames * step - 1
    return None if stop is not None and stop <= last else last  # the film may go on behind it

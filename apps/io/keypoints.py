"""Points that a detector has found of persons in a film: in files, or by a callable as frames come."""

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from reprlib import repr as brief
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.core.frame import COCO, KEYPOINTS, KNOWN, POINTS, SKELETONS, Frame, GivenKeypoints
from ...models.core.short_repr import short_repr
from .detections import attach_detections, check_not_live, last_frame
from .point_files import MAX_COORDINATE
from .sources.open_source import Source
from .tables import Column, Pictures, Row, csv_rows, digest, first_line, json_rows, read_json, rows_of_frame

Array = NDArray[np.float64]

COLUMNS = {
    "frame": Column(("frame", "frame_number"), "frame"),
    "person": Column(("person", "person_id", "track_id"), "text"),
    "joint": Column(("joint", "keypoint", "landmark", "name"), "text"),
    "x": Column(("x",), empty=True),
    "y": Column(("y",), empty=True),
    "score": Column(("score", "confidence", "conf", "visibility"), empty=True),
}
NEEDED = (("frame", "joint", "x", "y"),)

FORMS = "CSV with a header, COCO's JSON of results, or the folder of OpenPose's JSON"

ENDING = "_keypoints.json"
"""How the names of OpenPose's files end."""

BODIES = (25, 18)
"""Numbers of points of its bodies: BODY_25, and COCO with a neck."""

HAND_POINTS = 21

NORMALISED = 2.0
"""px: no film is so small; places that are all below it are shares of the picture."""


@short_repr
@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of a video from a file, sorted by frame; calling it with a frame returns those of that frame.

    Parameters
    ----------
    path
        of the file, or of the folder.
    frame
        `(n,)` int64 of n persons: numbers of frames, 1-based, ascending.
    given
        points of all n.
    place
        `(n,)`: position of each in the file, for messages.
    """

    path: Path
    frame: NDArray[np.int64]
    given: GivenKeypoints
    place: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> GivenKeypoints | None:
        """The persons of frame `number`; `None` if the detector did not run, or found nobody."""
        rows = rows_of_frame(self.frame, number)
        if rows.start == rows.stop:
            return None
        return GivenKeypoints(self.given.positions[rows], self.given.scores[rows])

    def __call__(self, frame: Frame) -> GivenKeypoints | None:
        """The persons of a frame, by its number."""
        return self.at(frame.number)

    def frames(self) -> Iterator[tuple[int, GivenKeypoints]]:
        """Numbers of the frames with persons, and these persons."""
        for number in np.unique(self.frame).tolist():
            given = self.at(number)
            assert given is not None
            yield number, given

    def counted(self, numbers: Collection[int]) -> dict[str, int]:
        """Number of persons in the frames of these numbers, and number of frames with persons."""
        taken = self.frame[np.isin(self.frame, list(numbers))]
        return {"persons": len(taken), "frames": len(np.unique(taken))}

    def check(self, film: str, size: tuple[int, int], last: int | None) -> None:
        """Check that the points fit a video with this name, `(width, height)` px and last frame.

        Raises
        ------
        ValueError
            if a frame comes after the last one, or a person is outside the image.
        """
        if last is not None and len(self) and self.frame[-1] > last:
            first = int(np.searchsorted(self.frame, last + 1))
            raise ValueError(
                f"{self.path}, {self.place[first]}: got frame {self.frame[first]}, "
                f"but {film} has {last} frames"
            )
        places = self.given.positions
        if np.nanmax(np.abs(places), initial=0.0) < NORMALISED < max(size):
            raise ValueError(f"{self.path}: got places from 0 to 1, expected px")
        beyond = np.maximum(-0.5 - places, places - (np.array(size) - 0.5)).max(axis=2)  # NaN: not found
        outside = np.flatnonzero(~(beyond <= 0).any(axis=1))
        if outside.size:
            who = int(outside[0])
            raise ValueError(
                f"{self.path}, {self.place[who]}: got a person in frame {self.frame[who]} of whom nothing "
                f"is in the picture of {size[0]}x{size[1]} px"
            )


@checked
def read_keypoints(path: str | Path, *, film: str = "the film", pictures: Sequence[str] = ()) -> Keypoints:
    """Read keypoints of persons in a video; the format is recognised by the content.

    Parameters
    ----------
    path
        CSV with a header (`read_csv`), COCO's JSON of results (`read_coco`), or the folder of OpenPose's JSON
        (`read_openpose`).
    film, pictures
        name of the video, and names of its images in order.

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
    return digest(path, f"*{ENDING}")


def read_csv(path: Path) -> Keypoints:
    """Read points in CSV with a header that names the columns; frames count from 1, px from 0.

    Columns are frame, joint, x, y, and perhaps person and score. An empty place is a point not found.
    """
    persons = _Persons(path)
    for row in csv_rows(path, COLUMNS, NEEDED, "frame, joint, x, y, and perhaps person and score"):
        values = row.values
        frame, joint = int(values["frame"]), values["joint"].lower().replace(" ", "_")
        if joint not in KNOWN:
            raise row.wrong(f"joint {values['joint'][:40]!r}", f"one of {', '.join(KEYPOINTS)}")
        points = persons.of(row, frame, values.get("person"))
        place = {name: values.get(name, 1.0) for name in ("x", "y", "score")}
        if math.isnan(place["x"]) and math.isnan(place["y"]):
            continue
        for name, number in place.items():
            if math.isnan(number):
                raise row.wrong(f"{name} ''", "a number")
        if joint in POINTS and not math.isnan(points[POINTS.index(joint), 0]):
            raise row.wrong(f"{joint} of frame {frame} a second time", "once, or a column person")
        _write(row, points, joint, *place.values())
    return persons.table()


def read_coco(path: Path, film: str, pictures: Sequence[str]) -> Keypoints:
    """Read a list of COCO's results; `keypoints` are x, y (px from 0) and score of 17 points.

    `image_id` is the number of a frame, or names a picture; each result is a person.
    """
    persons, known = _Persons(path), Pictures(film, pictures)
    expected = "keypoints in COCO's form: a list of image_id, keypoints, score"
    for row in json_rows(path, "result", read_json(path, expected), ("image_id", "keypoints"), expected):
        points = persons.of(row, known.frame(row, row.values["image_id"]), row.place)
        triples = _triples(row, row.values["keypoints"], len(COCO))
        for name, (x, y, score) in zip(COCO, triples, strict=True):
            _write(row, points, name, x, y, score)
    return persons.table()


def read_openpose(folder: Path, film: str, pictures: Sequence[str]) -> Keypoints:
    """Read OpenPose's `NAME_keypoints.json` of every frame; px count from 0.

    Of films, OpenPose numbers frames from 0, with the last number in the name; of a folder of pictures, NAME
    is that of the picture. Bodies have 25 or 18 points. Where hands were found as well (21 points), their
    centre is the mean of those.
    """
    persons, known = _Persons(folder), Pictures(film, pictures)
    stems = {Path(name).stem: name for name in pictures}
    paths = sorted(path for path in folder.iterdir() if path.name.endswith(ENDING))
    if not paths:
        raise ValueError(f"{folder}: got no file NAME{ENDING}, expected the folder of OpenPose's results")
    for number, path in enumerate(paths, start=1):
        name = path.name.removesuffix(ENDING)
        if pictures:
            frame = known.frame(Row(folder, "file", number, {}), stems.get(name, name))
        else:
            digits = name.rpartition("_")[2]
            if not (digits.isdecimal() and digits.isascii() and len(digits) <= 12):
                raise ValueError(
                    f"{folder}, {path.name}: got a name without a number, expected such as "
                    f"film_000000000012{ENDING}"
                )
            frame = int(digits) + 1
        for who, person in enumerate(_people(path), start=1):
            row = Row(folder, f"{path.name}, person", who, {})
            _take_person(row, person, persons, frame)
    return persons.table()


def _people(path: Path) -> list[Any]:
    """The people of a frame, in a file of OpenPose."""
    expected = "the JSON of OpenPose: version and people"
    content = read_json(path, expected)
    people = content.get("people") if isinstance(content, dict) else None
    if not isinstance(people, list):
        raise ValueError(f"{path}: got {brief(content)}, expected {expected}")
    return people


def _take_person(row: Row, person: Any, persons: "_Persons", frame: int) -> None:
    """Add the points of a person of OpenPose."""
    if not isinstance(person, Mapping) or not isinstance(person.get("pose_keypoints_2d"), list):
        raise row.wrong(brief(person), "an object with pose_keypoints_2d")
    points, body = persons.of(row, frame, row.place), person["pose_keypoints_2d"]
    n_points = next((count for count in BODIES if len(body) == 3 * count), BODIES[0])
    for name, (x, y, score) in zip(SKELETONS[n_points], _triples(row, body, n_points), strict=True):
        _write(row, points, name, x, y, score)
    for side in ("left", "right"):
        hand = person.get(f"hand_{side}_keypoints_2d")
        if hand:
            found = np.array(_triples(row, hand, HAND_POINTS))
            found = found[found[:, 2] > 0]
            if len(found):
                _write(row, points, f"{side}_hand", *found.mean(axis=0).tolist())


def _triples(row: Row, values: object, n_points: int) -> list[tuple[float, float, float]]:
    """x, y and score of points that stand in a row."""
    if not isinstance(values, list) or len(values) != 3 * n_points:
        got = f"{len(values)} numbers" if isinstance(values, list) else brief(values)
        raise row.wrong(got, f"x, y and score of {n_points} points")
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError, OverflowError):
        raise row.wrong(brief(values), "numbers") from None
    return list(zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True))


def _write(row: Row, points: Array, name: str, x: float, y: float, score: float) -> None:
    """Write a point of a person into its `points`, if it is one of `POINTS`."""
    if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE):
        raise row.wrong(f"{name} at {x:g}, {y:g}", f"px up to {MAX_COORDINATE:g}")
    if not abs(score) < np.inf:
        raise row.wrong(f"a score of {score:g}", "a finite one")
    if name in POINTS:
        points[POINTS.index(name)] = x, y, score


@dataclass(eq=False)
class _Persons:
    """Persons of a file, gathered point by point."""

    path: Path
    _rows: dict[tuple[int, Hashable], int] = field(default_factory=dict)
    _points: list[Array] = field(default_factory=list)
    _places: list[str] = field(default_factory=list)

    def of(self, row: Row, frame: int, person: Hashable) -> Array:
        """`(15, 3)`: x, y and score of the `POINTS` of somebody in a frame, to be written; NaN so far."""
        number = self._rows.setdefault((frame, person), len(self._points))
        if number == len(self._points):
            self._points.append(np.full((len(POINTS), 3), np.nan))
            self._places.append(f"{row.unit} {row.place}")
        return self._points[number]

    def table(self) -> Keypoints:
        """All of it, sorted by frame; of whom nothing was found that counts, nothing is kept."""
        points = np.array(self._points, np.float64).reshape(-1, len(POINTS), 3)
        given = GivenKeypoints.named(points)
        frame = np.array([number for number, _ in self._rows], np.int64)
        order = np.argsort(frame, kind="stable")
        order = order[(given.scores[order] > 0).any(axis=1)]
        if not len(order):
            raise ValueError(f"{self.path}: holds no point of an upper body")
        kept = GivenKeypoints(given.positions[order], given.scores[order])
        return Keypoints(self.path, frame[order], kept, tuple(self._places[row] for row in order))


@checked
def with_keypoints(
    frames: Iterable[Frame], detector: Callable[[Frame], Any], every: int = 1
) -> Iterator[Frame]:
    """Yield frames with the keypoints of a detector of poses or hands.

    Parameters and errors are those of `with_boxes`, but the detector returns what `GivenKeypoints.of` takes;
    `Keypoints` of a file are such a detector.
    """
    return attach_detections(
        frames, detector, every, lambda frame, points: replace(frame, keypoints=GivenKeypoints.of(points))
    )


def given_keypoints(path: Path, source: Source, start: int, stop: int | None, step: int) -> Keypoints:
    """Read what a detector has found in an opened source, and check that it belongs to it.

    Raises
    ------
    ValueError
        if the source is live, or they are of frames or places that it does not have.
    """
    check_not_live(source, "--keypoints")
    found = read_keypoints(path, film=source.name, pictures=source.pictures)
    found.check(source.name, source.size, last_frame(source, start, stop, step))
    return found

"""Ground truth: boxes in MOT format, also as CVAT exports them, or CDnet's labelled masks."""

import io
import re
import zipfile
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...models.array_files import ARCHIVE, PACKED
from ...models.core.checks import checked
from ...models.core.short_repr import short_repr
from ...models.files import MOST_SETTINGS, MOST_TEXT, read_text
from .sources.images import images_among, read_grey
from .tables import Row, rows_of_frame
from .tracks import mot_rows, mot_rows_of

SHADOW, OUTSIDE, UNKNOWN, FOREGROUND = 50, 85, 170, 255
"""CDnet's labels of a pixel; 0 is background."""


class Kind(IntEnum):
    """What a true box holds."""

    PEDESTRIAN = 0
    VEHICLE = 1
    IGNORED = 2
    """Neither finding nor missing it counts (distractors, reflections, crowds, rows with flag 0)."""


CLASSES = {
    "pedestrian": Kind.PEDESTRIAN,
    "person on vehicle": Kind.PEDESTRIAN,
    "car": Kind.VEHICLE,
    "bicycle": Kind.VEHICLE,
    "motorbike": Kind.VEHICLE,
    "non motorized vehicle": Kind.VEHICLE,
    "static person": Kind.PEDESTRIAN,
    "distractor": Kind.IGNORED,
    "occluder": Kind.IGNORED,
    "occluder on the ground": Kind.IGNORED,
    "occluder full": Kind.IGNORED,
    "reflection": Kind.IGNORED,
}
"""MOT16's classes from 1 on, by CVAT's names of them; boxes of any other name count as pedestrians."""

IN_ARCHIVE = "expected CVAT's MOT 1.1, with gt/gt.txt"


@short_repr
@dataclass(frozen=True, eq=False)
class BoxTruth:
    """True boxes over time, sorted by frame and identity.

    Parameters
    ----------
    frame
        `(n,)` int, 1-based frame numbers.
    identity
        `(n,)` int.
    box
        `(n, 4)` float: x, y of the top-left corner (0-based pixels), width, height (px).
    kind
        `(n,)` int, values of `Kind`.
    """

    frame: NDArray[np.int64]
    identity: NDArray[np.int64]
    box: NDArray[np.float64]
    kind: NDArray[np.int64]

    def __contains__(self, number: int) -> bool:
        """Whether a frame is annotated."""
        return number in self.frames

    @property
    def frames(self) -> range:
        """The annotated frame numbers: all from the first to the last frame with a box."""
        return range(int(self.frame[0]), int(self.frame[-1]) + 1)

    def at(self, number: int) -> "BoxTruth":
        """Return the boxes of frame `number` (1-based), possibly none."""
        rows = rows_of_frame(self.frame, number)
        return BoxTruth(self.frame[rows], self.identity[rows], self.box[rows], self.kind[rows])


@short_repr
@dataclass(frozen=True, eq=False)
class MaskTruth:
    """CDnet's labelled masks, read on demand.

    Parameters
    ----------
    files
        file of the mask of each annotated frame (1-based), inside the temporal region of interest.
    region
        `(height, width)` bool, the region of interest; `None` for the whole image.
    """

    files: dict[int, Path]
    region: NDArray[np.bool_] | None

    def __contains__(self, number: int) -> bool:
        """Whether a frame is annotated."""
        return number in self.files

    @property
    def frames(self) -> list[int]:
        """The annotated frame numbers, ascending."""
        return sorted(self.files)

    def labels(self, number: int) -> NDArray[np.uint8]:
        """Read the labels of an annotated frame: `(height, width)` uint8 of 0, 50, 85, 170 and 255.

        85 is outside the region of interest.

        Raises
        ------
        KeyError
            if the frame is not annotated.
        ValueError
            if the file is no picture, or the region of interest has another size.
        """
        path = self.files[number]
        labels = _read_grey(path)
        if self.region is None:
            return labels
        if labels.shape != self.region.shape:
            raise ValueError(f"{path}: got {labels.shape} pixels, expected the ROI's {self.region.shape}")
        labels[~self.region] = OUTSIDE
        return labels


@checked
def read_ground_truth(path: str | Path) -> BoxTruth | MaskTruth:
    """Read ground truth.

    Parameters
    ----------
    path
        a MOT `gt.txt`; a folder with `gt/gt.txt` or `gt.txt`; a zip file of CVAT's "MOT 1.1", with
        `gt/gt.txt` and perhaps `gt/labels.txt`; or a CDnet folder with `groundtruth/`, and where they exist
        `ROI.bmp` and `temporalROI.txt`.

    Notes
    -----
    A mask belongs to the picture of its number in `input/`, if that is there: `gt000000.png` to
    `in000000.jpg`, whose frame is the first. Otherwise its number is the frame's.

    A MOT line is frame, identity, left, top, width, height, flag (0: ignore) and then, in MOT16 and later,
    class and visibility (nine columns), in MOT15 x, y, z (ten columns; all are pedestrians). Coordinates
    are 1-based pixels in the file, 0-based in what is returned. In CVAT's zip they are 0-based, and classes
    are lines of `labels.txt`: those with names of MOT16's classes are these.

    Raises
    ------
    FileNotFoundError
        if there is no such file, or the folder holds neither form.
    ValueError
        if the truth is empty or malformed; names the file and line.
    """
    path = Path(path)
    if path.is_dir():
        for name in ("gt/gt.txt", "gt.txt"):
            if (path / name).is_file():
                return _read_boxes(path / name)
        if (path / "groundtruth").is_dir():
            return _read_masks(path)
        raise FileNotFoundError(f"--ground-truth: {path} holds no gt/gt.txt, gt.txt or groundtruth folder")
    if not path.exists():
        raise FileNotFoundError(f"--ground-truth: no such file or folder: {path}")
    with path.open("rb") as file:
        archived = file.read(4) in ARCHIVE
    return _read_archive(path) if archived else _read_boxes(path)


def common_frames(truth: BoxTruth | MaskTruth, processed: range) -> Sequence[int]:
    """Return the frame numbers that are both annotated and processed; ValueError if there are none.

    Nothing grows with the numbers: true boxes and announced frames may be as many as files say.
    """
    annotated = truth.frames
    common: Sequence[int]
    if isinstance(annotated, range):
        common = processed[bisect_left(processed, annotated[0]) : bisect_right(processed, annotated[-1])]
    else:
        common = [number for number in annotated if number in processed]
    if not common:
        span = f"frames {processed[0]} to {processed[-1]}" if processed else "no frame"
        raise ValueError(
            f"--ground-truth: annotates frames {annotated[0]} to {annotated[-1]}, but {span} were processed"
        )
    return common


def _read_boxes(path: Path) -> BoxTruth:
    if path.stat().st_size > MOST_TEXT:
        raise ValueError(f"{path}: got more than {MOST_TEXT} bytes, expected MOT ground truth")
    return _boxes(str(path), mot_rows(path), 1, list(CLASSES.values()))


def _read_archive(path: Path) -> BoxTruth:
    """Boxes of a zip file as CVAT writes them."""
    found, boxes, labels = _unpacked(path)
    kinds = list(CLASSES.values())
    if labels is not None:
        kinds = [CLASSES.get(label.strip().lower(), Kind.PEDESTRIAN) for label in labels.splitlines()]
    name = f"{path}, {found}"
    return _boxes(name, mot_rows_of(io.StringIO(boxes), name), 0, kinds)


def _unpacked(path: Path) -> tuple[str, str, str | None]:
    """Name and text of the boxes in an archive, and its labels; none of more bytes than a text may have."""
    wrong = ""
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                members = {member.filename: member for member in archive.infolist()}
                found = next((name for name in ("gt/gt.txt", "gt.txt") if name in members), "")
                wrong = "" if found else f"members {', '.join(members)[:60]!r}"
                texts = []
                for name in filter(members.get, (found, found.replace("gt.txt", "labels.txt"))):
                    if members[name].compress_type not in PACKED or members[name].file_size > MOST_TEXT:
                        wrong = f"{name} of more than {MOST_TEXT} bytes, or packed in an unusual way"
                    else:
                        texts.append(archive.read(name).decode("utf-8-sig", "replace"))
        except Exception as error:  # broken bytes make zip raise almost anything
            wrong = f"a damaged file ({' '.join(str(error).split())[:80] or type(error).__name__})"
    if wrong:
        raise ValueError(f"{path}: got {wrong}, {IN_ARCHIVE}")
    return found, texts[0], texts[1] if len(texts) > 1 else None


def _boxes(
    path: str, lines: Iterable[tuple[Row, list[float]]], origin: int, kinds: Sequence[Kind]
) -> BoxTruth:
    """Boxes of lines in MOT format, whose first pixel is `origin`; `kinds` are of classes from 1 on."""
    rows: list[tuple[float, ...]] = []
    for row, numbers in lines:
        width, height = numbers[4:6]
        if min(width, height) <= 0:
            raise row.wrong(f"a box of {width:g} x {height:g} pixels", "a positive size")
        rows.append((*numbers[:6], _kind_of(numbers, kinds)))
    if not rows:
        raise ValueError(f"{path}: holds no boxes")
    table = np.array(rows)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    # Regions to ignore may share an identity.
    named = table[table[:, 6] != Kind.IGNORED]
    repeated = np.flatnonzero((np.diff(named[:, :2], axis=0) == 0).all(axis=1))
    if repeated.size:
        frame, identity = named[repeated[0], :2]
        raise ValueError(f"{path}: identity {identity:.0f} occurs twice in frame {frame:.0f}")
    box = table[:, 2:6]
    box[:, :2] -= origin
    return BoxTruth(
        table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), box, table[:, 6].astype(np.int64)
    )


def _kind_of(values: Sequence[float], kinds: Sequence[Kind]) -> Kind:
    """The kind of box that a line is of, by its class; `kinds` are of classes from 1 on."""
    if len(values) > 6 and values[6] == 0:
        return Kind.IGNORED
    # Ten columns are MOT15's, where the eighth is a coordinate and no class.
    if len(values) in (8, 9) and values[7] != -1:
        return kinds[int(values[7]) - 1] if 1 <= values[7] < len(kinds) + 1 else Kind.IGNORED
    return Kind.PEDESTRIAN


def _read_masks(folder: Path) -> MaskTruth:
    files = _by_number((folder / "groundtruth").iterdir(), "png|bmp")
    if not files:
        raise ValueError(f"{folder / 'groundtruth'}: holds no masks, expected gt000001.png and so on")
    temporal = folder / "temporalROI.txt"
    if temporal.exists():
        text = read_text(temporal, "expected the first and the last frame number", MOST_SETTINGS)
        try:
            first, last = (int(word) for word in text.split())
        except ValueError:
            raise ValueError(f"{temporal}, line 1: expected the first and the last frame number") from None
        files = {number: path for number, path in files.items() if first <= number <= last}
        if not files:
            raise ValueError(
                f"{folder / 'groundtruth'}: holds no mask of frames {first} to {last} ({temporal.name})"
            )
    pictures = images_among((folder / "input").iterdir()) if (folder / "input").is_dir() else []
    if frames := _by_number(pictures, r"\w+"):
        place = {path: number for number, path in enumerate(pictures, 1)}
        files = {place[frames[number]]: path for number, path in files.items() if number in frames}
        if not files:
            raise ValueError(f"{folder / 'groundtruth'}: holds no mask of a picture in input, by its number")
    region = folder / "ROI.bmp"
    return MaskTruth(files, _read_grey(region) > 0 if region.exists() else None)


def _by_number(paths: Iterable[Path], suffixes: str) -> dict[int, Path]:
    """Files by the number at the end of their names."""
    found = ((path, re.search(rf"(\d+)\.(?:{suffixes})$", path.name)) for path in paths)
    return {int(digits[1]): path for path, digits in found if digits}


def _read_grey(path: Path) -> NDArray[np.uint8]:
    picture = read_grey(path)
    if picture is None:
        raise ValueError(f"{path}: not a readable picture")
    return picture

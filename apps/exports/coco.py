"""Tracks as COCO JSON, with a mask of each object in COCO's compact form, and as XML of CVAT."""

import json
import math
import zipfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.files import write_atomically
from .finished_run import FinishedRun, RunFrame

CATEGORY = {"id": 1, "name": "object", "supercategory": ""}


@checked
def to_coco(run: str | Path, out: str | Path) -> str:
    """Write the tracks of a background run as COCO JSON: boxes, identities, masks.

    Images have the numbers of frames (from 1) as `id`, and the names of the source's files where it is a
    folder of pictures, else `000001.png` and so on. Annotations have `bbox` (x, y, width, height, px from 0),
    `track_id`, `score` (the tracker's confidence), `area` px, and as `segmentation` what of the foreground
    lies in the box, in compressed run lengths; without masks in the run it is empty. Memory does not grow
    with the run, and the file is written whole or not at all.

    Returns
    -------
    str
        what was written, in words.

    Raises
    ------
    ValueError
        if this is no background run, or its files are damaged.
    OSError
        if a file cannot be read or written.
    """
    finished = FinishedRun.of(run, "background")
    width, height = finished.size
    names = finished.picture_names
    images = (
        {
            "id": number,
            "file_name": names[number - 1] if number <= len(names) else f"{number:06d}.png",
            "width": width,
            "height": height,
        }
        for number in finished.numbers
    )
    counts = {"boxes": 0, "masks": 0}
    about = {"description": f"rsmcm background {finished.source}"}
    with write_atomically(Path(out)) as unfinished, unfinished.open("w", encoding="utf-8") as file:
        file.write(f'{{"info": {json.dumps(about)},\n"categories": {json.dumps([CATEGORY])},\n"images": [')
        file.writelines(_items(images))
        file.write('],\n"annotations": [')
        file.writelines(_items(_annotations(finished.frames(), counts)))
        file.write("]}\n")
    return f"{len(finished.numbers)} images, {counts['boxes']} boxes, {counts['masks']} masks"


def _items(items: Iterator[dict[str, Any]]) -> Iterator[str]:
    """Items of a list in JSON, a line each."""
    for place, item in enumerate(items):
        yield ("," if place else "") + "\n" + json.dumps(item)


def _annotations(frames: Iterator[RunFrame], counts: dict[str, int]) -> Iterator[dict[str, Any]]:
    for frame in frames:
        for track in frame.tracks:
            counts["boxes"] += 1
            annotation = {
                "id": counts["boxes"],
                "image_id": frame.number,
                "category_id": CATEGORY["id"],
                "track_id": track.identity,
                "bbox": list(track.box),
                "score": track.confidence,
                "iscrowd": 0,
            }
            if frame.foreground is None:
                yield annotation | {"area": track.box[2] * track.box[3], "segmentation": []}
                continue
            counts["masks"] += 1
            (mask,) = object_masks(frame.foreground, np.array([track.box]))  # of all at once, many GB
            rle = {"size": list(mask.shape), "counts": compressed(mask)}
            yield annotation | {"area": int(np.count_nonzero(mask)), "segmentation": rle}


FIRST = ord("0")
"""Of the characters of a compressed mask."""

BITS, GOES_ON, NEGATIVE = 5, 0x20, 0x10
"""Bits of a number in a character; the one that says that more follow; the sign of the last ones."""


def object_masks(foreground: NDArray[np.uint8], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the foreground `(height, width)`, 0 or 255, within each box `(n, 4)`: x, y, width, height px.

    Returns
    -------
    NDArray[np.bool_]
        `(n, height, width)`: pixels whose middle is in the box. A run stores one mask for all of its objects:
        where boxes overlap, a pixel is taken for both.
    """
    masks = np.zeros((len(boxes), *foreground.shape), bool)
    for mask, (x, y, width, height) in zip(masks, boxes.tolist(), strict=True):
        window = (_pixels(y, height, foreground.shape[0]), _pixels(x, width, foreground.shape[1]))
        mask[window] = foreground[window] > 0
    return masks


def _pixels(start: float, length: float, limit: int) -> slice:
    """Rows or columns of a picture whose middles lie between two edges."""
    first, end = (min(max(math.ceil(edge - 0.5), 0), limit) for edge in (start, start + length))
    return slice(first, end)


def compressed(mask: NDArray[np.bool_]) -> str:
    """Return a mask `(height, width)` as COCO's compressed run lengths, `counts` of its `segmentation`.

    Runs of pixels that are 0 and 1 by turns, column after column, beginning with 0; from the fourth on, each
    is written as the difference from the one before the last, in characters of 5 bits (`rleToString` of the
    COCO API, by P. Dollár and T.-Y. Lin).
    """
    pixels = mask.ravel(order="F")
    edges = np.flatnonzero(pixels[1:] != pixels[:-1]) + 1
    begins = [0] if len(pixels) and pixels[0] else []
    ends = [0, *begins, *edges.tolist(), len(pixels)]
    return _characters([end - start for start, end in pairwise(ends)])


def _characters(runs: Sequence[int]) -> str:
    text = []
    for place, run in enumerate(runs):
        value = run - runs[place - 2] if place > 2 else run
        while True:
            low, value = value & ((1 << BITS) - 1), value >> BITS
            done = value == (-1 if low & NEGATIVE else 0)
            text.append(chr(FIRST + (low if done else low | GOES_ON)))
            if done:
                break
    return "".join(text)


LABEL = "object"
"""The label of all boxes; the task in CVAT needs one of this name."""


@checked
def to_cvat(run: str | Path, out: str | Path) -> str:
    """Write the tracks of a background run as CVAT's MOT 1.1: `gt/gt.txt` and `gt/labels.txt` in a zip file.

    A line is frame (from 1), identity, x, y, width, height (px; from 0, as CVAT has them, unlike MOT), 1 (not
    ignored), 1 (the first label), and visibility: 1, or 0 where the object is only predicted, which CVAT
    shows as occluded. `rsmcm background --ground-truth` reads the file back, and what was corrected in CVAT
    and exported from there. Result and errors as of `to_coco`.
    """
    finished = FinishedRun.of(run, "background")
    boxes, identities = 0, set()
    with write_atomically(Path(out)) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
        with archive.open(_member("gt/gt.txt"), "w", force_zip64=True) as file:
            for frame in finished.frames(masks=False):
                for track in frame.tracks:
                    box = ",".join(f"{value:.2f}" for value in track.box)
                    file.write(f"{frame.number},{track.identity},{box},1,1,{track.seen:d}\n".encode())
                    boxes += 1
                    identities.add(track.identity)
        archive.writestr(_member("gt/labels.txt"), f"{LABEL}\n")
    return f"{boxes} boxes of {len(identities)} objects"


def _member(name: str) -> zipfile.ZipInfo:
    """A member to write, compressed, without a date: equal tracks make equal files."""
    member = zipfile.ZipInfo(name)
    member.compress_type = zipfile.ZIP_DEFLATED
    return member

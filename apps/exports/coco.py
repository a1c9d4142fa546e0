"""Tracks and masks as COCO JSON."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...models.files.atomic_files import write_atomically
from .finished_run import FinishedRun, RunFrame
from .object_masks import compressed, object_masks

CATEGORY = {"id": 1, "name": "object", "supercategory": ""}


def to_coco(run: str | Path, out: str | Path) -> str:
    """Write the tracks of a background run as COCO JSON: boxes, identities, masks.

    Images have the numbers of frames (from 1) as `id`, and the names of the source's files where it is a
    folder of pictures, else `000001.png` and so on. Annotations have `bbox` (x, y, width, height, px from 0),
    `track_id`, `score` (the tracker's confidence), `area` px, and as `segmentation` what of the foreground
    lies in the box, in compressed run lengths; without masks in the run it is empty.

    Parameters
    ----------
    run
        folder of the run.
    out
        JSON to write, whole or not at all, in memory that does not grow with the run.

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

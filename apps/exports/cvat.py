"""Tracks as CVAT takes them, its "MOT 1.1": a zip file with boxes and labels."""

import zipfile
from pathlib import Path

from ...models.files import write_atomically
from ..io.tracks import box_columns
from .finished_run import FinishedRun

LABEL = "object"
"""The label of all boxes; the task in CVAT needs one of this name."""


def to_cvat(run: str | Path, out: str | Path) -> str:
    """Write the tracks of a background run as CVAT's MOT 1.1: `gt/gt.txt` and `gt/labels.txt` in a zip file.

    A line is frame (from 1), identity, x, y, width, height (px; from 0, as CVAT has them, unlike MOT), 1 (not
    ignored), 1 (the first label), and visibility: 1, or 0 where the object is only predicted, which CVAT
    shows as occluded. `rsmcm background --ground-truth` reads the file back, and what was corrected in CVAT
    and exported from there.

    Parameters
    ----------
    run
        folder of the run.
    out
        zip file to write, whole or not at all.

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
    boxes, identities = 0, set()
    with write_atomically(Path(out)) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
        with archive.open(_member("gt/gt.txt"), "w", force_zip64=True) as file:
            for frame in finished.frames(masks=False):
                for track in frame.tracks:
                    line = f"{frame.number},{track.identity},{box_columns(track)},1,1,{track.seen:d}\n"
                    file.write(line.encode())
                    boxes += 1
                    identities.add(track.identity)
        archive.writestr(_member("gt/labels.txt"), f"{LABEL}\n")
    return f"{boxes} boxes of {len(identities)} objects"


def _member(name: str) -> zipfile.ZipInfo:
    """A member to write, compressed, without a date: equal tracks make equal files."""
    member = zipfile.ZipInfo(name)
    member.compress_type = zipfile.ZIP_DEFLATED
    return member

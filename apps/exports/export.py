"""`rsmcm export`: the results of a finished run as a file that another tool takes."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, get_args

from .coco import to_coco, to_cvat
from .motchallenge import to_motchallenge
from .movement import to_movement
from .video import to_video

Format = Literal["coco", "cvat", "motchallenge", "movement", "video"]

EXPORTS: Mapping[Format, tuple[str, Callable[[Path, Path], str]]] = {
    "coco": (".json", to_coco),
    "cvat": (".zip", to_cvat),
    "motchallenge": ("", to_motchallenge),
    "movement": (".nc", to_movement),
    "video": (".mp4", to_video),
}
"""How the name of the file ends, if it is no folder, and what writes it."""


def run_export(run: Path, to: Format, out: Path, *, overwrite: bool = False) -> str:
    """Write the results of a run in the format of another tool; return in words what was written.

    Raises
    ------
    ValueError
        if the run holds nothing for that format, its files are damaged, `out` has another suffix, or a
        package is missing.
    OSError
        if a file cannot be read, or `out` is there without `overwrite` or cannot be written.
    """
    if to not in EXPORTS:
        raise ValueError(f"--to: got {to!r}, expected one of {', '.join(get_args(Format))}")
    suffix, export = EXPORTS[to]
    if suffix and out.suffix.lower() != suffix:
        raise ValueError(f"--out: got {out}, expected a name that ends with {suffix}")
    if out.exists() and not overwrite:
        raise FileExistsError(f"{out}: is there already: use --overwrite")
    try:
        return export(run, out)
    except ImportError as error:
        raise ValueError(f"--to {to}: {error}") from error

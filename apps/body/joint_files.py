"""Reader of CSV files of joints clicked in a few frames."""

import csv
import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...chains.body.start import ClickedJoints
from ...models.body.upper_body import JOINTS
from ...models.files import LAST_FRAME, MOST_SETTINGS, read_text
from ..io.point_files import MAX_COORDINATE

Array = NDArray[np.float64]

COLUMNS = ["frame", "joint", "x", "y"]


def read_joints(path: Path) -> ClickedJoints:
    """Read clicked joints.

    Parameters
    ----------
    path
        a CSV file with the columns frame (from 1), joint (a name of `JOINTS`; left is the person's own), x
        and y (px from 0, at the centres of pixels), one joint a line, under a line with these names.

    Raises
    ------
    ValueError
        naming file and line, if it is no such file, or a joint is there twice in a frame.
    OSError
        if the file cannot be read.
    """
    clicked: dict[int, Array] = {}
    expected = f"expected a CSV file {','.join(COLUMNS)}"
    lines = csv.reader(io.StringIO(read_text(path, expected, MOST_SETTINGS), newline=""))
    try:
        header = [name.strip().lower() for name in next(lines, [])]
        if header != COLUMNS:
            raise ValueError(f"got the columns {','.join(header)[:60]!r}, {expected}")
        for line in lines:
            if any(cell.strip() for cell in line):
                _take(clicked, [cell.strip() for cell in line])
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}, line {lines.line_num}: {error}") from None
    if not clicked:
        raise ValueError(f"{path}: holds no joint, expected some of {', '.join(JOINTS)}")
    frames = sorted(clicked)
    return ClickedJoints(path, np.array(frames, np.int64), np.stack([clicked[frame] for frame in frames]))


def _take(clicked: dict[int, Array], cells: list[str]) -> None:
    """Add the joint of a line to its frame."""
    expected = f"expected {','.join(COLUMNS)}"
    if len(cells) != len(COLUMNS):
        raise ValueError(f"got {len(cells)} values, {expected}")
    frame, joint, x, y = cells
    if joint not in JOINTS:
        raise ValueError(f"got the joint {joint[:60]!r}, expected one of {', '.join(JOINTS)}")
    if not (re.fullmatch("[0-9]{1,10}", frame) and 1 <= int(frame) <= LAST_FRAME):
        raise ValueError(f"got the frame {frame[:60]!r}, expected a number from 1 to {LAST_FRAME}")
    try:
        place = float(x), float(y)
    except ValueError:
        raise ValueError(f"got the place {x[:60]!r}, {y[:60]!r}, expected numbers of px") from None
    if not (np.abs(place) <= MAX_COORDINATE).all():
        raise ValueError(f"got the place {x[:60]}, {y[:60]}, expected finite px up to {MAX_COORDINATE:g}")
    places = clicked.setdefault(int(frame), np.full((len(JOINTS), 2), np.nan))
    if not np.isnan(places[JOINTS.index(joint), 0]):
        raise ValueError(f"got {joint} of frame {frame} a second time, expected it once")
    places[JOINTS.index(joint)] = place

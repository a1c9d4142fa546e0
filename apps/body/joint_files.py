"""Reader of CSV files of joints clicked in a few frames."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...chains.body.start import ClickedJoints
from ...models.body.upper_body import JOINTS
from ..io.point_files import MAX_COORDINATE
from ..io.tables import Column, csv_rows

COLUMNS = {
    "frame": Column(("frame",), "frame"),
    "joint": Column(("joint",), "text"),
    "x": Column(("x",)),
    "y": Column(("y",)),
}


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
    clicked: dict[int, NDArray[np.float64]] = {}
    for row in csv_rows(path, COLUMNS, (COLUMNS,), ", ".join(COLUMNS)):
        frame, joint, *place = (row.values[name] for name in COLUMNS)
        if joint not in JOINTS:
            raise row.wrong(f"the joint {joint[:60]!r}", f"one of {', '.join(JOINTS)}")
        if np.abs(place).max() > MAX_COORDINATE:
            raise row.wrong(f"{joint} at {place[0]:g}, {place[1]:g}", f"px up to {MAX_COORDINATE:g}")
        places = clicked.setdefault(int(frame), np.full((len(JOINTS), 2), np.nan))
        if not np.isnan(places[JOINTS.index(joint), 0]):
            raise row.wrong(f"{joint} of frame {frame:g} a second time", "it once")
        places[JOINTS.index(joint)] = place
    if not clicked:
        raise ValueError(f"{path}: holds no joint, expected some of {', '.join(JOINTS)}")
    frames = sorted(clicked)
    return ClickedJoints(path, np.array(frames, np.int64), np.stack([clicked[frame] for frame in frames]))

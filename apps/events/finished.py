"""Events of a run that is finished, from its tracks: zones can be changed without another run."""

import errno
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...models.files import read_text, write_text
from ..drawing.overlay import draw_zones
from ..exports.track_table import TABLE, read_tracks_table
from ..io.files import write_json
from ..runs.output_folder import output_folder
from ..view.page import Page, Section, picture, write_page
from .report import Happened
from .watch import COLUMNS, EVENTS, Event, Watch, line_of, read_events, sightings_of
from .zones import read_zones

PAGE = "events.html"
SUMMARY = "summary.json"
BACKGROUND = "background.png"

LEAST = 960
"""px of the longer side of the picture with the zones."""


def run_events(run: Path, zones: Path) -> list[str]:
    """Write `events.csv` and `events.html` of a finished run of `rsmcm background`, and its summary's counts.

    Events are those that the run would have written itself. What an earlier call wrote is replaced.

    Parameters
    ----------
    run
        folder of its results.
    zones
        as of `read_zones`.

    Returns
    -------
    list of str
        a line for each zone and line.

    Raises
    ------
    ValueError
        if the folder holds no such run, or zones are none of its picture.
    OSError
        if there is no such folder or file, or it cannot be written.
    """
    if not run.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected the folder of a finished run", str(run))
    for name in (TABLE, SUMMARY):
        if not (run / name).exists():
            raise ValueError(f"{run}: holds no {name}; it is written by: rsmcm background")
    summary = _read_summary(run / SUMMARY)
    watched = read_zones(zones, (summary["size"][0], summary["size"][1]))
    tracks = read_tracks_table(run)
    watch, found = Watch(watched), list[Event]()
    for time, number, sightings in sightings_of(tracks):
        found += watch.take_in(time, number, sightings)
    found += watch.end(summary["last_frame"])
    first, last = ((summary[name] - 1) / summary["rate"] for name in ("first_frame", "last_frame"))
    span = first, max([last, *tracks["time"][-1:].tolist()])
    with output_folder(run, "background", add=True) as folder:
        folder.add([EVENTS, PAGE])
        write_text(run / EVENTS, "\n".join([",".join(COLUMNS), *map(line_of, found), ""]))
        happened = Happened(watched, read_events(run / EVENTS), span)  # rounded, as the run itself has it
        title = f"{Path(summary['source']).name}: zones and lines"
        write_page(run / PAGE, Page(title, sections=_sections(run, happened)))
        write_json(run / SUMMARY, {**summary, "events": happened.counts()})
    return [*happened.in_words(), f"results: {run / EVENTS}, {run / PAGE}"]


def _read_summary(path: Path) -> dict[str, Any]:
    """What a finished run says of itself."""
    try:
        summary = json.loads(read_text(path, "expected the summary of a run"))
        width, height = summary["size"]
        numbers = [width, height, summary["rate"], summary["first_frame"], summary["last_frame"]]
        if not all(type(number) in (int, float) and number > 0 for number in numbers):
            raise TypeError
        if not isinstance(summary["source"], str):
            raise TypeError
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(f"{path}: got something else, expected the summary of rsmcm background") from None
    return dict(summary)


def _sections(run: Path, happened: Happened) -> list[Section]:
    background = cv2.imread(str(run / BACKGROUND)) if (run / BACKGROUND).exists() else None
    if background is None:
        return happened.sections()
    scale = max(1.0, LEAST / max(background.shape[:2]))
    drawn = np.asarray(
        cv2.resize(background, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8
    )
    draw_zones(drawn, happened.zones, scale)
    shown = picture(drawn, "Zones and lines on the background at the end.")
    return [("", [shown]), *happened.sections()]

"""Events of a run that is finished, from its tracks: zones can be changed without another run."""

from pathlib import Path

import cv2
import numpy as np

from ..drawing.overlay import draw_zones
from ..exports.finished_run import SUMMARY, FinishedRun, read_tracks_table
from ..io.files import write_json
from ..io.tracks import TABLE
from ..runs.output_folder import output_folder
from ..view.page import Page, Section, picture, write_page
from .page import Happened
from .watch import EVENTS, Event, Watch, rounded, sightings_of, write_events
from .zones import read_zones

PAGE = "events.html"
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
    if run.is_dir() and not (run / TABLE).exists():
        raise ValueError(f"{run}: holds no {TABLE}; it is written by: rsmcm background")
    finished = FinishedRun.of(run, "background")
    watched = read_zones(zones, finished.size)
    tracks, numbers = read_tracks_table(run), finished.numbers
    watch, found = Watch(watched), list[Event]()
    for time, number, sightings in sightings_of(tracks):
        found += watch.take_in(time, number, sightings)
    found += watch.end(numbers[-1])
    first, last = ((number - 1) / finished.source_rate for number in (numbers[0], numbers[-1]))
    span = first, max([last, *tracks["time"][-1:].tolist()])
    with output_folder(run, "background", add=True) as folder:
        folder.add([EVENTS, PAGE])
        write_events(run / EVENTS, found)
        happened = Happened(watched, list(map(rounded, found)), span)
        title = f"{Path(finished.source).name}: zones and lines"
        write_page(run / PAGE, Page(title, sections=_sections(run, happened)))
        write_json(run / SUMMARY, {**finished.summary, "events": happened.counts()})
    return [*happened.in_words(), f"results: {run / EVENTS}, {run / PAGE}"]


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

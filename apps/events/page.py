"""What a page and a summary say of events, and the page of a run that is finished (`rsmcm events`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup

from ..exports.finished_run import SUMMARY, FinishedRun, read_tracks_table
from ..io.files import write_json
from ..io.sources.images import read_image, to_8_bits
from ..io.tracks import TABLE
from ..io.zones import Line, Zones, read_zones
from ..runs.output_folder import output_folder
from ..view import page
from ..view.overlay import canvas_of, draw_zones
from ..view.page import BLUE, ORANGE, Page, Plot, Section, paragraph, picture, table, write_page
from .watch import EVENTS, Event, EventLog, Kind, rounded, write_events

MOST_ROWS = 100  # of a table
MOST_PLOTS = 12
IN_WORDS = {"mean_dwell": "mean dwell", "longest_dwell": "longest dwell"}
COMES = (Kind.ENTERED, Kind.APPEARED)
GOES = (Kind.LEFT, Kind.DISAPPEARED, Kind.REMAINED)


@dataclass(frozen=True, eq=False)
class ZoneEvents:
    """What happened to zones in a film: all events of it, and times of its first and last frame, s."""

    zones: Zones
    events: Sequence[Event]
    span: tuple[float, float]

    def counts(self) -> dict[str, Any]:
        """By zone, how often what happened and s of the mean and the longest stay; by line, its crossings.

        This is what `summary.json` has.
        """
        found: dict[str, Any] = {}
        for zone in self.zones.zones:
            stays = self._stays(zone.name)
            kinds = {
                kind.value: sum(each.kind == kind for each in self._of(zone.name))
                for kind in (*COMES, *GOES, Kind.STANDS)
            }
            dwell = {"mean_dwell": mean(stays), "longest_dwell": max(stays)} if stays else {}
            found[zone.name] = {**kinds, **dwell}
        for line in self.zones.lines:
            found[line.name] = self._crossings(line)
        return found

    def in_words(self) -> list[str]:
        """A line for each zone and line."""
        counts = self.counts()
        return [
            f"{name}: {', '.join(f'{IN_WORDS.get(key, key)} {_rounded(value)}' for key, value in of.items())}"
            for name, of in counts.items()
        ]

    def sections(self) -> list[Section]:
        """Of the page: curves over time, crossings, dwell times."""
        return [("Zones and lines", [*self._plots(), *self._tables()])]

    def _of(self, name: str) -> list[Event]:
        return [event for event in self.events if event.zone == name]

    def _stays(self, name: str) -> list[float]:
        return [event.duration or 0.0 for event in self._of(name) if event.kind in GOES]

    def _crossings(self, line: Line) -> dict[str, int]:
        directions = [event.direction for event in self._of(line.name)]
        return {name: directions.count(name) for name in (line.left_to_right, line.right_to_left)}

    def _plots(self) -> list[Plot]:
        """How many were in each zone, and how often each line had been crossed so far."""
        plots = []
        for zone in self.zones.zones[:MOST_PLOTS]:
            of = self._of(zone.name)
            steps = [(e.moment.time, 1) for e in of if e.kind in COMES]
            steps += [(e.moment.time, -1) for e in of if e.kind in (Kind.LEFT, Kind.DISAPPEARED)]
            plots.append(Plot(f"in {zone.name}", "", [self._counted(steps)]))
        for line in self.zones.lines[:MOST_PLOTS]:
            of = self._of(line.name)
            lines = [
                self._counted([(e.moment.time, 1) for e in of if e.direction == name], name, colour)
                for name, colour in ((line.left_to_right, BLUE), (line.right_to_left, ORANGE))
            ]
            plots.append(Plot(f"across {line.name}, so far", "", lines))
        return plots

    def _counted(self, steps: Sequence[tuple[float, int]], label: str = "", colour: str = BLUE) -> page.Line:
        """A count over time that changes by steps: times, s, and by how much."""
        ordered = np.array(sorted(steps), np.float64).reshape(-1, 2)
        times = np.concatenate([[self.span[0]], ordered[:, 0], [self.span[1]]])
        counts = np.concatenate([[0.0], np.cumsum(ordered[:, 1])])
        return page.Line(np.append(counts, counts[-1]), label, colour, x=times, style="steps")

    def _tables(self) -> list[Markup]:
        parts: list[Markup] = []
        if self.zones.zones:
            header = ("zone", *COMES, *GOES, Kind.STANDS, "mean dwell, s", "longest, s")
            counts, rows = self.counts(), []
            for zone in self.zones.zones:
                values = list(counts[zone.name].values())
                dwell = [round(value, 1) for value in values[6:]] or ["–", "–"]
                rows.append((zone.name, *values[:6], *dwell))
            parts.append(table(header, rows))
        if self.zones.lines:
            crossed = [
                (line.name, name, count)
                for line in self.zones.lines
                for name, count in self._crossings(line).items()
            ]
            parts.append(table(("line", "direction", "crossed"), crossed))
        stays = sorted(
            (e for e in self.events if e.kind in (*GOES, Kind.STOOD)), key=lambda e: -(e.duration or 0.0)
        )
        if not stays:
            return [*parts, paragraph("Nobody stayed in a zone or stood still.")]
        lasted = [
            (
                "stood still" if e.kind == Kind.STOOD else "stayed",
                e.zone or "in no zone",
                e.identity,
                round(e.moment.time - (e.duration or 0.0), 1),
                round(e.moment.time, 1),
                round(e.duration or 0.0, 1),
            )
            for e in stays[:MOST_ROWS]
        ]
        caption = f"The {MOST_ROWS} longest of {len(stays)}." if len(stays) > MOST_ROWS else ""
        names = ("", "zone", "identity", "from, s", "to, s", "for, s")
        return [*parts, table(names, lasted, caption)]


def _rounded(value: float) -> str:
    return f"{value:.1f} s" if isinstance(value, float) else str(value)


PAGE = "events.html"
BACKGROUND = "background.png"

LEAST = 960
"""px of the longer side of the picture with the zones."""


def run_events(run: Path, zones: Path) -> list[str]:
    """Write `events.csv` and `events.html` of a finished run of `rsmcm background`, and its summary's counts.

    Events are those that the run would have written itself. What an earlier call wrote is replaced.

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
    log = EventLog(watched)
    log.add_table(tracks)
    log.end(numbers[-1])
    first, last = ((number - 1) / finished.source_rate for number in (numbers[0], numbers[-1]))
    span = first, max([last, *tracks["time"][-1:].tolist()])
    with output_folder(run, "background", add=True) as folder:
        folder.add([EVENTS, PAGE])
        write_events(run / EVENTS, log.events)
        zone_events = ZoneEvents(watched, list(map(rounded, log.events)), span)
        title = f"{Path(finished.source).name}: zones and lines"
        write_page(run / PAGE, Page(title, sections=_sections(run, zone_events)))
        write_json(run / SUMMARY, {**finished.summary, "events": zone_events.counts()})
    return [*zone_events.in_words(), f"results: {run / EVENTS}, {run / PAGE}"]


def _sections(run: Path, zone_events: ZoneEvents) -> list[Section]:
    image = read_image(run / BACKGROUND) if (run / BACKGROUND).exists() else None
    if image is None:
        return zone_events.sections()
    background = canvas_of(to_8_bits(image))
    scale = max(1.0, LEAST / max(background.shape[:2]))
    drawn = np.asarray(
        cv2.resize(background, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8
    )
    draw_zones(drawn, zone_events.zones, scale)
    shown = picture(drawn, "Zones and lines on the background at the end.")
    return [("", [shown]), *zone_events.sections()]

"""Events from tracks: who enters and leaves zones, crosses lines, and stands still.

The point that counts is the foot, the middle of a box's lower edge. It is known up to an error,

    foot ~ N(middle of the lower edge, (ERROR^2 + MOTION t^3 / 3) height^2)

after t s in which it was not seen but predicted (white acceleration moves it meanwhile). Somebody at a signed
distance d from a border that is straight on this scale is inside with probability Phi(d / deviation). A side
is only believed when that is more than Phi(1) = 0.84 or less than Phi(-1) = 0.16, and stays until the other
one is: a foot within its own standard deviation of a border does not flicker. The crossing is dated back to
where the way last met the border. All this is in heights and seconds, and the same for any size of picture.
"""

import csv
import io
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked
from ...models.files import fitting, naming, write_text
from ..io.files import LineWriter
from ..io.row_log import RowLog
from ..io.zones import Line as Line
from ..io.zones import Zone as Zone
from ..io.zones import Zones as Zones
from ..io.zones import read_zones as read_zones

ERROR = 0.05
"""Heights: standard deviation of a foot that is seen, along either axis."""

MOTION = 0.4
"""Heights^2/s^3: of the white acceleration of somebody who is not seen, as of `BlobTracker.acceleration`."""

SLOWEST = 0.1
"""Heights/s: who is slower stands; people walk at 0.7 to 0.9."""

CLOCK = 1e-4
"""s: within it, times are the same."""


class Kind(StrEnum):
    """Kind of an event."""

    ENTERED = "entered"
    """A zone, over its border."""
    LEFT = "left"
    """A zone, over its border."""
    APPEARED = "appeared"
    """The track begins in a zone."""
    DISAPPEARED = "disappeared"
    """The track ends in a zone."""
    REMAINED = "remained"
    """The film ends, and it is in a zone."""
    CROSSED = "crossed"
    """A line."""
    STANDS = "stands"
    """It begins to stand still."""
    STOOD = "stood"
    """It ends to stand still, or the track ends."""


class Moment(NamedTuple):
    """Position of a foot at a time: s, number of the frame, px."""

    time: float
    frame: int
    x: float
    y: float


class Sighting(NamedTuple):
    """Object in a frame: identity, foot x and y and height (px), and whether it is visible."""

    identity: int
    x: float
    y: float
    height: float
    seen: bool


@dataclass(frozen=True)
class Event:
    """Event in a zone or at a line.

    Parameters
    ----------
    moment, kind
        time and position, and kind of the event.
    zone
        name of the zone or line; "" for standing outside of all zones.
    identity
        of the track.
    duration
        s: of the stay or the standing that ends; otherwise `None`.
    direction
        of a crossing; otherwise "".
    """

    moment: Moment
    kind: Kind
    zone: str
    identity: int
    duration: float | None = None
    direction: str = ""

    def __str__(self) -> str:
        """For instance "12.5 s: 4 left pavement after 9.3 s"."""
        words = [f"{self.moment.time:.1f} s: {self.identity}", self.kind, self.zone, self.direction]
        if self.duration is not None:
            words.append(f"after {self.duration:.1f} s")
        return " ".join(filter(None, words))


@dataclass
class Border:
    """On which side of a border a foot is: 1 or -1, 0 while that is not sure."""

    side: int = 0
    distance: float = math.nan
    met: Moment | None = None

    def update(self, distance: float, deviation: float, before: Moment, now: Moment) -> bool:
        """Go on with a signed distance and its standard deviation, px; whether the side has changed.

        `met` is then where the way from before last met the border; `None` if it never did.
        """
        if not math.isnan(self.distance) and (distance > 0) != (self.distance > 0):
            self.met = _between(before, now, self.distance, distance)
        self.distance = distance
        side = 1 if distance > deviation else -1 if distance < -deviation else self.side
        self.side, changed = side, side != self.side
        return changed


def _between(before: Moment, now: Moment, distance: float, later: float) -> Moment:
    """Where a way meets a border, given signed distances at its ends; the frame is that of the end."""
    share = distance / (distance - later)
    time, x, y = (a + share * (b - a) for a, b in zip(_where(before), _where(now), strict=True))
    return Moment(time, now.frame, x, y)


def _where(moment: Moment) -> tuple[float, float, float]:
    return moment.time, moment.x, moment.y


@dataclass
class Stillness:
    """Whether a foot stands still: within `seconds`, its places differ by no more than slow ways and errors.

    A straight way at speed v spreads the places of T s by (v T)^2 / 12 along it, errors by ERROR^2 along both
    axes. Somebody stands as long as there are times T s apart between which that is so.
    """

    seconds: float
    window: deque[tuple[Moment, float]] = field(default_factory=deque)
    since: Moment | None = None
    until: Moment | None = None

    def update(self, now: Moment, height: float) -> tuple[Moment, Moment] | None:
        """Go on with a foot that is seen; a standing that has ended, from when until when."""
        window = self.window
        window.append((now, height))
        while len(window) > 1 and window[1][0].time <= now.time - self.seconds + CLOCK:
            window.popleft()
        still = self._still() if window[0][0].time <= now.time - self.seconds + CLOCK else []
        if still:
            self.since, self.until = self.since or still[0], max(self.until or still[-1], still[-1])
        elif self.since is not None and self.until is not None and window[0][0].time > self.until.time:
            ended = self.since, self.until
            self.since = None
            return ended
        return None

    def _still(self) -> list[Moment]:
        """The moments of the window but those on the way there and away; none if it is not still."""
        feet = np.array([(moment.x, moment.y, height) for moment, height in self.window])
        x, y, height = feet.mean(axis=0).tolist()
        off = (feet[:, 0] - x) ** 2 + (feet[:, 1] - y) ** 2
        variance = height**2 * ((SLOWEST * self.seconds) ** 2 / 12 + 2 * ERROR**2)
        if off.mean() > variance:
            return []
        near = (off <= 4 * variance).tolist()
        return [moment for (moment, _), is_near in zip(self.window, near, strict=True) if is_near]


class _Track:
    """What is known of one track."""

    def __init__(self, identity: int, zones: Zones, first: Moment) -> None:
        self.identity = identity
        self.first = self.last = first
        self.seen = first.time
        self._zones = zones
        self._inside = [Border() for _ in zones.zones]
        self._entered = [first for _ in zones.zones]
        self._beside = [Border() for _ in zones.lines]
        self._stillness = Stillness(zones.still_after)
        self._stands_in: list[str] = []

    def update(self, now: Moment, height: float, seen: bool, inside: Sequence[float]) -> Iterator[Event]:
        """What happens on the way from where it was to where it is now, so far `inside` of each zone."""
        if seen:
            self.seen = now.time
        deviation = height * math.sqrt(ERROR**2 + MOTION * (now.time - self.seen) ** 3 / 3)
        place, before, self.last = (now.x, now.y), self.last, now
        for k, (zone, border) in enumerate(zip(self._zones.zones, self._inside, strict=True)):
            side = border.side
            if border.update(inside[k], deviation, before, now):
                when = border.met if side and border.met is not None else self.first
                if border.side > 0:
                    self._entered[k] = when
                    yield Event(when, Kind.ENTERED if side else Kind.APPEARED, zone.name, self.identity)
                elif side:
                    duration = when.time - self._entered[k].time
                    yield Event(when, Kind.LEFT, zone.name, self.identity, duration)
        for line, border in zip(self._zones.lines, self._beside, strict=True):
            side = border.side
            changed = border.update(line.distance(place), deviation, before, now)
            met = border.met if changed and side else None
            if met is not None and line.is_beside((met.x, met.y)):
                direction = line.left_to_right if border.side > 0 else line.right_to_left
                yield Event(met, Kind.CROSSED, line.name, self.identity, None, direction)
        if seen:
            yield from self._stands(now, height)

    def _stands(self, now: Moment, height: float) -> Iterator[Event]:
        stood = self._stillness.since is not None
        ended = self._stillness.update(now, height)
        if ended is not None:
            yield from self._stood(*ended)
        elif self._stillness.since is not None and not stood:
            zones = zip(self._zones.zones, self._inside, strict=True)
            self._stands_in = [zone.name for zone, border in zones if border.side > 0] or [""]
            for name in self._stands_in:
                yield Event(self._stillness.since, Kind.STANDS, name, self.identity)

    def _stood(self, since: Moment, until: Moment) -> Iterator[Event]:
        for name in self._stands_in:
            yield Event(until, Kind.STOOD, name, self.identity, until.time - since.time)

    def end(self, kind: Kind) -> Iterator[Event]:
        """What ends with the track, or with the film."""
        if self._stillness.since is not None and self._stillness.until is not None:
            yield from self._stood(self._stillness.since, self._stillness.until)
        for zone, border, entered in zip(self._zones.zones, self._inside, self._entered, strict=True):
            if border.side > 0:
                yield Event(self.last, kind, zone.name, self.identity, self.last.time - entered.time)


def _sighting(given: Any) -> Sighting:
    if not isinstance(given, Sighting):
        raise TypeError(f"sightings: got {given!r}, expected Sighting")
    if not (math.isfinite(given.x) and math.isfinite(given.y) and 0 < given.height < math.inf):
        raise ValueError(f"sightings: got {given}, expected finite numbers and a height above 0")
    return given


class Watch:
    """Detector of events in zones and at lines, frame by frame.

    Events are returned when they are certain: a disappearance after `Zones.max_coast_time`. Memory is
    proportional to the number of tracks at a time.
    """

    @checked
    def __init__(self, zones: Zones) -> None:
        self._zones = zones
        self._tracks: dict[int, _Track] = {}
        self._time = -math.inf

    @checked
    def update(self, time: float, number: int, sightings: Iterable[Sighting]) -> list[Event]:
        """Process the objects of a frame, and return new events; empty frames may be omitted."""
        if time < self._time:
            raise ValueError(f"time: got {time}, expected {self._time} s of the last frame or more")
        self._time, found = time, list[Event]()
        for track in self._by_age():
            if time - track.last.time > self._zones.max_coast_time + CLOCK:
                found += self._tracks.pop(track.identity).end(Kind.DISAPPEARED)
        there = sorted(_sighting(each) for each in sightings)
        places = np.array([(x, y) for _, x, y, _, _ in there], np.float64).reshape(-1, 2)
        zones = self._zones.zones
        inside = np.array([zone.distance(places) for zone in zones]).reshape(len(zones), len(there)).T
        for (identity, x, y, height, seen), distances in zip(there, inside.tolist(), strict=True):
            now = Moment(time, number, x, y)
            if identity not in self._tracks:
                self._tracks[identity] = _Track(identity, self._zones, now)
            found += self._tracks[identity].update(now, height, seen, distances)
        return found

    def end(self, last: int) -> list[Event]:
        """Return the events at the end of the video, with the number of its last frame."""
        found: list[Event] = []
        for track in self._by_age():
            kind: Kind = Kind.REMAINED if track.last.frame == last else Kind.DISAPPEARED
            found += track.end(kind)
        self._tracks.clear()
        return found

    def _by_age(self) -> list[_Track]:
        return sorted(self._tracks.values(), key=lambda track: (track.last.time, track.identity))


EVENTS = "events.csv"

COLUMNS = ("time", "frame", "event", "zone", "id", "x", "y", "duration", "direction")
"""s, from 1, kind, name of the zone or line, identity, foot in px, s or empty, direction or empty."""


class EventLog:
    """What happens to zones in a run, frame after frame: `events` so far.

    Of a run that goes on, what happened in the rows of its log is found again.
    """

    def __init__(self, zones: Zones, log: RowLog | None = None) -> None:
        self._watch = Watch(zones)
        self.events: list[Event] = []
        if log is not None:
            for row, objects in log.frames():
                self.add(int(row["number"]), float(row["time"]), objects)

    def add(self, number: int, time: float, objects: Mapping[str, NDArray[Any]]) -> list[Event]:
        """Go on with the objects of a frame, with the columns of `tracks.csv`, and return what happens."""
        names = ("id", "x", "y", "width", "height", "seen")
        rows = zip(*(objects[name].tolist() for name in names), strict=True) if objects else ()
        sightings = []
        for identity, *box, seen in rows:
            x, y, width, height = (round(value, 2) for value in box)  # as in `tracks.csv`
            sightings.append(Sighting(identity, x + width / 2, y + height, height, seen))
        found = self._watch.update(round(time, 6), number, sightings)
        self.events += found
        return found

    def add_table(self, table: Mapping[str, NDArray[Any]]) -> None:
        """Go on with all frames of `tracks.csv`, given its columns."""
        frames = table["frame"]
        edges = np.flatnonzero(np.diff(frames, prepend=-1, append=-1)).tolist() if len(frames) else []
        for start, stop in pairwise(edges):
            rows = {name: column[start:stop] for name, column in table.items()}
            self.add(int(frames[start]), float(table["time"][start]), rows)

    def end(self, last: int) -> None:
        """Go on with what ends with the last frame, by its number."""
        self.events += self._watch.end(last)


class EventWriter(LineWriter):
    """Writer of `events.csv`, with the columns of `COLUMNS`, in the order of detection."""

    def __init__(self, path: Path, events: Sequence[Event] = ()) -> None:
        super().__init__(path, [",".join(COLUMNS), *map(line_of, events)])

    def write(self, events: Sequence[Event]) -> None:
        """Append the events of a frame; readers of the file see them at once."""
        if events:
            self.append(map(line_of, events))
            with naming(self._path):
                self._file.flush()


def write_events(path: Path, events: Sequence[Event]) -> None:
    """Write `events.csv`, whole or not at all."""
    write_text(path, "\n".join([",".join(COLUMNS), *map(line_of, events), ""]))


def rounded(event: Event) -> Event:
    """An event as `read_events` gives it back."""
    time, frame, x, y = event.moment
    duration = None if event.duration is None else round(event.duration, 3)
    return replace(event, moment=Moment(round(time, 3), frame, round(x, 2), round(y, 2)), duration=duration)


def line_of(event: Event) -> str:
    """An event as a line of the file."""
    time, frame, x, y = event.moment
    written = io.StringIO()
    csv.writer(written, lineterminator="").writerow(
        (
            f"{time:.3f}",
            frame,
            event.kind,
            event.zone,
            event.identity,
            f"{x:.2f}",
            f"{y:.2f}",
            "" if event.duration is None else f"{event.duration:.3f}",
            event.direction,
        )
    )
    return written.getvalue()


@checked
def read_events(path: str | Path) -> list[Event]:
    """Read `events.csv`; a ValueError with file and line if it is not such a file."""
    path, found = Path(path), []
    with (
        fitting(path, "expected events of a run"),
        path.open(encoding="utf-8-sig", errors="replace", newline="") as file,
    ):
        rows = csv.reader(file)
        if tuple(next(rows, ())) != COLUMNS:
            raise ValueError(f"{path}: got another header, expected {','.join(COLUMNS)}")
        for row in rows:
            try:
                time, frame, kind, zone, identity, x, y, duration, direction = row
                moment = Moment(float(time), int(frame), float(x), float(y))
                lasted = float(duration) if duration else None
                found.append(Event(moment, Kind(kind), zone, int(identity), lasted, direction))
            except ValueError:
                got, where = ",".join(row)[:60], f"{path}, line {rows.line_num}"
                raise ValueError(f"{where}: got {got!r}, expected an event") from None
    return found

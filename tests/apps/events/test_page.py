"""Counts and the section of a page, on events that can be counted by hand."""

import re

import numpy as np
from rsmcm.apps.events import Event, Kind, Line, Moment, Zone, Zones
from rsmcm.apps.events.page import ZoneEvents
from rsmcm.apps.view.page import Plot

SQUARE = np.array([[10.0, 10], [90, 10], [90, 90], [10, 90]])
ZONES = Zones(
    (Zone("<hall>", SQUARE, (100, 100)), Zone("empty", SQUARE, (100, 100))),
    (Line("gate", (0.0, 0.0), (9.0, 9.0), "in", "out"),),
)


def event(time: float, kind: Kind, who: int, duration: float | None = None, direction: str = "") -> Event:
    zone = "gate" if kind == Kind.CROSSED else "<hall>"
    return Event(Moment(time, round(25 * time) + 1, 50.0, 50.0), kind, zone, who, duration, direction)


EVENTS = [
    event(1.0, Kind.ENTERED, 1),
    event(1.0, Kind.CROSSED, 1, direction="in"),
    event(2.0, Kind.APPEARED, 2),
    event(3.0, Kind.LEFT, 1, 2.0),
    event(3.5, Kind.CROSSED, 1, direction="out"),
    event(4.0, Kind.CROSSED, 3, direction="in"),
    event(4.0, Kind.STANDS, 2),
    event(8.0, Kind.STOOD, 2, 4.0),
    event(9.0, Kind.REMAINED, 2, 7.0),
]


def test_counts() -> None:
    counts = ZoneEvents(ZONES, EVENTS, (0.0, 10.0)).counts()
    nothing = dict.fromkeys(("entered", "appeared", "left", "disappeared", "remained", "stands"), 0)
    assert counts == {
        "<hall>": {
            **nothing, "entered": 1, "appeared": 1, "left": 1, "remained": 1, "stands": 1, "mean_dwell": 4.5,
            "longest_dwell": 7.0,
        },
        "empty": nothing,
        "gate": {"in": 2, "out": 1},
    }  # fmt: skip
    assert ZoneEvents(ZONES, EVENTS, (0.0, 10.0)).in_words()[2] == "gate: in 2, out 1"


def parts(happened: ZoneEvents) -> tuple[list[Plot], str]:
    """Plots, and everything else as text."""
    ((title, found),) = happened.sections()
    assert title == "Zones and lines"
    plots = [part for part in found if isinstance(part, Plot)]
    return plots, "".join(part for part in found if not isinstance(part, Plot))


def test_section() -> None:
    plots, text = parts(ZoneEvents(ZONES, EVENTS, (0.0, 10.0)))
    assert "<hall>" not in text, "names are escaped"
    for expected in ("&lt;hall&gt;", "stood still", "stayed", ">7<"):
        assert expected in text, expected
    rows = re.findall(r"<tr>(.*?)</tr>", text, re.DOTALL)
    crossed = [re.sub(r"<[^>]*>|\s+", " ", row).split() for row in rows if "gate" in row]
    assert crossed == [["gate", "in", "2"], ["gate", "out", "1"]]
    assert [plot.name for plot in plots] == ["in <hall>", "in empty", "across gate, so far"]
    (there,) = plots[0].lines
    assert there.x is not None
    assert list(zip(there.x.tolist(), there.values.tolist(), strict=True)) == [
        (0, 0), (1, 1), (2, 2), (3, 1), (10, 1),
    ]  # fmt: skip
    assert [(line.label, line.values[-1]) for line in plots[2].lines] == [("in", 2), ("out", 1)]

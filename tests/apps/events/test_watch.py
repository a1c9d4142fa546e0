"""What is true of events whatever the way: nobody leaves who is not in, and time and scale do not matter."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.events import (
    Event,
    EventWriter,
    Kind,
    Line,
    Sighting,
    Watch,
    Zone,
    Zones,
    read_events,
)
from rsmcm.apps.events.watch import COLUMNS, ERROR, EventLog, line_of, write_events
from rsmcm.apps.exports import read_tracks_table
from rsmcm.apps.io.row_log import RowLog
from rsmcm.apps.io.tracks import TrackedBox, columns_of

from ...support.tables import TrackTableWriter

SIZE = (320, 240)
HEIGHT = 40.0
STRIP = [[100, 0], [200, 0], [200, 240], [100, 240]]
DIAMOND = [[160, 40], [260, 120], [160, 200], [60, 120]]
IN, OUT = ("entered", "appeared"), ("left", "disappeared", "remained")
Way = NDArray[np.float64]


def zones(scale: float = 1.0) -> Zones:
    size = (round(SIZE[0] * scale), round(SIZE[1] * scale))
    made = [Zone(n, scale * np.array(c, float), size) for n, c in (("strip", STRIP), ("diamond", DIAMOND))]
    line = Line("line", (150 * scale, 0.0), (150 * scale, 240 * scale), size=size)
    return Zones(tuple(made), (line,))


def events(
    path: Way,
    rate: float = 25.0,
    there: Sequence[bool] | None = None,
    scale: float = 1.0,
    watched: Zones | None = None,
) -> list[Event]:
    """Of one track along feet `(n, 2)` px, in the frames in which it is there."""
    watch, found = Watch(watched or zones(scale)), []
    for index, (x, y) in enumerate(scale * path):
        if there is None or there[index]:
            found += watch.update(index / rate, index + 1, [Sighting(1, x, y, HEIGHT * scale, True)])
    return found + watch.end(len(path))


def kinds(found: Sequence[Event]) -> list[tuple[str, str]]:
    return [(event.kind, event.zone) for event in found]


@st.composite
def ways(draw: st.DrawFn, least: int = 2, jitter: float = 2.0) -> Way:
    """Feet on straight ways between some places, with pauses there and errors."""
    place = st.tuples(st.floats(0, SIZE[0]), st.floats(0, SIZE[1]))
    places = np.array(draw(st.lists(place, min_size=least, max_size=6)))
    steps = draw(st.lists(st.integers(1, 60), min_size=len(places), max_size=len(places)))
    times = np.cumsum(steps)
    frames = np.arange(times[0], times[-1] + 1)
    path = np.stack([np.interp(frames, times, places[:, axis]) for axis in (0, 1)], axis=1)
    noise = np.random.default_rng(draw(st.integers(0, 99))).normal(0, jitter, path.shape)
    return np.asarray(path + draw(st.booleans()) * noise)


@given(ways(), st.data())
def test_who_is_in_has_come_in_and_not_gone(path: Way, data: st.DataObject) -> None:
    lost = data.draw(st.lists(st.tuples(st.integers(0, len(path)), st.integers(1, 120)), max_size=3))
    there = np.ones(len(path), bool)
    for start, length in lost:
        there[start : start + length] = False
    found = events(path, there=there.tolist())
    for name in ("strip", "diamond"):
        of_zone = [event for event in found if event.zone == name and event.kind in (*IN, *OUT)]
        for came, went in zip(of_zone[::2], of_zone[1::2], strict=True):
            assert came.kind in IN
            assert went.kind in OUT
            assert went.duration == pytest.approx(went.moment.time - came.moment.time)
            assert went.duration >= 0
    stood = [event for event in found if event.kind in ("stands", "stood")]
    for name in {event.zone for event in stood}:
        turns = [event.kind for event in stood if event.zone == name]
        assert turns == ["stands", "stood"] * (len(turns) // 2)
    if np.diff(np.flatnonzero(there)).max(initial=0) / 25 > Zones().max_coast_time:
        return  # nobody knows where it was meanwhile
    crossings = [event.direction for event in found if event.kind == "crossed"]
    assert all(one != other for one, other in pairwise(crossings)), "there and back"


@given(ways())
def test_a_film_backwards_swaps_directions(path: Way) -> None:
    forth, back = events(path), events(path[::-1])

    def counted(found: Sequence[Event], swap: dict[str, str]) -> Counter[tuple[str, str, str]]:
        same = {"remained": "disappeared"} | swap
        return Counter(
            (same.get(each.kind, each.kind), each.zone, same.get(each.direction, each.direction))
            for each in found
            if each.kind not in ("stands", "stood")
        )

    swap = {
        "entered": "left", "left": "entered", "appeared": "disappeared", "disappeared": "appeared",
        "remained": "appeared", "left to right": "right to left", "right to left": "left to right",
    }  # fmt: skip
    assert counted(forth, {}) == counted(back, swap)

    def standing(found: Sequence[Event]) -> list[float]:
        # once, in however many zones: that depends on the place where it begins
        stood = {each.moment: each.duration or 0 for each in found if each.kind == "stood"}
        return sorted(stood.values())

    assert standing(forth) == pytest.approx(standing(back), abs=0.05)


@given(ways(), st.sampled_from([0.25, 0.5, 2.0, 8.0]))
def test_the_scale_changes_nothing_else(path: Way, scale: float) -> None:
    one, other = events(path), events(path, scale=scale)
    assert kinds(one) == kinds(other)
    for small, large in zip(one, other, strict=True):
        assert small.moment[:2] == pytest.approx(large.moment[:2])
        assert np.array(small.moment[2:]) * scale == pytest.approx(np.array(large.moment[2:]))
        assert (small.duration, small.direction) == (pytest.approx(large.duration), large.direction)


def test_a_foot_at_the_border_does_not_flicker() -> None:
    """A minute on the border. 1500 errors of 0.15 of what is allowed for never reach it (6.7 deviations)."""
    noise = np.random.default_rng(0).normal(0, 0.15 * ERROR * HEIGHT, (1500, 2))
    path = np.concatenate([[[150.0, 120.0]] * 5, np.array([100.0, 120.0]) + noise])
    assert ("left", "strip") not in kinds(events(path))
    assert np.count_nonzero(np.diff(path[5:, 0] > 100)) > 500, "a border alone would be crossed often"


def test_a_crossing_is_dated_to_the_border() -> None:
    path = np.stack([np.linspace(60, 160, 101), np.full(101, 120.0)], axis=1)  # 1 px a frame
    (entered,) = [each for each in events(path) if each.kind == "entered" and each.zone == "strip"]
    assert entered.moment == pytest.approx((40 / 25, 42, 100.0, 120.0), abs=1e-6)
    (crossed,) = [each for each in events(path) if each.kind == "crossed"]
    assert crossed.moment[0] == pytest.approx(90 / 25)
    assert crossed.direction == "right to left", (
        "it goes down, so that its left is on the right of the picture"
    )


def test_who_is_lost_and_found_again_has_not_left() -> None:
    path = np.tile([150.0, 120.0], (250, 1))
    there = np.ones(250, bool)
    there[70:140] = False  # 2.8 s
    found = events(path, there=there.tolist())
    assert kinds(found) == [
        ("appeared", "strip"), ("appeared", "diamond"), ("stands", "strip"), ("stands", "diamond"),
        ("stood", "strip"), ("stood", "diamond"), ("remained", "strip"), ("remained", "diamond"),
    ]  # fmt: skip
    assert [each.duration for each in found[4:]] == pytest.approx([249 / 25] * 4)
    there[70:150] = False  # 3.2 s
    assert Counter(kinds(events(path, there=there.tolist())))["disappeared", "strip"] == 1


def test_who_is_lost_inside_and_found_outside_has_left() -> None:
    path = np.concatenate([np.tile([150.0, 120.0], (50, 1)), np.tile([250.0, 120.0], (50, 1))])
    there = np.ones(100, bool)
    there[40:60] = False
    (left,) = [
        each for each in events(path, there=there.tolist()) if each.kind == "left" and each.zone == "strip"
    ]
    assert 39 / 25 < left.moment.time < 60 / 25
    assert left.moment[1:3] == pytest.approx((61, 200.0))


def test_a_place_that_is_only_predicted_is_less_sure() -> None:
    """Somebody stops being seen before the border, and the prediction runs on beyond it."""
    watch = Watch(zones())
    found = []
    for number in range(1, 58):
        x, seen = 60.0 + number, number <= 10
        found += watch.update(number / 25, number, [Sighting(1, x, 220.0, HEIGHT, seen)])
    assert not found, "17 px beyond, after two seconds"
    found = watch.update(58 / 25, 58, [Sighting(1, 120.0, 220.0, HEIGHT, True)])
    assert kinds(found) == [("entered", "strip")]


def test_who_walks_around_the_end_of_a_line_has_not_crossed_it() -> None:
    watched = Zones((), (Line("gate", (150.0, 100.0), (150.0, 140.0), "in", "out"),))
    through = np.stack([np.linspace(100, 200, 80), np.full(80, 120.0)], axis=1)
    around = np.stack([np.linspace(200, 100, 80), np.full(80, 180.0)], axis=1)
    found = events(np.concatenate([through, around, through]), watched=watched)
    assert [each.direction for each in found if each.kind == "crossed"] == ["out", "out"]


@pytest.mark.parametrize(("speed", "stands"), [(0.0, True), (0.05, True), (0.3, False), (0.8, False)])
def test_slower_than_a_tenth_of_a_height_a_second_is_standing(speed: float, stands: bool) -> None:
    times = np.arange(0, 6, 0.04)
    path = np.stack([20 + speed * HEIGHT * times, np.full(len(times), 230.0)], axis=1)
    path += np.random.default_rng(0).normal(0, ERROR * HEIGHT, path.shape)
    assert ("stands" in [each.kind for each in events(path)]) == stands


N_FRAMES = 120
ZONES = Zones(
    (Zone('a "door", left', np.array([[100.0, 0], [200, 0], [200, 240], [100, 240]]), (320, 240)),), ()
)


def boxes(number: int) -> list[TrackedBox]:
    """One walks through, one stands, one is there now and then; none in every fifth frame."""
    if number % 5 == 0:
        return []
    walks = TrackedBox(1, (50 + 1.237 * number, 100.111, 20.555, 40.333))
    stands = TrackedBox(7, (149.999, 60.001, 20.005, 41.005), seen=number % 3 > 0)
    now_and_then = TrackedBox(3, (100.004 + number % 7, 90, 10, 33.333))
    return [walks, stands, now_and_then][: 2 + (number // 10) % 2]


def write(folder: Path, first: int, last: int, every: int = 10) -> None:
    """Frames first to last of a run that has got as far as first - 1."""
    after = first - 1
    log, table = RowLog(folder / "rows", after), TrackTableWriter(folder / "tracks.csv", after)
    events = EventLog(ZONES, log)
    with log, table, EventWriter(folder / "events.csv", events.events) as writer:
        for number in range(first, last + 1):
            found, time = boxes(number), (number - 1) / 12.5 + 1e-7
            table.write(number, time, found)
            objects = columns_of(found)
            log.append({"number": np.int64(number), "time": time}, objects)
            writer.write(events.add(number, time, objects))
            if number % every == 0:
                for each in (log, table, writer):
                    each.checkpoint()
        log.checkpoint()
        events.end(int(log["number"][-1]))
    write_events(folder / "events.csv", events.events)


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    folder = tmp_path / "whole"
    folder.mkdir()
    write(folder, 1, N_FRAMES)
    return folder


def test_the_table_of_tracks_gives_the_same(whole: Path) -> None:
    events = EventLog(ZONES)
    events.add_table(read_tracks_table(whole))
    events.end(N_FRAMES)
    found = events.events
    lines = (whole / "events.csv").read_text().splitlines()
    assert lines == [",".join(COLUMNS), *map(line_of, found)]
    assert lines[1:] == [line_of(event) for event in read_events(whole / "events.csv")]
    assert {event.kind for event in found} >= {Kind.ENTERED, Kind.APPEARED, Kind.STANDS, Kind.STOOD}


def test_another_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "events.csv"
    path.write_text("a,b\n")
    with pytest.raises(ValueError, match=r"events\.csv: got another header, expected time,frame,event"):
        read_events(path)
    path.write_text(",".join(COLUMNS) + "\n1.0,1,flew,a,1,1,1,,\n")
    with pytest.raises(ValueError, match=r"events\.csv, line 2: got '1\.0,1,flew,a"):
        read_events(path)

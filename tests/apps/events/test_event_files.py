"""`events.csv`: read back as it was written, while it grows, and after a run that goes on."""

import csv
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.events import Event, EventWriter, Kind, Moment, Watch, Zone, Zones, read_events
from rsmcm.apps.events.event_files import COLUMNS, line_of, sightings_of
from rsmcm.apps.exports import TrackTableWriter, read_tracks_table
from rsmcm.apps.io.mot import TrackedBox

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
    table = TrackTableWriter(folder / "tracks.csv", after)
    with table, EventWriter(folder / "events.csv", ZONES, folder / "tracks.csv", after) as writer:
        for number in range(first, last + 1):
            found, time = boxes(number), (number - 1) / 12.5 + 1e-7
            table.write(number, time, found)
            writer.write(number, time, found)
            if number % every == 0:
                table.checkpoint()
                writer.checkpoint()


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    folder = tmp_path / "whole"
    folder.mkdir()
    write(folder, 1, N_FRAMES)
    return folder


@pytest.mark.parametrize(("stop", "go_on"), [(1, 2), (50, 51), (57, 51), (N_FRAMES, N_FRAMES + 1)])
def test_a_run_that_goes_on_writes_the_same(stop: int, go_on: int, whole: Path, tmp_path: Path) -> None:
    """It ended in frame `stop`, completely, or was killed after the state of frame `go_on - 1` was saved."""
    write(tmp_path, 1, stop)
    write(tmp_path, go_on, N_FRAMES)
    assert (tmp_path / "events.csv").read_bytes() == (whole / "events.csv").read_bytes()


def test_the_table_of_tracks_gives_the_same(whole: Path) -> None:
    watch, found = Watch(ZONES), list[Event]()
    for time, number, sightings in sightings_of(read_tracks_table(whole)):
        found += watch.take_in(time, number, sightings)
    found += watch.end(N_FRAMES)
    lines = (whole / "events.csv").read_text().splitlines()
    assert lines == [",".join(COLUMNS), *map(line_of, found)]
    assert {event.kind for event in found} >= {Kind.ENTERED, Kind.APPEARED, Kind.STANDS, Kind.STOOD}


def test_who_reads_along_sees_what_has_happened(tmp_path: Path) -> None:
    path = tmp_path / "events.csv"
    with EventWriter(path, ZONES, tmp_path / "tracks.csv") as writer:
        assert read_events(path) == []
        writer.write(1, 0.0, boxes(1))
        (appeared,) = read_events(path)
        assert appeared == Event(Moment(0.0, 1, 160.0, 101.01), Kind.APPEARED, ZONES.zones[0].name, 7)
    assert [event.kind for event in read_events(path)] == [Kind.APPEARED, Kind.REMAINED]


def test_read_back(whole: Path) -> None:
    found = read_events(whole / "events.csv")
    with (whole / "events.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["event"], row["zone"], int(row["id"])) for row in rows] == [
        (each.kind, each.zone, each.identity) for each in found
    ]
    assert [line_of(event) for event in found] == (whole / "events.csv").read_text().splitlines()[1:]


def test_another_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "events.csv"
    path.write_text("a,b\n")
    with pytest.raises(ValueError, match=r"events\.csv: got another header, expected time,frame,event"):
        read_events(path)
    path.write_text(",".join(COLUMNS) + "\n1.0,1,flew,a,1,1,1,,\n")
    with pytest.raises(ValueError, match=r"events\.csv, line 2: got '1\.0,1,flew,a"):
        read_events(path)


def test_nobody_has_been_there_yet(tmp_path: Path) -> None:
    """A run that is interrupted before its first track goes on; one without any has no events."""
    for after in (0, 3):
        table = TrackTableWriter(tmp_path / "tracks.csv", after)
        with table, EventWriter(tmp_path / "events.csv", ZONES, tmp_path / "tracks.csv", after) as writer:
            for number in range(after + 1, after + 4):
                table.write(number, number / 25, [])
                writer.write(number, number / 25, [])
    assert list(sightings_of(read_tracks_table(tmp_path))) == []
    assert read_events(tmp_path / "events.csv") == []

"""Tracks in MOT format."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.exports import read_tracks_table
from rsmcm.apps.io.tracks import COLUMNS, HEADER, TrackedBox, TrackWriter, read_tracks

from ...support.film import Box
from ...support.tables import TrackTableWriter


def test_tracks_are_written_as_mot_has_them(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    with TrackWriter(path) as writer:
        writer.write(1, [Box(7, (0.0, 0.0, 10.0, 20.5), 0.25)])
        writer.write(2, [])
    assert path.read_text() == "1,7,1.00,1.00,10.00,20.50,0.2500,-1,-1,-1\n"


finite = st.floats(-5000, 5000).map(lambda value: round(value, 2))


@given(
    st.lists(
        st.tuples(
            st.integers(1, 99), st.integers(1, 99), finite, finite, st.floats(0, 999), st.floats(0, 999)
        ),
        max_size=8,
    )
)
def test_tracks_come_back(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]]) -> None:
    path = tmp_path_factory.mktemp("tracks") / "tracks.txt"
    rows.sort(key=lambda row: row[0])
    with TrackWriter(path) as writer:
        for number, identity, *box in rows:
            writer.write(int(number), [Box(int(identity), tuple(box), 0.5)])  # type: ignore[arg-type]
    read = read_tracks(path)
    assert read["frame"].tolist() == [row[0] for row in rows]
    assert read["id"].tolist() == [row[1] for row in rows]
    np.testing.assert_allclose(read["box"], np.array([row[2:] for row in rows]).reshape(-1, 4), atol=0.0051)
    assert (read["confidence"] == 0.5).all()


@pytest.mark.parametrize(
    "line",
    ["1,1,5,5,10", "1,a,5,5,10,10", "0,1,5,5,10,10", "1,1,5,5,-1,10", "1.5,1,1,1,1,1", "1,1,nan,5,1,1", "x"],
)
def test_broken_tracks_name_file_and_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(f"1,1,5,5,10,10,1,1,1\n\n{line}\n")
    with pytest.raises(ValueError, match=r"gt\.txt, line 3: got .*, expected "):
        read_tracks(path)


ROWS = [
    (1, 0.0, TrackedBox(7, (0.0, 0.0, 10.0, 20.5), 0.25, (-3.5, 12.25), False)),
    (2, 0.04, TrackedBox(7, (1.0, 0.0, 10.0, 20.5), 1.0)),
    (2, 0.04, TrackedBox(9, (-4.5, 3.0, 7.0, 8.0), 0.5, (0.0, -0.01))),
]


def write(path: Path, rows: list[tuple[int, float, TrackedBox]] = ROWS) -> Path:
    with TrackTableWriter(path) as writer:
        for number in sorted({number for number, _, _ in rows}):
            some = [row for row in rows if row[0] == number]
            writer.write(number, some[0][1], [track for _, _, track in some])
    return path


def test_a_row_is_an_object_in_a_frame(tmp_path: Path) -> None:
    assert write(tmp_path / "tracks.csv").read_text() == (
        "frame,time,id,x,y,width,height,confidence,vx,vy,seen\n"
        "1,0.000000,7,0.00,0.00,10.00,20.50,0.2500,-3.50,12.25,0\n"
        "2,0.040000,7,1.00,0.00,10.00,20.50,1.0000,,,1\n"
        "2,0.040000,9,-4.50,3.00,7.00,8.00,0.5000,0.00,-0.01,1\n"
    )


number = st.floats(-1e4, 1e4)
size = st.floats(0, 1e3)
tracks = st.builds(
    TrackedBox,
    st.integers(1, 1 << 53),
    st.tuples(number, number, size, size),
    st.floats(0, 1),
    st.tuples(number, number) | st.just((math.nan, math.nan)),
    st.booleans(),
)


@given(st.lists(st.tuples(st.integers(1, 50), tracks), max_size=8))
def test_what_was_written_is_read(tmp_path_factory: pytest.TempPathFactory, found: list) -> None:
    rows = [(frame, frame / 30, track) for frame, track in sorted(found, key=lambda row: row[0])]
    folder = tmp_path_factory.mktemp("tracks")
    columns = read_tracks_table(write(folder / "tracks.csv", rows))
    assert {name: column.dtype for name, column in columns.items()} == {
        name: np.dtype(kind) for name, kind in COLUMNS.items()
    }
    assert columns["id"].tolist() == [track.identity for _, _, track in rows]
    assert columns["seen"].tolist() == [track.seen for _, _, track in rows]
    expected = [(frame, time, *track.box, track.confidence, *track.velocity) for frame, time, track in rows]
    names = ("frame", "time", "x", "y", "width", "height", "confidence", "vx", "vy")
    read = np.stack([columns[name] for name in names], axis=1)
    np.testing.assert_allclose(read, np.reshape(expected, (-1, len(names))), rtol=0, atol=0.0051)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("frame,id\n", "line 1: got 'frame,id', expected frame,time,id"),
        ("", "line 1: got ''"),
        (f"{HEADER}\n1,0,1\n", "line 2: got '1,0,1', expected numbers"),
        (f"{HEADER}\n1,0,1,1,1,1,1,1,1,1,2\n", "line 2: got seen 2, expected 0 or 1"),
        (f"{HEADER}\n1,0,1,1,1e9,1,1,1,1,1,1\n", "line 2: got a box .*, expected a size .* px up to"),
        (f"{HEADER}\n1,0,1,1,1,-1,1,1,1,1,1\n", "line 2: got a box .*, expected a size that is not negative"),
        (f"{HEADER}\n2,1,1,1,1,1,1,1,,,1\n1,1,1,1,1,1,1,1,,,1\n", "line 3: got frame 1 at 1 s after frame 2"),
        (f"{HEADER}\n1,1,1,1,1,1,1,1,,,1\n2,0.5,1,1,1,1,1,1,,,1\n", "line 3: got frame 2 at 0.5 s after"),
    ],
)
def test_what_is_no_such_table_is_named(tmp_path: Path, text: str, wrong: str) -> None:
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"tracks\.csv, {wrong}"):
        read_tracks_table(path)

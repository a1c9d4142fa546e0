"""Tracks in MOT format."""

import resource
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.io.mot import TrackWriter, read_tracks

from ...support.film import Box


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


def test_tracks_of_a_full_disk_are_whole_lines(tmp_path: Path) -> None:
    """A limit of the size of files stands for the full disk."""
    path = tmp_path / "tracks.txt"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        tracks = TrackWriter(path)
        for number in range(1, 100):
            tracks.write(number, [Box(1, (number, 5.0, 10.0, 20.0), 1.0)])
        with pytest.raises(OSError, match=r"tracks\.txt"):
            tracks.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert 900 < path.stat().st_size <= 1000
    text = path.read_text()
    assert text.endswith("\n")
    assert read_tracks(path)["frame"].tolist() == list(range(1, text.count("\n") + 1))


def test_resumed_tracks_end_at_the_state(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    path.write_text("1,1,1,1,1,1,1,-1,-1,-1\n9,1,1,1,1,1,1,-1,-1,-1\n10,1,1,1,1,1,1,-1,-1,-1\n11,1,1")
    TrackWriter(path, resume_after=9).close()
    assert path.read_text() == "1,1,1,1,1,1,1,-1,-1,-1\n9,1,1,1,1,1,1,-1,-1,-1\n"
    TrackWriter(path, resume_after=0).close()
    assert path.read_text() == ""


@pytest.mark.parametrize(
    "line",
    ["1,1,5,5,10", "1,a,5,5,10,10", "0,1,5,5,10,10", "1,1,5,5,-1,10", "1.5,1,1,1,1,1", "1,1,nan,5,1,1", "x"],
)
def test_broken_tracks_name_file_and_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(f"1,1,5,5,10,10,1,1,1\n\n{line}\n")
    with pytest.raises(ValueError, match=r"gt\.txt, line 3: got .*, expected "):
        read_tracks(path)


def test_empty_tracks(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("")
    assert read_tracks(tmp_path / "a.txt")["box"].shape == (0, 4)


def test_ground_truth_of_pets(data_folder: Path) -> None:
    path = data_folder / "pets2009-s2l1" / "gt.txt"
    if not path.exists():
        pytest.skip(f"no {path}")
    tracks = read_tracks(path)
    assert len(tracks) == sum(1 for line in path.read_text().splitlines() if line)
    assert tracks["frame"].min() >= 1

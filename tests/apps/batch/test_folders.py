"""Names of folders: no two the same, of plain letters, and those that were given stay."""

import re

from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.batch.sources import LONGEST, FilmSource, folder_names


def names(*sources: str, known: dict[str, str] | None = None) -> list[str]:
    return folder_names([FilmSource(source) for source in sources], known or {})


def test_as_many_parts_as_tell_them_apart() -> None:
    assert names("/a/street.mp4", "/a/b/gate.v2.mov", "/a/frames.v2") == ["street", "gate.v2", "frames.v2"]
    assert names("/a/x/cam.mp4", "/a/y/cam.mp4", "/a/z/Cam.mp4") == ["x-cam", "y-cam", "z-Cam"]
    assert names("/a/x/cam.mp4", "/b/x/cam.mp4", "/c/other.mp4") == ["a-x-cam", "b-x-cam", "other"]
    assert names("/a/cam.mp4", "/a/cam.avi") == ["a-cam", "a-cam-2"]
    assert names("/a/frames/*.png", "0", "rtsp://host:554/street/1?key=x") == ["frames", "camera-0", "1"]
    assert names("rtsp://one/live", "rtsp://two/live") == ["one-live", "two-live"]
    assert names("/") == ["film"]


def test_names_that_were_given_stay() -> None:
    assert names("/b/cam.mp4", "/a/cam.mp4", known={"/a/cam.mp4": "cam"}) == ["cam-2", "cam"]
    listed = [FilmSource("0", "Cam", where="list"), FilmSource("/a/cam.mp4")]
    assert folder_names(listed, {"/a/cam.mp4": "cam"}) == ["Cam", "cam-2"]
    assert folder_names([FilmSource("/summary.csv.mp4")], {}, ["summary.csv"]) == ["summary.csv-2"]


@given(st.lists(st.text(min_size=1, max_size=120), unique=True, max_size=12))
def test_no_two_are_the_same_on_any_file_system(sources: list[str]) -> None:
    made = names(*sources)
    assert len({name.casefold() for name in made}) == len(sources)
    assert all(re.fullmatch(r"[\w.-]+", name) and name[0] not in ".-" for name in made)
    assert max(map(len, made), default=0) <= LONGEST + 4
    assert names(*sources, known=dict(zip(sources, made, strict=True))) == made

"""Which films are meant: files, folders, globs, addresses, lists of cameras; everything else is one line."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.batch.sources import FilmSource, find_films


def images(folder: Path, count: int = 2) -> Path:
    folder.mkdir(parents=True)
    for number in range(count):
        cv2.imwrite(str(folder / f"{number}.png"), np.zeros((4, 6, 3), np.uint8))
    return folder


def films(folder: Path, *names: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return [folder / name for name in names]


def sources(found: list[FilmSource]) -> list[str]:
    return [each.source for each in found]


def test_folders_of_films_and_of_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two, ten = films(tmp_path / "films", "1.mp4", "2.AVI", "10.mkv")
    films(tmp_path / "films", "notes.txt", ".hidden.mp4", "tracks.npz")
    frames = images(tmp_path / "films" / "frames")
    assert sources(find_films([str(tmp_path / "films")])) == [str(each) for each in (one, two, ten, frames)]
    assert sources(find_films([str(frames)])) == [str(frames)]
    monkeypatch.chdir(tmp_path)
    assert sources(find_films(["films/1.mp4", str(one), "films"])) == [
        str(each) for each in (one, two, ten, frames)
    ]


def test_track_files_are_films_of_structure(tmp_path: Path) -> None:
    film, tracks = films(tmp_path, "film.mp4", "tracks.npz")
    assert sources(find_films([str(tmp_path)], tracks=True)) == [str(film), str(tracks)]


def test_globs(tmp_path: Path) -> None:
    two, ten = films(tmp_path, "b2.mp4", "b10.mp4")
    frames = images(tmp_path / "a")
    assert sources(find_films([f"{tmp_path}/b*.mp4"])) == [str(two), str(ten)]
    assert sources(find_films([f"{frames}/*.png"])) == [f"{frames}/*.png"], "one film"
    assert sources(find_films([f"{tmp_path}/*"])) == [str(frames), str(two), str(ten)]


def test_results_among_the_films_are_none(tmp_path: Path) -> None:
    """Of a batch whose results are beside its films, the second time."""
    film, other = films(tmp_path / "films", "a.mp4", "b.mp4")
    for out in (tmp_path / "films", tmp_path / "films" / "out"):
        films(out, "summary.csv", "index.html")
        films(images(out / "a"), "manifest.json", "state.npz", "film.mp4")
    both = [str(film), str(other)]
    assert sources(find_films([str(tmp_path / "films")])) == both
    assert sources(find_films([f"{tmp_path}/films/*"])) == both
    assert sources(find_films([f"{tmp_path}/films/**/*.mp4"])) == both
    assert sources(find_films([f"{tmp_path}/*"])) == both
    with pytest.raises(FileNotFoundError, match="matches nothing but results"):
        find_films([f"{tmp_path}/films/out/a/*.png"])
    assert sources(find_films([str(tmp_path / "films" / "out" / "a" / "film.mp4")])), "who names it means it"
    not_ours = films(images(tmp_path / "site" / "frames"), "manifest.json")[0].parent
    assert sources(find_films([str(tmp_path / "site")])) == [str(not_ours)]


def test_cameras(tmp_path: Path) -> None:
    found = find_films(["rtsp://host/a", "0", "http://host/film.mp4", "https://host/live"])
    assert [each.live for each in found] == [True, True, False, True]
    (file,) = films(tmp_path, "film.mp4")
    assert not find_films([str(file)])[0].live


def test_a_list_of_cameras(tmp_path: Path) -> None:
    listed = tmp_path / "cameras.toml"
    listed.write_text(
        'masks = "none"\nreconnect = 60\n'
        '[[camera]]\nname = "Gate"\nsource = "rtsp://host/a"\n'
        '[[camera]]\nsource = 1\nwarm-up = 2.5\nmasks = "video"\nclasses = ["a", "b"]\n'
    )
    gate, first = find_films([str(listed)])
    assert (gate.source, gate.name, gate.options) == (
        "rtsp://host/a",
        "Gate",
        {"masks": "none", "reconnect": 60},
    )
    assert (first.source, first.name) == ("1", None)
    assert first.options == {"masks": "video", "reconnect": 60, "warm_up": 2.5, "classes": ["a", "b"]}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"expected \[\[camera\]\] for each camera"),
        ("[camera]\nsource = 'a'", r"expected \[\[camera\]\] for each camera"),
        ("[[camera]]\nname = 'a'", "camera 1: source: got None, expected an address"),
        (
            "[[camera]]\nsource = '0'\n[[camera]]\nsource = '1'\nname = 3",
            "camera 2: name: got 3, expected a t",
        ),
        (
            "[[camera]]\nsource = '0'\nroi = {x = 3}",
            "camera 1: roi: got {'x': 3}, expected the value of an opt",
        ),
        (
            "[[camera]]\nsource = '0'\nname = 'a'\n[[camera]]\nsource = '0'\nname = 'b'",
            r"camera 2 \(b\): got 0 twice, expected another source",
        ),
    ],
)
def test_wrong_lists(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "cameras.toml").write_text(text)
    with pytest.raises(ValueError, match=words):
        find_films([str(tmp_path / "cameras.toml")])


def test_what_is_no_film(tmp_path: Path) -> None:
    both = images(tmp_path / "both")
    films(both, "film.mp4")
    (tmp_path / "empty").mkdir()
    for source, kind, words in (
        (tmp_path / "nothing.mp4", FileNotFoundError, "nothing.mp4: no such file or folder"),
        (tmp_path / "no*thing", FileNotFoundError, "matches nothing"),
        (tmp_path / "empty", FileNotFoundError, "holds no images and no films"),
        (both, ValueError, r"holds images and films \(film.mp4\)"),
        (both / "0.png", ValueError, "got a picture, expected a film"),
    ):
        with pytest.raises(kind, match=words):
            find_films([str(source)])
    with pytest.raises(ValueError, match="SOURCES is needed"):
        find_films([])

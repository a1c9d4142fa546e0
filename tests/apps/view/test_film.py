"""The small film and its rows: the same after a kill, bounded for ever, every picture with its row."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io.files import segments_of
from rsmcm.apps.view import film as module
from rsmcm.apps.view.film import FILM, LONGEST_SIDE, ROWS, FilmWriter, read_film
from rsmcm.models.core.frame import Frame

from ...support.film import HEIGHT, WIDTH, frame, joined_names, read_video

EVERY = 10


def row(number: int) -> dict[str, NDArray[np.float32]]:
    draws = np.random.default_rng(number)
    return {"box": draws.random((number % 4, 4), np.float32), "one": np.array([number], np.float32)}


def write(folder: Path, numbers: Iterable[int], after: int = 0, kill_at: int | None = None) -> None:
    """A run that saves its state after every tenth frame, and dies before frame `kill_at` without a word."""
    writer = FilmWriter(folder, 10, after)
    for number in numbers:
        if number == kill_at:
            writer._worker.wait()  # a process that is killed may have come so far
            return
        writer.add(frame(number), lambda number=number: row(number))  # type: ignore[misc]
        if number % EVERY == 0:
            writer.checkpoint()
    with writer:
        pass


def test_every_picture_has_its_moment_and_its_row(tmp_path: Path) -> None:
    write(tmp_path, range(1, 26))
    film = read_film(tmp_path)
    np.testing.assert_array_equal(film.numbers, np.arange(1, 26))
    np.testing.assert_allclose(film.times, np.arange(25) / 10)
    pictures, times = read_video(tmp_path / FILM)
    np.testing.assert_allclose(film.moments, times, atol=1e-6)
    for number, picture in enumerate(pictures, start=1):
        assert abs(float(picture.mean()) - (20 + 5 * number)) < 3
    starts = np.cumsum([0, *film.counts["box"]])
    for number in film.numbers:
        here = film.columns["box"][starts[number - 1] : starts[number]]
        np.testing.assert_array_equal(here, row(number)["box"])
    assert joined_names(tmp_path) == {FILM, ROWS}


@pytest.mark.parametrize("killed", [3, 11, 17, 24])
def test_a_killed_run_goes_on_to_the_same_rows(
    tmp_path: Path, killed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SEGMENT", 4)
    whole, again = tmp_path / "whole", tmp_path / "again"
    whole.mkdir()
    again.mkdir()
    write(whole, range(1, 26))
    write(again, range(1, 26), kill_at=killed)
    saved = (killed - 1) // EVERY * EVERY
    write(again, range(saved + 1, 26), after=saved)
    assert joined_names(again) == joined_names(whole)
    for name in joined_names(whole):
        assert (again / name).read_bytes() == (whole / name).read_bytes()


def test_what_lost_its_partner_in_a_kill_is_no_part_of_the_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SEGMENT", 4)
    write(tmp_path, range(1, 26), kill_at=21)
    assert len(segments_of(tmp_path / FILM)) == 6
    segments_of(tmp_path / FILM)[0].unlink()  # the oldest goes, and the process dies before its rows do
    write(tmp_path, range(21, 26), after=20)
    film = read_film(tmp_path)
    np.testing.assert_array_equal(film.numbers, np.arange(5, 26))
    assert len(film.moments) == 21


def test_an_endless_stream_keeps_its_last_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    most = 60_000
    monkeypatch.setattr(module, "SEGMENT", 4)
    monkeypatch.setattr(module, "MOST_BYTES", most)
    largest = 0
    with FilmWriter(tmp_path, 10) as writer:
        for number in range(1, 301):
            noise = np.random.default_rng(number).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
            writer.add(Frame(noise, number / 10, number), lambda number=number: row(number))  # type: ignore[misc]
            writer._worker.wait()
            files = [*segments_of(tmp_path / FILM), *segments_of(tmp_path / ROWS)]
            largest = max(largest, sum(path.stat().st_size for path in files))
    assert largest <= most
    film = read_film(tmp_path)
    assert film.numbers[-1] == 300
    assert (np.diff(film.numbers) == 1).all()
    assert 0.5 * most < (tmp_path / FILM).stat().st_size <= 1.1 * most, "no more is given up than has to be"
    assert len(film.moments) == len(film.numbers) == len(film.counts["box"])


@pytest.mark.parametrize(("size", "shown"), [((1920, 1080), (640, 360)), ((1080, 1920), (360, 640))])
def test_pictures_are_small(tmp_path: Path, size: tuple[int, int], shown: tuple[int, int]) -> None:
    with FilmWriter(tmp_path, 10) as writer:
        for number, channels in enumerate(((), (3,)), start=1):  # a film may be grey
            image = np.full((size[1], size[0], *channels), 90, np.uint8)
            writer.add(Frame(image, number / 10, number), dict)
    video = cv2.VideoCapture(str(tmp_path / FILM))
    assert (int(video.get(3)), int(video.get(4))) == shown
    assert max(shown) == LONGEST_SIDE


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": np.full((5, 2), 2**20, np.int32)}, "size: got .*, expected sizes of pictures"),
        ({"number": np.arange(4)}, "number.*got shape|time.*got shape"),
        ({"box.count": np.arange(5)}, r"box: got \(\d+, 4\) float32 for 10"),
        ({"box.count": np.array([0, 1, 2, 3, -6])}, "box.count: got .*, expected numbers from 0"),
        ({"one": np.full(5, "x")}, r"one: got \(5,\) <U1"),
        ({"more": np.zeros(3)}, "more.count: got None"),
    ],
)
def test_forged_rows_are_refused_by_name(
    changes: dict[str, NDArray[Any]], message: str, tmp_path: Path
) -> None:
    write(tmp_path, range(1, 6))
    with np.load(tmp_path / ROWS) as file:
        arrays = dict(file)
    np.savez(tmp_path / ROWS, allow_pickle=False, **(arrays | changes))
    with pytest.raises(ValueError, match=rf"view\.npz: ({message})"):
        read_film(tmp_path)

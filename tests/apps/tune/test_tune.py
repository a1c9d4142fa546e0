"""A search for parameters where the measure of a film is a known function of them."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.background.parameters import read_parameters, with_defaults
from rsmcm.apps.experiments.films import TrueFilm
from rsmcm.apps.tune import application, search
from rsmcm.apps.tune.application import Judged, gain_of, run_tune, toml_text

from ...conftest import Command

pytest.importorskip("optuna")

Measure = Callable[[int, dict[str, Any]], float]

BEST = 2.0
"""Settle time, in multiples of the default, at which the measure is highest."""


def write_films(folder: Path, count: int) -> Path:
    """Films with pictures and masks that nobody reads."""
    for number in range(count):
        for name, file in (("input", "in000001.png"), ("groundtruth", "gt000001.png")):
            (folder / f"film{number}" / name).mkdir(parents=True)
            (folder / f"film{number}" / name / file).write_bytes(b"none")
    return folder


@pytest.fixture
def scored(monkeypatch: pytest.MonkeyPatch) -> Callable[[Measure], list[str]]:
    """Have a measure be that of every film; what is returned has the films that were scored, in order."""

    def use(measure: Measure) -> list[str]:
        names: list[str] = []

        def score(film: TrueFilm, method: str, seed: int | None, parameters: Any) -> dict[str, float]:
            names.append(film.name)
            return {"F": measure(int(film.name.removeprefix("film")), with_defaults(parameters))}

        monkeypatch.setattr(search, "score", score)
        return names

    monkeypatch.setattr(TrueFilm, "known_by", lambda film: [film.name])
    return use


def settle(_: int, parameters: dict[str, Any]) -> float:
    default = with_defaults({})["background"]["settle_time"]
    return 0.9 - 0.1 * math.log(parameters["background"]["settle_time"] / (BEST * default)) ** 2


def test_a_better_value_is_found_and_written_for_config(
    scored: Callable[[Measure], list[str]], tmp_path: Path
) -> None:
    scored(settle)
    said = run_tune([write_films(tmp_path / "films", 3)], tmp_path / "out", minutes=0.2)
    assert "are better" in " ".join(said)
    found = with_defaults(read_parameters(tmp_path / "out" / "tuned.toml"))
    assert settle(0, found) > settle(0, with_defaults({})) + 0.02
    page = (tmp_path / "out" / "index.html").read_text()
    assert all(f"{section}.{name}" in page for section, names in search.SEARCHED.items() for name in names)


def test_what_suits_single_films_only_is_said_to_be_no_better(
    scored: Callable[[Measure], list[str]], tmp_path: Path
) -> None:
    """Each film wants another value, at random: what is learned of others says nothing of a film."""
    wanted = np.random.default_rng(0).permutation([-1, 1, -1, 1, 0, 0])

    def measure(film: int, parameters: dict[str, Any]) -> float:
        default = with_defaults({})["background"]["noise"]
        return -((math.log(parameters["background"]["noise"] / default) - float(wanted[film])) ** 2)

    scored(measure)
    films = write_films(tmp_path / "films", 6)
    said = run_tune([films], tmp_path / "out", minutes=0.1)
    assert "as good" in " ".join(said)
    assert read_parameters(tmp_path / "out" / "tuned.toml") == {}


def test_a_search_goes_on_and_never_sees_the_films_of_its_fold(
    scored: Callable[[Measure], list[str]], tmp_path: Path
) -> None:
    names = scored(settle)
    task = search.Task(list(map_films(write_films(tmp_path / "films", 3))), {})
    seen = task.films[:2]
    found = [search.search(task, seen, 0.5, tmp_path, lambda: None) for _ in range(2)]
    assert found[1].trials > found[0].trials > 0
    assert set(names) == {"film0", "film1"}
    other = search.search(task, task.films[1:], 0.2, tmp_path, lambda: None)
    assert other.trials < found[1].trials


def map_films(folder: Path) -> list[TrueFilm]:
    return application.find_films([folder])


def test_the_interval_of_the_gain_is_students() -> None:
    """Of gains 1, 2, 3: mean 2, standard error 1 / sqrt(3), t of 2 degrees of freedom 4.3027."""
    gain, margin = gain_of([Judged(str(gain), 1, 0.0, gain) for gain in (1.0, 2.0, 3.0)])
    assert gain == 2.0
    assert margin == pytest.approx(4.302652729911275 / math.sqrt(3))


def test_parameters_are_read_back(tmp_path: Path) -> None:
    given = {"background": {"model": "mixture"}, "blobs": {"min_area": 1e-05, "strength": 3.0}}
    (tmp_path / "a.toml").write_text(toml_text(given))
    assert read_parameters(tmp_path / "a.toml") == given


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (["--folds", "4"], "--folds: got 4 for 3 films"),
        (["--folds", "1"], "--folds: got 1 for 3 films"),
        (["--minutes", "0"], "--minutes: got 0"),
        (["--seeds", "-1"], "--seeds: got -1"),
    ],
)
def test_wrong_options_are_one_line(
    options: list[str], wrong: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = write_films(tmp_path / "films", 3)
    assert wrong in Command("tune").complaint(capfd, folder, "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_a_foreign_file_is_kept(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tuned.toml").write_text("mine")
    films = write_films(tmp_path / "films", 3)
    assert "expected another folder" in Command("tune").complaint(capfd, films, "--out", tmp_path)
    assert (tmp_path / "tuned.toml").read_text() == "mine"

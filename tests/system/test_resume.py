"""An interrupted or killed run is resumed with the same results; `--from` uses what another one learned."""

import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs import memory
from rsmcm.apps.runs.interruption import Interruption
from rsmcm.apps.runs.session import Session

from ..support.films import results, stamps
from ..support.small_runs import N_FRAMES, SmallRun, small_run

TIMES = {"seconds", "frames_per_second", "frames_per_second_of_engine"}

OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("structure", "face", "body")]


class Killed(BaseException):
    """Nothing that a command would catch."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], SmallRun]:
    """A command by its name."""
    folder = tmp_path_factory.mktemp("films")
    return cache(lambda name: small_run(name, folder))


@pytest.fixture(scope="module")
def whole(
    small: Callable[[str], SmallRun], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """Results of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("whole")

    @cache
    def run(name: str) -> Path:
        assert small(name).run(folder / name) == 0
        return folder / name

    return run


def data_of(out: Path) -> dict[str, Any]:
    """Contents of all files that tell of no times; the summary without its times."""
    found: dict[str, Any] = results(out)
    found.pop("film.mp4", None)  # is encoded in segments
    summary = json.loads((out / "summary.json").read_text())
    return found | {"summary.json": {name: value for name, value in summary.items() if name not in TIMES}}


def assert_same(out: Path, whole: Path) -> None:
    """Equal data, byte by byte."""
    found, expected = data_of(out), data_of(whole)
    assert found.keys() == expected.keys()
    assert [name for name in found if found[name] != expected[name]] == []


@contextmanager
def signals_after(
    after: int, signals: list[signal.Signals], monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Inside the block, signals arrive after so many frames or rounds, all that are looked at counted."""
    items, count = Interruption.items, itertools.count(1)

    def interrupted(self: Interruption, source: Iterator[Any]) -> Iterator[Any]:
        for item in items(self, source):
            yield item
            if next(count) == after:
                for number in signals:
                    signal.raise_signal(number)

    with monkeypatch.context() as patch:
        patch.setattr(Interruption, "items", interrupted)
        yield


@pytest.mark.parametrize(
    ("name", "after"),
    [
        ("background", 9),
        *(
            pytest.param(name, after, marks=pytest.mark.slow)
            for name, after in (("structure", 1), ("face", 10), ("body", 26), ("body", 45))
        ),
    ],
)
@pytest.mark.parametrize("signals", [1, 2])
def test_interrupted_and_resumed(
    name: str,
    after: int,
    signals: int,
    small: Callable[[str], SmallRun],
    whole: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """One signal leaves complete results, a second one ends at once; resumed, they are those of one go.

    It comes after so many frames or rounds; of the body's, 25 frames are looked at before.
    """
    application, out = small(name), tmp_path / "out"
    with signals_after(after, [signal.SIGTERM] * signals, monkeypatch):
        assert application.run(out) == 128 + signal.SIGTERM
    *_, line = capfd.readouterr().err.splitlines() or [""]
    assert (line == f"rsmcm: interrupted: --resume continues {out}") == (signals == 2)
    if signals == 1:
        assert json.loads((out / "summary.json").read_text())["ended_early"]
    assert application.run(out, "--resume") == 0
    assert_same(out, whole(name))


@pytest.mark.parametrize("name", ["background", *OTHERS])
def test_a_finished_run_is_resumed_by_doing_nothing(
    name: str,
    small: Callable[[str], SmallRun],
    whole: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where there is too little memory for another run."""
    out = tmp_path / "out"
    shutil.copytree(whole(name), out)
    before = {name: path for name, path in stamps(out).items() if name.name != "manifest.json"}
    monkeypatch.setattr(memory.psutil, "virtual_memory", lambda: SimpleNamespace(available=0))
    assert small(name).run(out, "--resume") == 0
    after = stamps(out)
    assert {path: after[path] for path in before} == before


@pytest.mark.parametrize("name", ["background", *OTHERS])
def test_killed_between_its_last_file_and_its_last_state(
    name: str,
    small: Callable[[str], SmallRun],
    whole: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    application, out = small(name), tmp_path / "out"

    def killed_when_finished(self: Session, finished: Any) -> dict[str, Any]:
        if finished:
            raise Killed
        return about(self, finished)

    about = Session.about
    with monkeypatch.context() as patch:
        patch.setattr(Session, "about", killed_when_finished)
        with pytest.raises(Killed):
            application.run(out)
    assert application.run(out, "--resume") == 0
    assert_same(out, whole(name))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kills"), [("background", 13), ("structure", 13), ("face", 12), ("body", 12)]
)
def test_kills_at_random_moments(
    name: str, kills: int, small: Callable[[str], SmallRun], whole: Callable[[str], Path], tmp_path: Path
) -> None:
    """50 over all: whenever a process ends by itself, its results are those of a run in one go.

    Every other kill comes at any moment of a process, the others when it has begun to save.
    """
    application, random = small(name), np.random.default_rng(kills)
    command = [sys.executable, "-m", "rsmcm.apps.command_line"]
    finished, killed = 0, 0
    started = time.monotonic()
    subprocess.run([*command, *application.arguments(tmp_path / "timed")], capture_output=True, check=True)
    longest = time.monotonic() - started
    while killed < kills:
        out = tmp_path / str(finished)
        arguments = [*command, *application.arguments(out, "--resume")]
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        delay = float(random.uniform(0.2, 1.0)) * longest
        if killed % 2:
            before = saved_at(out)
            began = time.monotonic()
            while (
                saved_at(out) == before and process.poll() is None and time.monotonic() < began + 10 * longest
            ):
                time.sleep(0.002)
            delay = float(random.uniform(0, 0.2)) * longest
        try:
            _, complaint = process.communicate(timeout=delay)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            killed += 1
            continue
        assert process.returncode == 0, complaint
        assert_same(out, whole(name))
        finished += 1
    out = tmp_path / str(finished)
    assert application.run(out, "--resume") == 0
    assert_same(out, whole(name))


def saved_at(out: Path) -> int:
    """When the state was written; 0 if it is not there."""
    state = out / "state.npz"
    return state.stat().st_mtime_ns if state.exists() else 0


# --- learned from another film ------------------------------------------------------------------------------


def test_background_and_identities_from_another_film(
    small: Callable[[str], SmallRun], whole: Callable[[str], Path], tmp_path: Path
) -> None:
    """Halves that follow each other without a gap are as one film."""
    run = small("background")
    files = sorted(run.source.iterdir())
    for name, half in (("one", files[: N_FRAMES // 2]), ("two", files[N_FRAMES // 2 :])):
        (tmp_path / name).mkdir()
        for file in half:
            shutil.copy(file, tmp_path / name)
    first, second = tmp_path / "out1", tmp_path / "out2"
    assert replace(run, source=tmp_path / "one").run(first) == 0
    state = str(first / "state.npz")
    assert replace(run, source=tmp_path / "two", options=()).run(second, "--from", state) == 0
    for number in range(1, N_FRAMES // 2 + 1):
        mask = (second / "foreground" / f"bin{number:06d}.png").read_bytes()
        assert mask == (whole("background") / "foreground" / f"bin{number + 12:06d}.png").read_bytes()
    rows, expected = (read_tracks(out / "tracks.txt") for out in (second, whole("background")))
    expected = expected[expected["frame"] > N_FRAMES // 2]
    np.testing.assert_array_equal(rows["id"], expected["id"])
    np.testing.assert_array_equal(rows["box"], expected["box"])

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
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps import command_line
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs.interruption import Interruption
from rsmcm.apps.scenes import cylinder, face, signer, sleeping_man
from rsmcm.apps.scenes.signing.signer import SignerScene
from rsmcm.models.body.upper_body import JOINTS

from ..support.films import results, stamps

T = TypeVar("T")
N_FRAMES = 24
SIZE = (200, 160)
HEAD = JOINTS.index("head")

TIMES = {"seconds", "frames_per_second", "frames_per_second_of_engine"}


OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("structure", "face", "body")]


@dataclass(frozen=True)
class Application:
    """A command on a small film, with its options."""

    name: str
    source: Path
    options: tuple[str, ...]

    def arguments(self, out: Path, *more: str) -> list[str]:
        return [self.name, str(self.source), "--out", str(out), *self.options, *more]

    def run(self, out: Path, *more: str) -> int:
        with pytest.raises(SystemExit) as ended:
            command_line.main(self.arguments(out, *more))
        return int(ended.value.code or 0)


def write_film(folder: Path, images: Iterator[NDArray[np.uint8]]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number:03d}.png"), image)
    return folder


def signing() -> SignerScene:
    return signer(N_FRAMES, 3, 0.0, 0.3, (320, 180))


def head_of(scene: SignerScene) -> str:
    body, (x, y) = scene.body, scene.joints[0, HEAD, :2]
    width, height = body.head_width, body.head_height
    return f"{x - width / 2:.0f},{y - height / 2:.0f},{width:.0f},{height:.0f}"


EVERY = ("--every", "4")


def make(name: str, folder: Path) -> Application:
    """Write the source of an application."""
    if name == "background":
        images = (frame.image for frame in sleeping_man(N_FRAMES, size=SIZE) if frame.image is not None)
        return Application(name, write_film(folder / "street", images), EVERY)
    if name == "structure":
        np.savez(
            folder / "tracks.npz", tracks=100 * cylinder(p_loose=0.1, p_drift=0.1, seed=1).tracks() + 200
        )
        return Application(name, folder / "tracks.npz", ())
    if name == "face":
        talking = face(N_FRAMES, 3, SIZE)
        np.save(folder / "landmarks.npy", talking.vertices)
        options = ("--landmarks", str(folder / "landmarks.npy"), "--experts", "4", *EVERY)
        return Application(name, write_film(folder / "face", talking.images()), options)
    scene = signing()
    options = ("--head", head_of(scene), "--samples", "100", *EVERY)
    return Application(name, write_film(folder / "body", scene.images()), options)


class OnDemand(dict[str, T]):
    """A dictionary whose values are made when they are first used."""

    def __init__(self, make: Callable[[str], T]) -> None:
        self._make = make

    def __missing__(self, name: str) -> T:
        self[name] = self._make(name)
        return self[name]


@pytest.fixture(scope="module")
def applications(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Application]:
    folder = tmp_path_factory.mktemp("films")
    return OnDemand(lambda name: make(name, folder))


@pytest.fixture(scope="module")
def whole(applications: dict[str, Application], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of uninterrupted runs."""
    folder = tmp_path_factory.mktemp("whole")

    def run(name: str) -> Path:
        assert applications[name].run(folder / name) == 0
        return folder / name

    return OnDemand(run)


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
    applications: dict[str, Application],
    whole: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """One signal leaves complete results, a second one ends at once; resumed, they are those of one go.

    It comes after so many frames or rounds; of the body's, 25 frames are looked at before.
    """
    application, out = applications[name], tmp_path / "out"
    with signals_after(after, [signal.SIGTERM] * signals, monkeypatch):
        assert application.run(out) == 128 + signal.SIGTERM
    *_, line = capfd.readouterr().err.splitlines() or [""]
    assert (line == f"rsmcm: interrupted: --resume continues {out}") == (signals == 2)
    if signals == 1:
        assert json.loads((out / "summary.json").read_text())["ended_early"]
    assert application.run(out, "--resume") == 0
    assert_same(out, whole[name])


@pytest.mark.parametrize("name", ["background", *OTHERS])
def test_a_finished_run_is_resumed_by_doing_nothing(
    name: str, applications: dict[str, Application], whole: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole[name], out)
    before = {name: path for name, path in stamps(out).items() if name.name != "manifest.json"}
    assert applications[name].run(out, "--resume") == 0
    after = stamps(out)
    assert {path: after[path] for path in before} == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kills"), [("background", 13), ("structure", 13), ("face", 12), ("body", 12)]
)
def test_kills_at_random_moments(
    name: str, kills: int, applications: dict[str, Application], whole: dict[str, Path], tmp_path: Path
) -> None:
    """50 over all: whenever a process ends by itself, its results are those of a run in one go.

    Every other kill comes at any moment of a process, the others when it has begun to save.
    """
    application, random = applications[name], np.random.default_rng(kills)
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
        assert_same(out, whole[name])
        finished += 1
    out = tmp_path / str(finished)
    assert application.run(out, "--resume") == 0
    assert_same(out, whole[name])


def saved_at(out: Path) -> int:
    """When the state was written; 0 if it is not there."""
    state = out / "state.npz"
    return state.stat().st_mtime_ns if state.exists() else 0


# --- learned from another film ------------------------------------------------------------------------------


def parts_of(application: Application, folder: Path) -> tuple[Path, Path]:
    """The film in two halves."""
    files = sorted(application.source.iterdir())
    halves = folder / "first", folder / "second"
    for half, some in zip(halves, (files[: N_FRAMES // 2], files[N_FRAMES // 2 :]), strict=True):
        half.mkdir()
        for file in some:
            shutil.copy(file, half)
    return halves


def learned(application: Application, folder: Path, *kept: str) -> tuple[Path, Path]:
    """Results of the first half, and of the second one begun with what was learned from the first."""
    one, two = parts_of(application, folder)
    first, second = folder / "out1", folder / "out2"
    assert Application(application.name, one, application.options).run(first) == 0
    after = Application(application.name, two, kept)
    assert after.run(second, "--from", str(first / "state.npz")) == 0
    return first, second


def test_background_and_identities_from_another_film(
    applications: dict[str, Application], whole: dict[str, Path], tmp_path: Path
) -> None:
    """Halves that follow each other without a gap are as one film."""
    _, second = learned(applications["background"], tmp_path)
    for number in range(1, N_FRAMES // 2 + 1):
        mask = (second / "foreground" / f"bin{number:06d}.png").read_bytes()
        assert mask == (whole["background"] / "foreground" / f"bin{number + 12:06d}.png").read_bytes()
    rows, expected = (read_tracks(out / "tracks.txt") for out in (second, whole["background"]))
    expected = expected[expected["frame"] > N_FRAMES // 2]
    np.testing.assert_array_equal(rows["id"], expected["id"])
    np.testing.assert_array_equal(rows["box"], expected["box"])

"""An interrupted or killed run is resumed with the same results; `--from` uses what another one learned."""

import itertools
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps import command_line
from rsmcm.apps.background.application import build_model
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs.interruption import Interruption
from rsmcm.apps.scenes import cylinder, face, signer, sleeping_man
from rsmcm.apps.scenes.signing.signer import SignerScene
from rsmcm.chains import ArticulatedPose, FleshTracker
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import BodyParts, UpperBody
from rsmcm.models.body.upper_body import JOINTS

T = TypeVar("T")
N_FRAMES = 24
SIZE = (200, 160)
HEAD = JOINTS.index("head")

UNEQUAL = {"film.mp4", "view.html", "state.npz"}
"""Files that tell of times, or are encoded in segments."""
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


def files_of(out: Path) -> dict[str, Path]:
    found = {str(path.relative_to(out)): path for path in out.rglob("*") if path.is_file()}
    return {name: path for name, path in found.items() if name not in {*UNEQUAL, ".lock"}}


def assert_same(out: Path, whole: Path) -> None:
    """Equal data, byte by byte."""
    found, expected = files_of(out), files_of(whole)
    assert found.keys() == expected.keys()
    assert not list(out.glob("*.part*"))
    for name, path in found.items():
        if path.suffix == ".npz":
            with np.load(path) as one, np.load(expected[name]) as other:
                assert one.files == other.files
                for array in one.files:
                    assert one[array].dtype == other[array].dtype
                    assert one[array].tobytes() == other[array].tobytes(), (name, array)
        elif name == "summary.json":
            one, other = (json.loads(file.read_text()) for file in (path, expected[name]))
            assert one.keys() == other.keys()
            assert {k: v for k, v in one.items() if k not in TIMES} == {
                k: v for k, v in other.items() if k not in TIMES
            }
        else:
            assert path.read_bytes() == expected[name].read_bytes(), name


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
            for name, moments in (("structure", (1, 2)), ("face", (1, 10, 24)), ("body", (26, 32, 45, 47)))
            for after in moments
        ),
    ],
)
def test_interrupted_and_resumed(
    name: str,
    after: int,
    applications: dict[str, Application],
    whole: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A signal leaves complete results; with --resume they become those of a run in one go.

    It comes after so many frames or rounds; of the body's, 25 frames are looked at before.
    """
    application, out = applications[name], tmp_path / "out"
    with signals_after(after, [signal.SIGTERM], monkeypatch):
        assert application.run(out) == 128 + signal.SIGTERM
    summary = json.loads((out / "summary.json").read_text())
    assert summary["ended_early"]
    if name in ("face", "body"):
        with np.load(out / "poses.npz") as content:
            assert len(content["times"]) == summary["frames"]
    assert application.run(out, "--resume") == 0
    assert_same(out, whole[name])


@pytest.mark.parametrize("name", ["background", *OTHERS])
def test_two_signals(
    name: str,
    applications: dict[str, Application],
    whole: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The second one ends the run at once, and the message says how to resume it."""
    application, out = applications[name], tmp_path / "out"
    after = {"structure": 1, "body": 32}.get(name, 9)
    with signals_after(after, [signal.SIGINT, signal.SIGINT], monkeypatch):
        assert application.run(out) == 128 + signal.SIGINT
    *_, line = capfd.readouterr().err.splitlines()  # after progress, where the machine is slow
    assert line == f"rsmcm: interrupted: --resume goes on with {out}"
    assert application.run(out, "--resume") == 0
    assert_same(out, whole[name])
    assert application.run(out, "--overwrite") == 0


@pytest.mark.parametrize("name", ["background", *OTHERS])
def test_a_finished_run_is_resumed_by_doing_nothing(
    name: str, applications: dict[str, Application], whole: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole[name], out)
    before = {
        path: path.stat().st_mtime_ns for path in files_of(out).values() if path.name != "manifest.json"
    }
    assert applications[name].run(out, "--resume") == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before


@pytest.mark.slow
def test_other_runs_are_not_resumed(
    applications: dict[str, Application],
    whole: dict[str, Path],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for name, options, words in (
        ("structure", ("--coherence", "none"), "coherence was 'second-order', now 'none'"),
        ("face", ("--gain", "0.5"), "gain was 0.1, now 0.5"),
        ("body", ("--seed", "1"), "seed was 0, now 1"),
    ):
        shutil.copytree(whole[name], tmp_path / name)
        assert applications[name].run(tmp_path / name, "--resume", *options) == 2
        assert f"--resume: other parameters than in the saved run: {words}" in capfd.readouterr().err
    assert applications["face"].run(tmp_path / "body", "--resume") == 2
    assert "holds results of rsmcm body, expected rsmcm face" in capfd.readouterr().err


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


@pytest.mark.slow
def test_a_face_from_another_film(
    applications: dict[str, Application], whole: dict[str, Path], tmp_path: Path
) -> None:
    """No landmarks are given; halves are as one film."""
    _, second = learned(applications["face"], tmp_path, "--experts", "4")
    with np.load(second / "poses.npz") as found, np.load(whole["face"] / "poses.npz") as expected:
        np.testing.assert_allclose(found["vertices_2d"], expected["vertices_2d"][N_FRAMES // 2 :], atol=1e-3)


@pytest.mark.slow
def test_a_body_from_another_film(applications: dict[str, Application], tmp_path: Path) -> None:
    """No head is given; the track goes on where the first half ended."""
    _, second = learned(applications["body"], tmp_path, "--samples", "100")
    scene = signing()
    with np.load(second / "poses.npz") as found:
        errors = np.linalg.norm(found["joints_2d"] - scene.joints[N_FRAMES // 2 :, :, :2], axis=2)
    assert errors[:, HEAD].max() < 0.2 * scene.body.head_height
    assert np.median(errors) < 0.2 * scene.body.head_height


@pytest.mark.slow
def test_what_cannot_be_learned_from(
    applications: dict[str, Application],
    whole: dict[str, Path],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "broken.npz").write_bytes(b"PK")
    for name, state, words in (
        (
            "background",
            whole["face"] / "state.npz",
            r"--from: .* is of rsmcm face, expected",
        ),
        ("background", tmp_path / "broken.npz", "got neither .npy nor .npz, expected a state"),
        ("background", tmp_path / "nothing.npz", r"nothing\.npz: No such file"),
        ("face", whole["face"] / "state.npz", "--landmarks and --from: got both"),
        ("body", whole["body"] / "state.npz", "--head and --from: got both"),
    ):
        assert applications[name].run(tmp_path / "out", "--from", str(state)) == 2
        assert re.fullmatch(f"rsmcm: .*{words}.*\n", capfd.readouterr().err)
        assert not (tmp_path / "out").exists()
    other = Application("background", applications["body"].source, ())
    assert other.run(tmp_path / "out", "--from", str(whole["background"] / "state.npz")) == 2
    assert "is of frames that are 200x160 colour, but" in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("hours", [0.01, 1000.0])
def test_a_camera_that_was_switched_off(hours: float) -> None:
    """However long nobody looked, an unchanged scene is still background, and a body is still found."""
    street = list(sleeping_man(40, size=SIZE))
    engine = RecursiveBP(build_model())
    *_, belief = engine.run(street[:20])
    after = street[20]
    belief = engine.step(belief.state, replace(after, time=belief.state.time + 3600 * hours))
    assert (belief["pixels"].foreground() > 0).mean() < 0.01
    scene = signing()
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    body = UpperBody.from_head(parts.head_height)
    flesh, pose = FleshTracker(body), ArticulatedPose(body, samples=100)
    engine = RecursiveBP(MultiChain().connect(flesh, parts).connect(pose, parts))
    frames = list(scene)
    *_, belief = engine.run(frames[:8])
    belief = engine.step(belief.state, replace(frames[8], time=belief.state.time + 3600 * hours))
    head = body_moments(body, belief[pose]).joints[HEAD, :2]
    assert np.linalg.norm(head - scene.joints[8, HEAD, :2]) < 0.5 * body.head_height, (
        "not even half a head off"
    )

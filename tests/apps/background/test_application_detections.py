"""Detections in a run: for the right frames, in all results, and refused in one line where they cannot be."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rsmcm.apps.background import application
from rsmcm.apps.background.application import run_background
from rsmcm.apps.background.job import BackgroundJob, Engine
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import sleeping_man
from rsmcm.inference import Belief
from rsmcm.models import Frame

from ...conftest import Command, summary_of

SIZE = (128, 96)
N_FRAMES = 12


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In CDnet's layout, with a `found.csv` of two boxes in every frame."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(sleeping_man(N_FRAMES, size=SIZE, enter=0, car_leaves=20), folder)
    lines = ["frame,x,y,width,height,score,class"]
    for number in range(1, N_FRAMES + 1):
        lines += [f"{number},90,40,10.5,30,0.5,person", f"{number},{number},20,30,40,0.25,car"]
    (folder / "found.csv").write_text("\n".join(lines))
    return folder


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> dict[int, int | None]:
    """How many boxes the frames have that the model takes in, by number."""
    counts: dict[int, int | None] = {}
    original = application.read_frame_result

    def read_frame_result(belief: Belief, *arguments: object) -> application.FrameResult:
        boxes = belief.frame.boxes
        counts[belief.frame.number] = None if boxes is None else len(boxes)
        return original(belief, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(application, "read_frame_result", read_frame_result)
    return counts


def job_of(scene: Path, out: Path) -> BackgroundJob:
    return BackgroundJob(
        str(scene / "input"), out=out, masks="none", detections=scene / "found.csv", classes=("car",)
    )


def test_frames_keep_their_numbers(scene: Path, tmp_path: Path, seen: dict[int, int | None]) -> None:
    job = replace(job_of(scene, tmp_path), detections=scene / "third.csv", start=4, step=2, stop=10)
    lines = (scene / "found.csv").read_text().splitlines()
    third = [line for line in lines[1:] if int(line.partition(",")[0]) % 3 == 1]
    (scene / "third.csv").write_text("\n".join([lines[0], *third]))
    outcome = run_background(job)
    assert seen == {4: 1, 6: None, 8: None, 10: 1}
    assert outcome.summary["detections"] == {"boxes": 2, "frames": 2}
    assert "2 detections in 2 frames" in outcome.words[0]


def test_all_results_tell_of_them(scene: Path, tmp_path: Path) -> None:
    run_background(job_of(scene, tmp_path))
    summary = summary_of(tmp_path)
    assert summary["detections"] == {"boxes": N_FRAMES, "frames": N_FRAMES}
    assert summary["parameters"]["detections"]["file"] == str(scene / "found.csv")
    assert summary["parameters"]["classes"] == ["car"]
    assert "frames with a detector" in (tmp_path / "view.html").read_text()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (lambda lines: lines, lambda lines: lines[12:] + lines[:12]),  # frames in any order
        (lambda lines: lines, lambda lines: [*lines, *lines]),  # twice
        (
            lambda lines: [line.rpartition(",")[0] for line in lines],
            lambda lines: [line.rpartition(",")[0] + ",7" for line in lines],  # constant scores
        ),
    ],
)
def test_files_that_say_the_same_give_the_same_tracks(
    one: Callable[[list[str]], list[str]],
    other: Callable[[list[str]], list[str]],
    scene: Path,
    tmp_path: Path,
) -> None:
    rows = [line.split(",") for line in (scene / "found.csv").read_text().splitlines()[1:]]
    lines = [f"{frame},-1,{','.join(box)},{score}" for frame, *box, score, _ in rows]
    tracks = []
    for out, form in ((tmp_path / "one", one), (tmp_path / "other", other)):
        (tmp_path / "det.txt").write_text("\n".join(form(lines)))
        job = replace(job_of(scene, out), detections=tmp_path / "det.txt", classes=())
        run_background(job)
        tracks.append((out / "tracks.txt").read_text())
    assert tracks[0] == tracks[1] != ""


def test_a_run_goes_on_only_with_the_same_detections(scene: Path, tmp_path: Path) -> None:
    other = tmp_path / "found.csv"
    content = (scene / "found.csv").read_text()
    other.write_text(content)
    job = replace(job_of(scene, tmp_path / "out"), detections=other)
    run_background(job)
    run_background(replace(job, resume=True))
    other.write_text(content + "\n12,1,1,5,5,0.5,car")
    with pytest.raises(ValueError, match=r"--resume: other parameters .*: detections\.sha256 was "):
        run_background(replace(job, resume=True))
    other.write_text(content)
    with pytest.raises(ValueError, match=r"--resume: other parameters .*: classes was"):
        run_background(replace(job, resume=True, classes=("person",)))


@pytest.mark.parametrize(
    ("engine", "warm_up", "least_passes"),
    [("recursive-bp", None, 1), ("feed-forward", 0.2, 1), ("coordinate-ascent", None, 3)],
)
def test_every_engine_is_given_them_in_every_pass(
    engine: Engine,
    warm_up: float | None,
    least_passes: int,
    scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[int] = []
    original = application.with_boxes

    def with_boxes(*arguments: Any) -> Iterator[Frame]:
        for frame in original(*arguments):
            assert frame.boxes is not None
            given.append(frame.number)
            yield frame

    monkeypatch.setattr(application, "with_boxes", with_boxes)
    run_background(replace(job_of(scene, tmp_path), engine=engine, warm_up=warm_up))
    passes = len(given) // N_FRAMES
    assert passes >= least_passes
    assert given == list(range(1, N_FRAMES + 1)) * passes


@pytest.mark.parametrize(
    ("content", "arguments", "complaint"),
    [
        ("13,1,1,5,5,1,car", (), "line 2: got frame 13, but"),
        ("0,1,1,5,5,1,car", (), "line 2: got frame 0, expected"),
        ("1,nan,1,5,5,1,car", (), "line 2: got left 'nan', expected"),
        ("1,1,1,5,-5,1,car", (), "line 2: got a box of 5 x -5 px, expected"),
        ("1,1,1,5,5,nan,car", (), "line 2: got confidence 'nan', expected"),
        ("1,1,1,5,5,1e200,car", (), "line 2: got a score of 1e+200, expected"),
        ("1,1,1,5,5,1,car\n2,150,1,9,9,1,car", (), "line 3: got a box from 150, 1, 159, 10"),
        ("1,1,1,5,5,1,car", ("--classes", "dog"), "--classes: got 'dog', but"),
        ("1,1,1,5,5,1,car", ("--engine", "stand-alone"), "--detections and --engine stand-alone: got both"),
    ],
)
def test_what_cannot_be_is_one_line(
    content: str,
    arguments: tuple[str, ...],
    complaint: str,
    scene: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "found.csv"
    path.write_text(f"frame,x,y,width,height,score,class\n{content}\n")
    out = tmp_path / "out"
    message = Command("background").complaint(
        capfd, scene / "input", "--out", out, "--detections", path, *arguments
    )
    assert complaint in message
    assert not out.exists()


def test_detections_that_are_not_there(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command, out = Command("background"), tmp_path / "out"
    message = command.complaint(capfd, scene / "input", "--out", out, "--detections", tmp_path / "no.txt")
    assert message.endswith("no.txt: No such file or directory\n")
    assert "--classes: got it without --detections" in command.complaint(
        capfd, scene / "input", "--out", out, "--classes", "car"
    )

"""Detections in a run: for the right frames, in all results, and refused in one line where they cannot be."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from rsmcm.apps.background import application
from rsmcm.apps.background.application import run_background
from rsmcm.apps.background.job import BackgroundJob, Engine
from rsmcm.apps.demo import write_scene
from rsmcm.apps.experiments.compare import run_compare
from rsmcm.apps.io.sources.open_source import open_source
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
    job = replace(job_of(scene, tmp_path), video=True)
    run_background(job)
    summary = summary_of(tmp_path)
    assert summary["detections"] == {"boxes": N_FRAMES, "frames": N_FRAMES}
    assert summary["parameters"]["detections"]["file"] == str(scene / "found.csv")
    assert summary["parameters"]["classes"] == ["car"]
    assert "frames with a detector" in (tmp_path / "view.html").read_text()
    video = cv2.VideoCapture(str(tmp_path / "overlay.mp4"))
    _, shown = video.read()
    video.release()
    run_background(replace(job, out=tmp_path / "without", detections=None, classes=()))
    video = cv2.VideoCapture(str(tmp_path / "without" / "overlay.mp4"))
    _, plain = video.read()
    video.release()
    assert summary_of(tmp_path / "without")["detections"] is None
    changed = (np.abs(shown.astype(int) - plain).max(axis=2) > 60).astype(np.uint8)
    near = cv2.dilate(changed, np.ones((5, 5), np.uint8)) > 0  # video smears
    outline = np.zeros(SIZE[::-1], bool)
    outline[20:60, 1:31] = True
    outline[21:59, 2:30] = False
    assert near[outline].mean() > 0.8, "a thin box"
    assert changed[66:].sum() == 0


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


def test_a_comparison_has_them_too(
    scene: Path, tmp_path: Path, seen: dict[int, int | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rsmcm.apps.experiments import compare

    monkeypatch.setattr(compare, "read_frame_result", application.read_frame_result)
    run_compare(job_of(scene, tmp_path))
    assert seen == dict.fromkeys(range(1, N_FRAMES + 1), 1)


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


def test_options_come_from_a_file_as_well(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(f'detections = "{scene / "found.csv"}"\nclasses = ["car", "person"]\n')
    arguments = (scene / "input", "--out", tmp_path / "out", "--masks", "none", "--stop", 3, "--config", path)
    assert Command("background")(*arguments) == 0
    assert summary_of(tmp_path / "out")["detections"] == {"boxes": 6, "frames": 3}
    assert Command("background")(*arguments, "--classes", "car,person", "--overwrite") == 0
    assert summary_of(tmp_path / "out")["parameters"]["classes"] == ["car", "person"]


@pytest.mark.parametrize(
    ("content", "arguments", "complaint"),
    [
        ("13,1,1,5,5,1,car", (), "line 2: got frame 13, but"),
        (
            "1,128,1,5,5,1,car",
            (),
            "line 2: got a box from 128, 1, 133, 6 (left, top, ",
        ),
        ("1,1,1,-5,5,1,car", (), "line 2: got a box of -5 x 5 px"),
        ("1,1,1,5,nan,1,car", (), "line 2: got height 'nan'"),
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


def test_detections_of_the_whole_film_serve_a_part(scene: Path, tmp_path: Path) -> None:
    outcome = run_background(replace(job_of(scene, tmp_path), start=2, stop=3))
    assert outcome.summary["detections"] == {"boxes": 2, "frames": 2}


def test_a_film_may_go_on_behind_the_frames_that_its_duration_tells_of(tmp_path: Path) -> None:
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as film:
        stream = film.add_stream("mpeg4", rate=10)
        stream.width, stream.height = SIZE
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for number in range(N_FRAMES):  # the second half at twice the rate
            picture = av.VideoFrame.from_ndarray(np.full((*SIZE[::-1], 3), 90, np.uint8), "bgr24")
            picture.pts = 50 * (number + min(number, N_FRAMES // 2))
            picture.time_base = Fraction(1, 1000)
            film.mux(stream.encode(picture))
        film.mux(stream.encode())
    with open_source(str(path)) as source:
        assert source.n_frames is not None
        assert source.n_frames < N_FRAMES
    found = tmp_path / "det.txt"
    found.write_text(f"{N_FRAMES},-1,10,10,20,30,0.9\n")
    job = BackgroundJob(str(path), out=tmp_path / "out", masks="none", detections=found)
    assert run_background(job).summary["detections"] == {"boxes": 1, "frames": 1}


def test_boxes_of_a_frame_that_cannot_be_read_are_not_counted(scene: Path, tmp_path: Path) -> None:
    film = tmp_path / "film"
    shutil.copytree(scene / "input", film)
    (film / "in000004.png").write_bytes(b"broken")
    summary = run_background(replace(job_of(scene, tmp_path / "out"), source=str(film))).summary
    assert summary["missing_frames"] == 1
    assert summary["detections"] == {"boxes": N_FRAMES - 1, "frames": N_FRAMES - 1}


def test_detections_that_are_not_there(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command, out = Command("background"), tmp_path / "out"
    message = command.complaint(capfd, scene / "input", "--out", out, "--detections", tmp_path / "no.txt")
    assert message.endswith("no.txt: No such file or directory\n")
    assert "--classes: got it without --detections" in command.complaint(
        capfd, scene / "input", "--out", out, "--classes", "car"
    )


def test_pictures_are_matched_by_name(scene: Path, tmp_path: Path, seen: dict[int, int | None]) -> None:
    """The data set lists some, in any order."""
    names = [f"in{number:06d}.png" for number in (7, 2, 3)]
    content = {
        "images": [{"id": index, "file_name": f"elsewhere/{name}"} for index, name in enumerate(names)],
        "annotations": [{"image_id": 1, "category_id": 1, "bbox": [1, 2, 30, 40], "score": 1}],
        "categories": [{"id": 1, "name": "car"}],
    }
    path = tmp_path / "coco.json"
    path.write_text(json.dumps(content))
    run_background(replace(job_of(scene, tmp_path / "out"), detections=path, start=2, stop=7))
    assert seen == {2: 1, 3: 0, 4: None, 5: None, 6: None, 7: 0}
